"""The builders of the package by the names in a configuration, today's and earlier ones."""

import warnings
from collections.abc import Callable

from pgrssnn_jax import physics
from pgrssnn_jax.physics.base import Physics

_EARLIER = {"tanks.cascaded_tanks": "cascaded_tanks", "lgssm.linear": "lgssm", "arm.arm.arm": "arm"}


def library_builder(target: str) -> Callable[..., Physics] | None:
    """The builder of a configuration's `_target_`, None where it is none of the package's."""
    name = target.removeprefix("pgrssnn_jax.physics.")
    if name == target or name not in (*physics.__all__, *_EARLIER):
        return None
    if name in ("lgssm.linear", "arm.arm.arm"):
        new = f"pgrssnn_jax.physics.{_EARLIER[name]}"
        warnings.warn(f"physics._target_: {target!r} is now called {new!r}", FutureWarning, stacklevel=2)
    return getattr(physics, _EARLIER.get(name, name))
