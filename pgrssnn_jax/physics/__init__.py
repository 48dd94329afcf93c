"""Known physics of a system, as pure functions in physical units: `cascaded_tanks`, `lgssm`, `arm`, or one's own."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pgrssnn_jax.physics.arms.build import arm
    from pgrssnn_jax.physics.linear import lgssm
    from pgrssnn_jax.physics.tanks import cascaded_tanks

__all__ = ["arm", "cascaded_tanks", "lgssm"]
_MODULES = {"cascaded_tanks": "tanks", "lgssm": "linear", "arm": "arms.build"}


def __getattr__(name: str) -> Any:
    """Imported when it is asked for, because an arm loads Pinocchio."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
