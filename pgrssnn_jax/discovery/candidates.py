"""One screening of the whole catalogue beside a model: every effect fitted roughly from each of its starting values,
the best of them to the end, and the distribution of the best gain by luck alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery import likelihood
from pgrssnn_jax.discovery.estimate import (
    Estimate,
    Guess,
    Settings,
    fit_all,
    free_places,
    signal_range_of,
)
from pgrssnn_jax.discovery.least_squares import Lanes, sensitivity
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.null import Null, beside, nats, null_distribution, orthonormal
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.settings import Criteria

_ROUNDING = 1e-8  # of an energy: what matrices at their bounds leave; other effects leave 1e-6 at least
_RUN_AWAY = 1e100  # a free run that has left the range, and whose square would
_AT_EACH = 2  # starting values of an effect from which it is fitted


class Model(NamedTuple):
    """A fitted model. squares and counts: squared errors of every block of neighbouring samples, left out, and how many
    samples they are; deviation `[p]`: standard deviations of θ, with `freedom` degrees of freedom; free_run: error over
    whole sequences, where fits see segments of them."""

    estimate: Estimate
    squares: Float[np.ndarray, " block"]
    counts: Int[np.ndarray, " block"]
    deviation: Float[np.ndarray, " p"]
    freedom: float
    free_run: float | None = None

    @property
    def blocks(self) -> Float[np.ndarray, " block"]:
        """Predictive log-likelihood of every block."""
        variance = max(float(self.squares.sum() / self.counts.sum()), 1e-300)
        return -0.5 * (self.counts * np.log(2.0 * np.pi * variance) + self.squares / variance)

    @property
    def score(self) -> float:
        return float(self.blocks.sum())

    def better_than(self, other: "Model") -> tuple[float, float]:
        """Difference of the predictive log-likelihoods, and its standard error over blocks."""
        difference = self.blocks - other.blocks
        return float(difference.sum()), float(len(difference) ** 0.5 * difference.std(ddof=1))


class Candidate(NamedTuple):
    """gain: of log-likelihood over the base, after a few steps where the effect was not fitted to the end (model
    None)."""

    name: str
    gain: float
    guess: Guess
    model: Model | None = None

    @property
    def score(self) -> float:
        return self.model.score if self.model else -np.inf


class Screening(NamedTuple):
    """Candidates beside `base`, from best to worst; null: of the best by luck; visible: energy by which each
    effect at its starts moves the free run, and what of it nothing else can take up; size: measured samples; noise:
    variance of the white part of the errors, in weighted errors."""

    base: Model
    candidates: tuple[Candidate, ...]
    null: Null
    visible: dict[str, tuple[float, float]]
    size: int
    noise: float

    def p_value(self, candidate: Candidate) -> float:
        return self.null.p_value(candidate.name, candidate.gain)

    def redundant(self, name: str) -> bool:
        """Are there other values of the free parameters that do exactly the same?"""
        moved, left = self.visible.get(name, (0.0, 0.0))
        return left < _ROUNDING * moved

    def rms(self, model: Model | None = None) -> float:
        """Weighted error of the base or of another model, of free runs over whole sequences where fits saw segments."""
        model = model or self.base
        return model.free_run if model.free_run is not None else (model.estimate.cost / self.size) ** 0.5


def score_candidates(
    problem: Problem,
    signals: Signals,
    base: Guess | Model,
    settings: Settings,
    criteria: Criteria,
    rng: np.random.Generator,
    without: Sequence[str],
) -> Screening:
    """base: a guess is fitted first, also from the nominal physics and start, because an effect that is taken out again
    may have let them go."""
    if isinstance(base, Guess):
        fresh = base._replace(x0=signals.start)
        own = problem.of(None)
        nominal = fresh._replace(theta=_with(base.theta, own, problem.theta[own]))
        best = min(fit_all(problem, signals, [base, fresh, nominal], settings), key=lambda found: found[1])[0]
        (base,) = fitted_models(problem, signals, [best], settings, criteria.block)
    here, guesses = base.estimate.guess, _beside(problem, signals, base.estimate.guess, without)
    run, *runs = _runs(problem, signals, [here, *guesses], settings)
    at, _ = _linearisation(problem, signals, here, run)
    added = [_added(at, run, one) for one in runs]
    named = [(guess.active[-1], columns) for guess, columns in zip(guesses, added, strict=True)]
    found = _candidates(problem, signals, base, guesses, settings, criteria)
    least = int(np.ceil(1.0 / criteria.p_value))
    null = null_distribution(at, noise_of(at), named, criteria.draws, least, rng)
    best = next((c for c in found if c.model), None)
    if best and null.p_value(best.name, best.gain) > criteria.p_value:
        # errors that an effect has left have a colour, which would swallow it: the noise is what its fit leaves
        (fitted,) = _runs(problem, signals, [best.guess], settings)
        left = noise_of(_linearisation(problem, signals, best.guess, fitted)[0])
        other = null_distribution(at, left, named, criteria.draws, least, rng)
        null = min(null, other, key=lambda one: one.p_value(best.name, best.gain))
    tried = [base, *(c.model for c in found if c.model)]
    return Screening(base, tuple(found), null, _visible(at, named), *size_and_noise(signals, tried))


def _candidates(
    problem: Problem,
    signals: Signals,
    base: Model,
    guesses: Sequence[Guess],
    settings: Settings,
    criteria: Criteria,
) -> list[Candidate]:
    """Every effect after a few steps, the most promising ones at their optimum; the best first."""
    if not guesses:
        return []
    size = max(1, int((signals.weight > 0).sum()))
    cost = base.estimate.cost + problem.penalty(base.estimate.theta)
    rough = fit_all(problem, signals, guesses, settings._replace(steps=settings.rough))
    best = _best_of_each(fit_all(problem, signals, _finalists(rough, criteria.finalists), settings))
    models = fitted_models(problem, signals, [guess for guess, _ in best], settings, criteria.block)
    fitted = {model.estimate.active[-1]: model for model in models}
    reached = {guess.active[-1]: (guess, cost) for guess, cost in (*_best_of_each(rough), *best)}
    found = [
        Candidate(name, float(nats(1.0 - low / cost, size)), guess, fitted.get(name))
        for name, (guess, low) in reached.items()
    ]
    return sorted(found, key=lambda c: (-c.score, -c.gain))


def size_and_noise(signals: Signals, tried: Sequence[Model]) -> tuple[int, float]:
    """Measured samples, and the variance of the white noise that the best of some models leaves."""
    size = max(1, int((signals.weight > 0).sum()))
    return size, min(noise_floor(model.estimate.error, signals.weight) for model in tried) / size


def fitted_models(
    problem: Problem, signals: Signals, guesses: Sequence[Guess], settings: Settings, block: int
) -> list[Model]:
    """Guesses at their optimum, scored there."""
    found = []
    for guess, run in zip(guesses, _runs(problem, signals, guesses, settings), strict=True):
        at, free = _linearisation(problem, signals, guess, run)
        covariance, freedom = likelihood.covariance(at, noise_of(at), problem.noise)
        deviation = np.zeros(len(guess.theta))
        deviation[free] = np.sqrt(np.maximum(np.diag(covariance)[: len(free)], 0.0))
        estimate = Estimate(guess.active, guess.theta, guess.x0, run.error)
        found.append(Model(estimate, *likelihood.left_out(at, signals.block, block), deviation, freedom))
    return found


def _beside(problem: Problem, signals: Signals, base: Guess, without: Sequence[str]) -> list[Guess]:
    """Every effect that a guess does not have, at every start."""
    span = signal_range_of(problem, signals, base)
    return [
        Guess((*base.active, effect.name), problem.put(base.theta, effect.name, numbers), base.x0)
        for effect in problem.effects
        if effect.name not in (*base.active, *without)
        for numbers in effect.guesses(span)
    ]


class _Run(NamedTuple):
    """places `[k]`: free positions of θ; error `[seq, time, y]`: weighted; columns `[seq, time, y, k + s]`:
    weighted sensitivities of the free run."""

    places: Int[np.ndarray, " k"]
    error: Float[np.ndarray, "seq time y"]
    columns: Float[np.ndarray, "seq time y d"]


def _runs(problem: Problem, signals: Signals, guesses: Sequence[Guess], settings: Settings) -> list[_Run]:
    if not guesses:
        return []
    found = []
    lanes_at_once = settings.lanes if len(guesses) > settings.devices else len(guesses)
    for i in range(0, len(guesses), lanes_at_once):
        part = list(guesses[i : i + lanes_at_once])
        padded = part + [part[-1]] * (lanes_at_once - len(part))
        places = free_places(problem, padded, settings)
        lanes = Lanes(np.stack([g.theta for g in padded]), np.stack([g.x0 for g in padded]), places)
        y, dy = sensitivity(problem, signals, lanes)
        error = np.where(signals.weight > 0, signals.weight * (signals.y - y), 0.0)
        error, dy = (np.where(np.abs(a) < _RUN_AWAY, a, 0.0) for a in (error, signals.weight[..., None] * dy))
        for k in range(len(part)):
            used = np.flatnonzero(places[k] >= 0)
            columns = dy[k][..., np.concatenate([used, np.arange(places.shape[1], dy.shape[-1])])]
            found.append(_Run(places[k][used], error[k], columns))
    return found


def _linearisation(
    problem: Problem, signals: Signals, guess: Guess, run: _Run
) -> tuple[Linearisation, Int[np.ndarray, " k"]]:
    """Of a model at its present numbers, without those that stand at a bound; with the positions that are left."""
    theta = guess.theta[run.places]
    inside = (theta > problem.low[run.places]) & (theta < problem.high[run.places])
    free = run.places[inside]
    starts = np.arange(len(run.places), run.columns.shape[-1])
    columns = _starts_apart(run.columns[..., np.concatenate([np.flatnonzero(inside), starts])], len(free))
    precision, pull = np.zeros((2, columns.shape[-1]))
    precision[: len(free)] = problem.precision[free]
    given = np.where(problem.precision[free] > 0, problem.theta[free], guess.theta[free])  # may be infinite without
    pull[: len(free)] = precision[: len(free)] * (given - guess.theta[free])
    return Linearisation(run.error, columns, signals.weight > 0, precision, pull), free


def _starts_apart(dy: Float[np.ndarray, "seq time y d"], k: int) -> Float[np.ndarray, "seq time y m"]:
    """Derivatives by θ as they are, and columns of their own for the initial state of every sequence."""
    n_seq, time, n_y, width = dy.shape
    local = np.zeros((n_seq, time, n_y, n_seq, width - k))
    for i in range(n_seq):
        local[i, :, :, i] = dy[i, ..., k:]
    return np.concatenate([dy[..., :k], local.reshape(n_seq, time, n_y, -1)], -1)


def _added(at: Linearisation, here: _Run, run: _Run) -> Float[np.ndarray, "n m"]:
    """What a candidate adds at its start: displacement of the free run, and derivatives by its own numbers."""
    own = np.flatnonzero(~np.isin(run.places, here.places))
    moved = (here.error - run.error)[..., None]
    columns = np.concatenate([moved, run.columns[..., own]], -1)
    return columns.reshape(at.error.size, -1)


def _visible(
    at: Linearisation, added: Sequence[tuple[str, Float[np.ndarray, "n _"]]]
) -> dict[str, tuple[float, float]]:
    """Per effect the energy of its displacement, and what of it the model's free numbers cannot take up."""
    measured = at.measured.ravel()
    nuisance = orthonormal(at.columns.reshape(at.error.size, -1) * measured[:, None])
    visible: dict[str, tuple[float, float]] = {}
    for name, columns in added:
        displacement = columns[:, :1] * measured[:, None]
        left = beside(displacement, nuisance)
        seen = visible.get(name, (0.0, 0.0))
        visible[name] = (max(seen[0], float((displacement**2).sum())), max(seen[1], float((left**2).sum())))
    return visible


def _finalists(rough: Sequence[tuple[Guess, float]], most: int) -> list[Guess]:
    """The effects that a few steps bring furthest, each from its best starting values."""
    taken: dict[str, list[Guess]] = {}
    for guess, cost in sorted(rough, key=lambda found: found[1]):
        if np.isfinite(cost):
            taken.setdefault(guess.active[-1], []).append(guess)
    return [guess for own in list(taken.values())[:most] for guess in own[:_AT_EACH]]


def _best_of_each(fitted: Sequence[tuple[Guess, float]]) -> list[tuple[Guess, float]]:
    best: dict[str, tuple[Guess, float]] = {}
    for guess, cost in fitted:
        name = guess.active[-1]
        if np.isfinite(cost) and (name not in best or cost < best[name][1]):
            best[name] = (guess, cost)
    return list(best.values())


def count_of_numbers(problem: Problem, guess: Guess) -> int:
    """Numbers of the effect that came in last; a limit at infinity is none."""
    return int(np.isfinite(guess.theta[problem.of(guess.active[-1])]).sum())


def _with(theta: np.ndarray, places: np.ndarray, values: np.ndarray) -> np.ndarray:
    theta = theta.copy()
    theta[places] = values
    return theta
