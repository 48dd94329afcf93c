"""Why a free run left the floating-point range: steps that are too long for the system, and what would help."""

from typing import Any

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.check import of_library
from pgrssnn_jax.physics.integrate import EXPLICIT
from pgrssnn_jax.physics.simulate import free_run
from pgrssnn_jax.records.record import Array

LARGEST = float(np.finfo(np.float32).max)  # networks are trained in this precision
_SHORTER, _MOST = (10, 100), 10_000  # times as many sub-steps, and how many at most


def stays_finite(physics: Physics, u: Float[Array, "seq time u"], x0: Float[Array, "seq x"]) -> bool:
    """Do the states of a free run stay within the range of the numbers that networks are trained in?"""
    _, x = free_run(physics, u, x0)
    return bool((np.abs(np.asarray(x)) < LARGEST).all())  # False for NaN


def of_shorter_steps(physics: Physics, u: Float[Array, "seq time u"], x0: Float[Array, "seq x"]) -> str:
    """For a free run that does not stay finite: do shorter steps help, or an implicit integrator? A clause in brackets.
    Explicit integrators of a stiff system need them."""
    steps, known = physics.settings.get("sub_steps"), physics.settings.get("integrator")
    if steps is None:
        return f" (a step of dt={physics.dt:g} s may be too long for this system: the step function may divide it)"
    method = known if isinstance(known, str) else "this integrator"

    def finite(**settings: Any) -> bool:
        return stays_finite(physics.variant(**settings), u, x0)

    tried = [more * steps for more in _SHORTER if more * steps <= _MOST]
    helping = next((shorter for shorter in tried if finite(sub_steps=shorter)), None)
    if helping is None:
        return f" (shorter steps of {method}, up to sub_steps={tried[-1]}, do not help)" if tried else ""
    # asked only where shorter steps help: an implicit step may carry a system past the time at which it has no solution
    implicit = known in EXPLICIT and not of_library(physics) and finite(integrator="rosenbrock")
    return (
        f" (its step of {physics.dt / steps:g} s is too long for {method}, as it is where a system is stiff: "
        f"sub_steps={helping} in place of {steps} keeps the run finite"
        f"{', and so does the implicit integrator=rosenbrock' if implicit else ''})"
    )
