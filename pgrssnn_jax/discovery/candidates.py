"""One screening of the whole catalogue beside a model: every effect fitted roughly from each of its starting values,
the best of them to the end, and the null distribution of the largest gain."""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery import likelihood
from pgrssnn_jax.discovery.estimate import Estimate, Guess, Settings, fit_all, signal_range_of
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.linearise import added, linearisation, linearised, runs, visible
from pgrssnn_jax.discovery.noise import above_white_noise, noise_floor
from pgrssnn_jax.discovery.null import Null, nats, null_distribution
from pgrssnn_jax.discovery.predictive import log_likelihood, with_standard_error
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.process_noise import models_along
from pgrssnn_jax.discovery.process_null import Fitted, against_process_noise
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.base import SignalRange

_ROUNDING = 1e-8  # of an energy: what matrices at their bounds leave; other effects leave 1e-6 at least
_AT_EACH = 2  # starting values of an effect from which it is fitted
_TO_THE_END = 3  # effects with the best scores that are fitted until nothing changes; `settled` does so with all


class Model(NamedTuple):
    """A fitted model. squares and counts: squared errors of every block of neighbouring samples, left out, and how many
    samples they are; deviation `[p]`: standard deviations of θ, with `freedom` degrees of freedom; free_run: mean
    squared error of a run over each whole sequence, where fits see segments of them."""

    estimate: Estimate
    squares: Float[np.ndarray, " block"]
    counts: Int[np.ndarray, " block"]
    deviation: Float[np.ndarray, " p"]
    freedom: float
    free_run: Float[np.ndarray, " seq"] | None = None

    @property
    def blocks(self) -> Float[np.ndarray, " block"]:
        return log_likelihood(self.squares, self.counts)

    @property
    def score(self) -> float:
        return float(self.blocks.sum())

    def better_than(self, other: "Model") -> tuple[float, float]:
        """Difference of the predictive log-likelihoods, and its standard error over blocks."""
        return with_standard_error(self.blocks - other.blocks)

    def nearer_than(self, other: "Model") -> tuple[float, float]:
        """Mean log ratio of the squared errors of runs over whole sequences, and its standard error over sequences:
        ratios, because sequences in which much moves would outweigh all others."""
        assert self.free_run is not None
        assert other.free_run is not None
        ratio = np.log(other.free_run / self.free_run)
        return float(ratio.mean()), float(ratio.std(ddof=1) / len(ratio) ** 0.5) if len(ratio) > 1 else 0.0


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
    """Candidates beside `base`, from best to worst; null: distribution of the largest gain; visible: energy by
    which each effect at its starts moves the free run, and the part of it that nothing else can take up; size: measured
    samples; noise: variance of the white part of the errors, in weighted errors."""

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
        squared = model.estimate.cost / self.size if model.free_run is None else float(model.free_run.mean())
        return squared**0.5


