"""Known physics of a system, as pure functions in physical units: `cascaded_tanks`, `lgssm`, `arm`, or one's own."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pgrssnn_jax.physics.arms.build import arm
    from pgrssnn_jax.physics.linear import lgssm
    from pgrssnn_jax.physics.tanks import cascaded_tanks

__all__ = ["arm", "cascaded_tanks", "lgssm"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from pgrssnn_jax.physics.library import builder

    return builder(name)
