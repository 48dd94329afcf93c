"""The physics alone: its initial state, and its parameters from several starting values."""

import numpy as np

from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.settings import DiscoverySettings

_SPREAD = 0.3  # relative deviation of the starting values about the nominal ones


def nominal_guess(problem: Problem, signals: Signals, settings: Settings) -> Guess:
    """The nominal physics, with the best initial state for the estimation record."""
    ((given, _),) = fit_all(problem, signals, [Guess((), problem.theta, signals.start)], settings, only_start=True)
    return given


def recalibrated_guess(
    problem: Problem, signals: Signals, nominal: Guess, settings: Settings, chosen: DiscoverySettings
) -> Guess:
    """The physics' own parameters fitted from several starting values: nominal, and drawn about it."""
    own, rng = problem.of(None), np.random.default_rng(chosen.seed)
    if not len(own):
        return nominal
    guesses = [nominal]
    for _ in range(chosen.starts - 1):
        theta = nominal.theta.copy()
        drawn = theta[own] * np.exp(_SPREAD * rng.standard_normal(len(own)))
        theta[own] = np.clip(drawn, problem.low[own], problem.high[own])
        guesses.append(nominal._replace(theta=theta))
    return min(fit_all(problem, signals, guesses, settings), key=lambda item: item[1])[0]