def score_candidates(
    problem: Problem,
    signals: Signals,
    base: Guess | Model,
    settings: Settings,
    criteria: Criteria,
    rng: np.random.Generator,
    without: Sequence[str],
    known: Sequence[Candidate] = (),
) -> Screening:
    """base: a guess is fitted first; known: candidates that have been fitted beside it. Fits begin at the nominal
    physics and start too: without an effect, the other numbers bend until they stand for it, and may not find back when
    it is there."""
    if isinstance(base, Guess):
        base = _fitted_base(problem, signals, base, settings, criteria)
    here, span = base.estimate.guess, signal_range_of(problem, signals, base.estimate.guess)
    guesses = _beside(problem, span, here, without)
    run, *begun = runs(problem, signals, [here, *guesses], settings)
    at, _ = linearisation(problem, signals, here, run)
    named = [(guess.active[-1], added(run, one)) for guess, one in zip(guesses, begun, strict=True)]
    gain = partial(_gain, problem, signals, base)
    if not here.active:  # beside effects less is bent, and the leading ones begin there in the end
        guesses += _beside(problem, span, with_nominal_numbers(problem, signals, here), without)
    done = {c.name for c in known}
    guesses = [guess for guess in guesses if guess.active[-1] not in done]
    rough = fit_all(problem, signals, guesses, settings.roughly)
    rough = [(g, low) for g, low in rough if np.isfinite(low) and problem.credible(g.active, g.theta, span)]
    rough.sort(key=lambda found: found[1])
    few = [*known, *(Candidate(guess.active[-1], gain(low), guess) for guess, low in _best_of_each(rough))]
    few.sort(key=lambda c: -c.gain)
    null = _null(problem, signals, (at, named), few[0] if few else None, settings, criteria, rng)
    clear = above_white_noise(base.estimate.error, signals.weight, criteria.clear)
    hopeful = clear or any(null.p_value(c.name, c.gain) <= criteria.hopeless for c in few)
    fitted = _fitted(problem, signals, _finalists(rough, criteria.finalists), settings, criteria) if hopeful else []
    found = [Candidate(m.estimate.active[-1], gain(low), m.estimate.guess, m) for m, low in fitted]
    found = [c for c in found if problem.credible(c.guess.active, c.guess.theta, span)]
    found += [c for c in few if c.name not in {other.name for other in found}]
    models = [*(model for model, _ in fitted), *(c.model for c in known if c.model)]
    noise = white_noise(signals, [base, *models])
    fits = [Fitted(c.name, c.gain, partial(linearised, problem, signals, c.guess, settings)) for c in found if c.model]
    null = against_process_noise(null, at, named, fits, partial(models_along, problem, signals, here), criteria, rng)
    return Screening(base, ranked(found), null, visible(at, named), signals.size, noise)


def _fitted(
    problem: Problem, signals: Signals, finalists: Sequence[Guess], settings: Settings, criteria: Criteria
) -> list[tuple[Model, float]]:
    """Models of the finalists and their costs: those with the best scores at their optimum, the others after a few
    steps."""

    def scored(fits: Sequence[tuple[Guess, float]]) -> list[tuple[Model, float]]:
        models = fitted_models(problem, signals, [guess for guess, _ in fits], settings, criteria.block)
        return list(zip(models, (low for _, low in fits), strict=True))

    few = scored(_best_of_each(fit_all(problem, signals, finalists, settings.roughly)))
    few.sort(key=lambda one: -one[0].score)
    leading = [model.estimate.guess for model, _ in few[:_TO_THE_END]]
    return scored(_to_the_end(problem, signals, leading, settings)) + few[_TO_THE_END:]


def _to_the_end(
    problem: Problem, signals: Signals, guesses: Sequence[Guess], settings: Settings
) -> list[tuple[Guess, float]]:
    """Each at its optimum, looked for from the nominal physics and start too."""
    ways = [way for guess in guesses for way in (guess, with_nominal_numbers(problem, signals, guess))]
    fits = fit_all(problem, signals, ways, settings)
    return [min(pair, key=lambda found: found[1]) for pair in zip(fits[::2], fits[1::2], strict=True)]


def with_nominal_numbers(problem: Problem, signals: Signals, guess: Guess) -> Guess:
    """The same effects beside the nominal physics and start."""
    own = problem.of(None)
    return guess._replace(theta=moved(guess.theta, own, problem.theta[own]), x0=signals.start)


def settled(
    problem: Problem, signals: Signals, screening: Screening, settings: Settings, criteria: Criteria
) -> Screening:
    """The screening with its finalists at their optimum: only there can it be told which of them predict alike."""
    begun = [(c, c.model.estimate.guess) for c in screening.candidates if c.model]
    span = signal_range_of(problem, signals, screening.base.estimate.guess)
    fits = _to_the_end(problem, signals, [guess for _, guess in begun], settings)
    models = fitted_models(problem, signals, [guess for guess, _ in fits], settings, criteria.block)
    done = {
        c.name: Candidate(c.name, _gain(problem, signals, screening.base, low), model.estimate.guess, model)
        for (c, _), (_, low), model in zip(begun, fits, models, strict=True)
        if problem.credible(model.estimate.active, model.estimate.theta, span)
    }
    return screening._replace(candidates=ranked([done.get(c.name, c) for c in screening.candidates]))


