"""Proof in free run: how far an arm that moves by the measured torques alone gets from the measured one.

    x_t = step(p, x_{t-1}, u_t),   x = [q, q̇], the measured one at the start and again after every horizon
    error = mean over joints of RMS(q - q_measured) / std(q_measured)

A torque residual is the error of one moment; a free run adds them up.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from pgrssnn_jax.acceleration.compiler import quick_jit
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.problem import Problem

_HORIZONS = (1.0, 5.0)  # s, beside whole sequences
_MOST = 20_000  # samples of a sequence that are simulated: about 6 s for nine runs of six joints


class FreeRun(NamedTuple):
    """horizon: s, None where sequences are simulated whole; errors: of every model, NaN where its arm left all
    bounds."""

    horizon: float | None
    errors: Mapping[str, float]


def free_runs(problem: Problem, motion: Motion, numbers: Mapping[str, Float[np.ndarray, " p"]]) -> list[FreeRun]:
    """motion: at the moments at which positions were read; numbers: θ of every model. Horizons that are shorter than
    two samples, or longer than the sequences, are left out; the last one is whole sequences, or as much of long ones as
    is simulated."""
    full, reading, v, torque = problem.full, motion.reading[:, :_MOST], motion.v[:, :_MOST], motion.torque[:, :_MOST]
    steps, whole = v.shape[1] - 1, motion.v.shape[1] <= _MOST
    others = np.zeros((*v.shape[:2], len(full.states) - 2 * v.shape[2]))
    measured, given = jnp.asarray(np.concatenate([reading, v, others], axis=2)), jnp.asarray(torque)

    @quick_jit()
    def positions(theta: jax.Array, begins: Bool[jax.Array, " time"]) -> Float[jax.Array, "seq time n"]:
        params = problem.code.unravel(theta)

        def advance(x: jax.Array, now: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
            begin, known, u = now
            x = full.step(params, jnp.where(begin, known, x), u)
            return x, x[: len(u)]

        def simulate(known: jax.Array, u: jax.Array) -> jax.Array:
            return jax.lax.scan(advance, known[0], (begins, known[:-1], u[1:]))[1]

        return jax.vmap(simulate)(measured, given)

    spread = reading.std(axis=(0, 1))
    moved = spread > 0  # a joint that stands still has no part in the mean
    lengths = {horizon: round(horizon / motion.spacing) for horizon in _HORIZONS}
    shown = {horizon: length for horizon, length in lengths.items() if 2 <= length < steps}
    last = None if whole else steps * motion.spacing
    found = []
    for horizon, length in {**shown, last: steps}.items() if moved.any() else ():
        begins = jnp.asarray(np.arange(steps) % length == 0)
        runs = {name: np.asarray(positions(jnp.asarray(theta), begins)) for name, theta in numbers.items()}
        with np.errstate(over="ignore", invalid="ignore"):
            rms = {name: np.sqrt(((q - reading[:, 1:]) ** 2).mean((0, 1))) for name, q in runs.items()}
        errors = {name: float((one[moved] / spread[moved]).mean()) for name, one in rms.items()}
        found.append(FreeRun(horizon, errors))
    return found
