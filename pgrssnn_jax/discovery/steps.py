"""Integration steps that are short enough for a record: the error of an integrator is no missing effect.

    y_k: free run of the nominal physics with k sub-steps        d = y_k - y_2k        Σ (d / σ)² / 2 ≤ 1

An error d of this size changes the log-likelihood of the record by at most one nat. A parameter that is fitted to noise
alone gains half a nat on average. σ: standard deviation of the white noise in the residuals of y_2k (`noise.py`).
"""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Bool, Float

from pgrssnn_jax.discovery.noise import white_variance
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.simulate import first_output_state, free_run
from pgrssnn_jax.records.record import Record

_SAMPLES = 10_000  # of a record: from so many the length of the steps shows
_MOST = 16  # times as many sub-steps
_CONVERGES = 4.0  # d falls by 16 with each doubling in a method of order 4; beside jumps of a derivative by 2
_ROUNDING = 1e-9  # of an output's spread: what numbers in a file, and sums over a run, leave
Errors = Float[np.ndarray, "seq time y"]


def with_short_steps(physics: Physics, record: Record, notify: Callable[[str], None]) -> Physics:
    """The physics with as many sub-steps as the record can tell from more. As it was where none are enough, because its
    equations jump or its free run does not stay finite, and where that comes nearer to the record: simulated data may
    have been made with it."""
    given = physics.settings["sub_steps"]
    length = max(2, _SAMPLES // len(record.u))
    u, y, mask = (np.asarray(a[:, :length], t) for a, t in zip(record[:3], (float, float, bool), strict=True))

    def errors(times: int) -> Float[np.ndarray, "seq time y"]:
        shorter = physics.variant(sub_steps=times * given)
        found = free_run(shorter, u, first_output_state(shorter, y[:, 0], u[:, 0]))[0]
        return np.where(mask, y - np.asarray(found), 0.0)

    spread = np.where(mask, y, 0.0).var((0, 1))
    with jax.enable_x64(True):
        found = _enough(errors, mask, _ROUNDING**2 * spread + np.finfo(float).tiny)
    if found == 1:
        return physics
    notify(
        f"integration: {found * given} steps a sample in place of {given}, because these data would take the error of "
        "the integrator for one of the physics"
    )
    return physics.variant(sub_steps=found * given)


def _enough(
    errors: Callable[[int], Errors], mask: Bool[np.ndarray, "seq time y"], least: Float[np.ndarray, " y"]
) -> int:
    """Factor by which the number of sub-steps grows. errors: residuals of the free run for a factor; least: variance
    that the noise of an output has at least, in data without noise."""
    first = here = errors(1)
    times, before, noise = 1, np.inf, np.ones(here.shape[-1])
    while times < _MOST:
        finer = errors(2 * times)
        if not (np.isfinite(here).all() and np.isfinite(finer).all()):
            return 1
        noise, change = np.maximum(white_variance(finer, mask), least), ((finer - here) ** 2).sum((0, 1))
        if 0.5 * (change / noise).sum() <= 1.0:
            break
        if (relative := (change / least).sum()) * _CONVERGES**2 > before:
            return 1
        times, here, before = 2 * times, finer, relative
    nearer = ((here.var(1) - first.var(1)).sum(0) / noise).sum() < 0.0  # a wrong start may leave a mean
    return times if nearer else 1