def ranked(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """From best to worst."""
    return tuple(sorted(candidates, key=lambda c: (-c.score, -c.gain)))


def _gain(problem: Problem, signals: Signals, base: Model, low: float) -> float:
    """Of log-likelihood over the base, of a fit with this cost."""
    cost = base.estimate.cost + problem.penalty(base.estimate.theta)
    return float(nats(1.0 - low / cost, signals.size))


def _fitted_base(problem: Problem, signals: Signals, base: Guess, settings: Settings, criteria: Criteria) -> Model:
    begun = [base, base._replace(x0=signals.start), with_nominal_numbers(problem, signals, base)]
    best = min(fit_all(problem, signals, begun, settings), key=lambda found: found[1])[0]
    (model,) = fitted_models(problem, signals, [best], settings, criteria.block)
    return model


def _null(
    problem: Problem,
    signals: Signals,
    base: tuple[Linearisation, Sequence[tuple[str, Float[np.ndarray, "n _"]]]],
    best: Candidate | None,
    settings: Settings,
    criteria: Criteria,
    rng: np.random.Generator,
) -> Null:
    """base: its linearisation, and what effects add to it. Where the best one fails, also with the noise that its own
    fit leaves: errors that an effect has left have a colour, which would swallow it."""
    at, named = base
    least = int(np.ceil(1.0 / criteria.p_value))
    null = null_distribution(at, noise_of(at).recoloured, named, criteria.draws, least, rng)
    if best is None or null.p_value(best.name, best.gain) <= criteria.p_value:
        return null
    left = noise_of(linearised(problem, signals, best.guess, settings)[0])
    other = null_distribution(at, left.recoloured, named, criteria.draws, least, rng)
    return min(null, other, key=lambda one: one.p_value(best.name, best.gain))


def white_noise(signals: Signals, tried: Sequence[Model]) -> float:
    """Variance of the white noise that the best of some models leaves."""
    return min(noise_floor(model.estimate.error, signals.weight) for model in tried) / signals.size


def fitted_models(
    problem: Problem, signals: Signals, guesses: Sequence[Guess], settings: Settings, block: int
) -> list[Model]:
    """Guesses at their optimum, scored there."""
    found = []
    for guess, run in zip(guesses, runs(problem, signals, guesses, settings), strict=True):
        at, free = linearisation(problem, signals, guess, run)
        covariance, freedom = likelihood.covariance(at, noise_of(at), problem.noise)
        deviation = np.zeros(len(guess.theta))
        deviation[free] = np.sqrt(np.maximum(np.diag(covariance)[: len(free)], 0.0))
        estimate = Estimate(guess.active, guess.theta, guess.x0, run.error)
        found.append(Model(estimate, *likelihood.left_out(at, signals.block, block), deviation, freedom))
    return found


def _beside(problem: Problem, span: SignalRange, base: Guess, without: Sequence[str]) -> list[Guess]:
    """Every effect that a guess does not have, at every start."""
    return [
        Guess((*base.active, effect.name), problem.put(base.theta, effect.name, numbers), x0)
        for effect in problem.effects
        if effect.name not in (*base.active, *without)
        for numbers in effect.guesses(span)
        for x0 in problem.beginnings([effect.name], base.x0)
    ]


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


def moved(theta: np.ndarray, places: Any, values: Any) -> np.ndarray:
    """θ with other numbers at some places."""
    theta = theta.copy()
    theta[places] = values
    return theta
