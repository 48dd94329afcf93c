"""One look at the whole catalogue beside a guess: every effect fitted from all its starting values at once, the best
cross-validated, and the law of the best gain by luck alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.estimate import Guess, Settings, Validated, cross_validate, fit_all, signal_range_of
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.null import null_law, what_is_added
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.settings import Rules

_ASTRAY = 0.05  # part of its error energy by which a fit from elsewhere beats one that has gone astray
_ROUNDING = 1e-8  # of an energy: what matrices at their bounds leave; other effects leave 1e-6 at least


class Candidate(NamedTuple):
    """gain: relative fall of the error energy on all of the record; validated: fitted to it and left out in blocks;
    free_run: error of the free run over whole sequences, where fits see stretches of them."""

    name: str
    gain: float
    validated: Validated | None
    guess: Guess
    free_run: float | None = None

    @property
    def cost(self) -> float:
        """Error energy in blocks left out; infinite for those that were not cross-validated."""
        return self.validated.cost if self.validated else float("inf")


class Stage(NamedTuple):
    """One look at the whole catalogue beside `base`: candidates from best to worst, law of the best gain by luck;
    visible: energy by which each effect at its starts moves the free run, and what of it nothing else can take up;
    size: measured samples that count; noise: its variance, in weighted errors."""

    base: Validated
    candidates: tuple[Candidate, ...]
    null: Float[np.ndarray, " draw"]
    visible: dict[str, tuple[float, float]]
    size: int
    noise: float
    free_run: float | None = None

    def p_value(self, candidate: Candidate) -> float:
        return chance(self.null, candidate.gain)

    def redundant(self, name: str) -> bool:
        """Are there other values of the free parameters that do exactly the same?"""
        moved, left = self.visible.get(name, (0.0, 0.0))
        return left < _ROUNDING * moved

    def rms(self, candidate: Candidate | None = None) -> float:
        """Weighted error of the base, or of a candidate: of free runs where fits saw stretches, else of samples left
        out."""
        chosen = candidate or self
        if self.free_run is not None:
            return float("inf") if chosen.free_run is None else chosen.free_run
        return ((candidate or self.base).cost / self.size) ** 0.5


def chance(null: Float[np.ndarray, " draw"], gain: float) -> float:
    """Part of the draws by luck alone that gain as much."""
    return float((1 + (null >= gain).sum()) / (1 + len(null)))


def size_and_noise(signals: Signals, tried: Sequence[Validated]) -> tuple[int, float]:
    """Samples that cross-validation counts, and the variance of the noise that the best of some models leaves."""
    measured = signals.weight > 0
    size = int((measured & (signals.block >= 0)[..., None]).sum())
    noise = min(noise_floor(v.estimate.error, signals.weight) for v in tried) / max(1, int(measured.sum()))
    return max(1, size), noise


def look_at(
    problem: Problem,
    signals: Signals,
    base: Guess | Validated,
    settings: Settings,
    rules: Rules,
    rng: np.random.Generator,
    without: Sequence[str],
) -> Stage:
    """base: a guess is fitted first. Every effect beside it is fitted from every start, the best to the end."""
    if isinstance(base, Validated):
        known, cost = base, base.estimate.cost + problem.penalty(base.estimate.theta)
        base = base.guess
    else:
        known, ((base, cost),) = None, fit_all(problem, signals, [base], settings)
    own, guesses = problem.of(None), _beside(problem, signals, base, without)
    if 2 * len(guesses) + 2 <= settings.lanes:  # the same from the nominal physics: the refit may have gone astray
        guesses += [g._replace(theta=_with(g.theta, own, problem.theta[own])) for g in guesses]
    fresh = base._replace(x0=signals.start)
    nominal = fresh._replace(theta=_with(base.theta, own, problem.theta[own]))
    screened = fit_all(problem, signals, [*guesses, fresh, nominal], settings, steps=settings.screening)
    *fitted, (afresh, low), (as_given, lower) = screened
    if min(low, lower) < (1.0 - _ASTRAY) * cost:  # an effect taken out again has let the start or the parameters go
        better = afresh if low < lower else as_given
        return look_at(problem, signals, better, settings, rules, rng, without)
    ranked = sorted(_best_of_each(problem, fitted, rules).items(), key=lambda item: item[1][1])
    finalists = [guess for _, (guess, _) in ranked[: rules.finalists]]
    if known is None:
        (known, cost), *validated = cross_validate(problem, signals, [base, *finalists], settings)
    else:
        validated = cross_validate(problem, signals, finalists, settings)
    candidates = [Candidate(v.guess.active[-1], 1.0 - reached / cost, v, v.guess) for v, reached in validated]
    candidates += [Candidate(name, 1.0 - low / cost, None, guess) for name, (guess, low) in ranked[rules.finalists :]]
    candidates.sort(key=lambda c: (c.cost, -c.gain))
    added = what_is_added(problem, signals, known.estimate, guesses, settings)
    law = null_law(known.estimate, signals.weight, added, rules.draws, rng)
    visible: dict[str, tuple[float, float]] = {}
    for guess, one in zip(guesses, added, strict=True):
        seen = visible.get(guess.active[-1], (0.0, 0.0))
        visible[guess.active[-1]] = (max(seen[0], one.moved), max(seen[1], one.left))
    return Stage(known, tuple(candidates), law, visible, *size_and_noise(signals, [known, *(v for v, _ in validated)]))


def _beside(problem: Problem, signals: Signals, base: Guess, without: Sequence[str]) -> list[Guess]:
    """Every effect that a guess does not have, at every start."""
    span = signal_range_of(problem, signals, base)
    return [
        Guess((*base.active, effect.name), problem.put(base.theta, effect.name, numbers), base.x0)
        for effect in problem.effects
        if effect.name not in (*base.active, *without)
        for numbers in effect.guesses(span)
    ]


def _best_of_each(
    problem: Problem, fitted: Sequence[tuple[Guess, float]], rules: Rules
) -> dict[str, tuple[Guess, float]]:
    """The best fit of every effect; one with fewer numbers (an end of a range that is not there) where another brings
    no visible fall of the error energy, because a superfluous number stands in for what is still to be found."""
    best: dict[str, tuple[Guess, float]] = {}
    for guess, cost in sorted(fitted, key=lambda found: count_of_numbers(problem, found[0])):
        name = guess.active[-1]
        if not np.isfinite(cost):
            continue
        now = best.get(name)
        more = now is not None and count_of_numbers(problem, guess) > count_of_numbers(problem, now[0])
        if now is None or cost < (1.0 - rules.visible * more) * now[1]:
            best[name] = (guess, cost)
    return best


def count_of_numbers(problem: Problem, guess: Guess) -> int:
    """Numbers of the effect that came in last; a limit at infinity is none."""
    return int(np.isfinite(guess.theta[problem.of(guess.active[-1])]).sum())


def _with(theta: np.ndarray, places: np.ndarray, values: np.ndarray) -> np.ndarray:
    theta = theta.copy()
    theta[places] = values
    return theta
