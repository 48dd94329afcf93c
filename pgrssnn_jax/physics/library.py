"""The builders of the package by their importable names, today's and earlier ones."""

import importlib
import warnings
from collections.abc import Callable

from pgrssnn_jax.physics.base import Physics

_MODULES = {"cascaded_tanks": "tanks", "lgssm": "linear", "arm": "arms.build"}
_EARLIER = {
    "pgrssnn_jax.physics.tanks.cascaded_tanks": "cascaded_tanks",
    "pgrssnn_jax.physics.lgssm.linear": "lgssm",
    "pgrssnn_jax.physics.arm.arm.arm": "arm",
}


def builder(name: str) -> Callable[..., Physics]:
    """`cascaded_tanks`, `lgssm` or `arm`; imported when it is asked for, because an arm loads Pinocchio."""
    return getattr(importlib.import_module(f"pgrssnn_jax.physics.{_MODULES[name]}"), name)


def library_builder(target: str) -> Callable[..., Physics] | None:
    """The builder of a configuration's `_target_`, None where it is none of the package's."""
    name = target.removeprefix("pgrssnn_jax.physics.")
    if name != target and name in _MODULES:
        return builder(name)
    if target in _EARLIER:
        new = f"pgrssnn_jax.physics.{_EARLIER[target]}"
        if target != "pgrssnn_jax.physics.tanks.cascaded_tanks":
            warnings.warn(f"physics._target_: {target!r} is now called {new!r}", FutureWarning, stacklevel=2)
        return builder(_EARLIER[target])
    return None
