"""One screening of the nonparametric corrections beside a model: all by their linear responses, which are exact while
a correction is small, and those that promise to matter fitted to the end.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.candidates import (
    Candidate,
    Model,
    Screening,
    fitted_models,
    ranked,
    white_noise,
    with_nominal_numbers,
)
from pgrssnn_jax.discovery.corrected import Corrected, numbers_of
from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.flexible import families
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.linearise import Linearised, linearised
from pgrssnn_jax.discovery.noise import above_white_noise
from pgrssnn_jax.discovery.null import beside, nats, null_distribution, orthonormal
from pgrssnn_jax.discovery.problem import Problem, Signals, carried
from pgrssnn_jax.discovery.process_noise import models_of
from pgrssnn_jax.discovery.process_null import Fitted, against_process_noise
from pgrssnn_jax.discovery.responses import Response, correction_responses, path_of
from pgrssnn_jax.discovery.settings import Criteria

_FINALISTS = 4  # corrections that are fitted: several promise nearly the same where a signal drives them all
CURVED = 2.0  # times what its linear response promises, at most, is what a fitted correction reaches


class Corrections(NamedTuple):
    """problem: without corrections; corrected: those with one, beside the effects `active`; known: puts the prior of
    the physics on them; signals: of any problem."""

    problem: Problem
    corrected: Corrected
    active: tuple[str, ...]
    known: Callable[[Problem], Problem]
    signals: Callable[[Problem], Signals]
    settings: Settings

    def by(self, name: str) -> Problem:
        return self.known(self.corrected.by(self.problem, name, self.active))

    def by_all(self) -> Problem:
        return self.known(self.corrected.by_all(self.problem, self.active))


def score_corrections(
    corrections: Corrections, base: Model, criteria: Criteria, least: float, rng: np.random.Generator
) -> Screening:
    """least: fall of the weighted RMS error that a correction must reach to be of use."""
    problem, settings = corrections.problem, corrections.settings
    signals = corrections.signals(problem)
    guess = base.estimate.guess
    path = path_of(problem, signals, guess)
    responses = correction_responses(problem, path, families(problem.physics))
    at, _ = linearised(problem, signals, guess, settings)
    columns = {name: _weighted(signals, one) for name, one in responses.items()}
    null = null_distribution(
        at, noise_of(at).recoloured, list(columns.items()), criteria.draws, int(np.ceil(1.0 / criteria.p_value)), rng
    )
    falls = _falls(at, list(columns.values()))
    size = signals.size
    promised = {name: float(nats(fall, size)) for name, fall in zip(columns, falls, strict=True)}
    closed = {name: CURVED * _closed(base, size, fall) for name, fall in zip(columns, falls, strict=True)}
    names = sorted(promised, key=lambda name: -promised[name])
    clear = above_white_noise(base.estimate.error, signals.weight, criteria.clear)
    likely = [n for n in names if clear or null.p_value(n, promised[n]) <= criteria.hopeless]
    hopeful = [n for n in likely if closed[n] >= least]
    fitted = [_fitted(corrections, base, name, responses[name], criteria.block) for name in hopeful[:_FINALISTS]]
    rest = [Candidate(name, promised[name], guess) for name in names if name not in hopeful[:_FINALISTS]]
    models = [c.model for c in fitted if c.model]
    fits = [Fitted(c.name, c.gain, partial(_linearised, corrections, c)) for c in fitted]
    where = partial(models_of, problem, signals, path)
    null = against_process_noise(null, at, list(columns.items()), fits, where, criteria, rng)
    return Screening(base, ranked([*fitted, *rest]), null, {}, size, white_noise(signals, [base, *models]))


def _linearised(corrections: Corrections, candidate: Candidate) -> Linearised:
    problem = corrections.by(candidate.name)
    return linearised(problem, corrections.signals(problem), candidate.guess, corrections.settings)


def _weighted(signals: Signals, response: Response) -> Float[np.ndarray, "n k"]:
    columns = response.columns * signals.weight[..., None]
    return columns.reshape(-1, columns.shape[-1])


def _falls(at: Linearisation, added: Sequence[Float[np.ndarray, "n _"]]) -> list[float]:
    """Part of the error energy that columns take up beside all that is free anyway."""
    measured = at.measured.ravel()
    free = orthonormal(at.columns.reshape(at.error.size, -1) * measured[:, None])
    error = at.error.ravel()
    left = error - free @ (free.T @ error)
    energy = max(float(left @ left), 1e-300)
    found = []
    for columns in added:
        basis = orthonormal(beside(columns * measured[:, None], free))
        found.append(float(((left @ basis) ** 2).sum()) / energy)
    return found


def _closed(base: Model, size: int, fall: float) -> float:
    rms = (base.estimate.cost / size) ** 0.5
    return rms * (1.0 - max(1.0 - fall, 0.0) ** 0.5)


def _fitted(corrections: Corrections, base: Model, name: str, response: Response, block: int) -> Candidate:
    """In its own problem, from a correction that does nothing, beside the model and the nominal physics."""
    problem, settings = corrections.by(name), corrections.settings
    signals = corrections.signals(problem)
    theta, x0 = carried(corrections.problem, problem, base.estimate.theta, base.estimate.x0, signals.start)
    effect, numbers = numbers_of(problem.physics, name, response.low, response.high)
    start = Guess((*base.estimate.active, effect), problem.put(theta, effect, numbers), x0)
    few = settings._replace(lanes=settings.devices)
    fits = fit_all(problem, signals, [start, with_nominal_numbers(problem, signals, start)], few)
    guess, cost = min(fits, key=lambda found: found[1])
    (model,) = fitted_models(problem, signals, [guess], few, block)
    before = base.estimate.cost + corrections.problem.penalty(base.estimate.theta)
    gain = nats(1.0 - cost / before, signals.size)
    return Candidate(name, float(gain), guess, model)
