"""Standard deviations of fitted numbers, for 95 % intervals: the widest of three.

The sandwich of coloured noise and the jackknife (`likelihood.py`); and, where a disturbance of the dynamics is likelier
than coloured noise (`process_noise.py`), the sandwich of that.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery import likelihood
from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.likelihood import noise_of
from pgrssnn_jax.discovery.linearise import linearised
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.process_noise import likelier, models_along


class Deviations(NamedTuple):
    """free `[k]`: positions of θ; of these numbers: the widest, with `freedom` degrees of freedom, and the sandwich of
    coloured noise alone."""

    free: Int[np.ndarray, " k"]
    widest: Float[np.ndarray, " k"]
    coloured: Float[np.ndarray, " k"]
    freedom: float


def deviations(problem: Problem, signals: Signals, guess: Guess, settings: Settings) -> Deviations:
    """Of the free numbers of a fitted model."""
    at, free = linearised(problem, signals, guess, settings)
    noise = noise_of(at)
    coloured, _ = likelihood.covariance(at, noise, problem.noise)
    widest, freedom = likelihood.deviations(at, noise, problem.noise)
    if found := likelier(models_along(problem, signals, guess), at, noise):
        widest = np.maximum(widest, _roots(found[1].covariance(at, problem.noise)))
    return Deviations(free, widest[: len(free)], _roots(coloured)[: len(free)], freedom)


def _roots(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, " k"]:
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))
