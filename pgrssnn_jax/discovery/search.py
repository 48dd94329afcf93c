"""Which effects are missing: greedy steps forward, exchanges, and a pruning backwards, all judged by cross-validation.

Forward: every effect of the catalogue is fitted beside what is there, from all its starting values at once; the best
in blocks left out enters when it beats the null and matters. Then every effect that has come in must earn its place
again: it is taken out, and whatever does best without it comes in instead.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.estimate import (
    Guess,
    Settings,
    Validated,
    block_sums,
    cross_validate,
    fit_all,
    reach_of,
)
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.null import null_law, what_is_added
from pgrssnn_jax.discovery.problem import Problem, Signals

_ASTRAY = 0.05  # part of its error energy by which a fit from elsewhere beats one that has gone astray
_PART = 0.25  # of the share that an effect must close, where no draw of the null gains as much
_ROUNDING = 1e-8  # of an energy: what matrices at their bounds leave; other effects leave 1e-6 at least
_MANY = 3  # effects: fewer from another beginning may do as well
_AS_GOOD = 0.005  # of the gap: how much worse a simpler effect may be than one that contains it


class Rules(NamedTuple):
    """When an effect counts.

    p_value: of its gain under the null; share: least part of the recalibrated gap (RMS error above that of the noise)
    that it closes; least: least relative fall of the error energy; rest, visible: the same for an effect that closes at
    least `rest` of what is left of the gap; finalists: candidates that are cross-validated; most: effects that may be
    found; draws: of the null. beam: how many other beginnings are tried, where more than `open` of the gap or more than
    `above` times the energy of the noise is left; far: times that energy where errors are surely no noise.
    """

    p_value: float = 0.01
    share: float = 0.02
    least: float = 0.02
    rest: float = 0.5
    visible: float = 0.1
    finalists: int = 6
    most: int = 4
    draws: int = 2000
    open: float = 0.05
    above: float = 1.25
    beam: int = 3
    far: float = 2.0


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


class Found(NamedTuple):
    """recalibrated: no effect; final: with the effects found; stages: the look at the catalogue without each of them,
    by its name; first and last: the looks beside nothing and beside everything found; noise: its variance."""

    recalibrated: Validated
    final: Validated
    stages: dict[str, Stage]
    first: Stage
    last: Stage
    noise: float

    @property
    def floor(self) -> float:
        """Error energy of the noise alone."""
        return self.noise * self.first.size


def search(
    problem: Problem,
    start: Guess,
    rules: Rules,
    notify: Callable[[str], None],
    examine: Callable[[Guess], Stage],
) -> Found:
    """From a recalibrated guess without effects to the model that explains the record. examine: a look at the whole
    catalogue beside a guess (`look_at`, or `linear.look_linear` for stretches)."""
    looked: dict[tuple[str, ...], Stage] = {}

    def look(base: Guess, *, again: bool = False) -> Stage:
        key = tuple(sorted(base.active))
        if again or key not in looked:
            looked[key] = examine(base)
            best = looked[key].candidates
            notify(f"beside {', '.join(base.active) or 'the physics'}: " + _named(best[:3]))
        return looked[key]

    first = look(start)
    judge = _Judge(
        problem, look, partial(look, again=True), first.base.cost, first.noise * first.size, rules, first.free_run
    )
    current = _settled(judge, start)
    reached = look(current).base.cost
    closed = reached**0.5 - judge.floor**0.5 <= rules.open * judge.gap and reached <= rules.above * judge.floor
    closed = closed and len(current.active) < _MANY
    others = [c for c in first.candidates if c.name not in current.active][: rules.beam]
    best = first.candidates[0].cost if first.candidates else 0.0
    # what did as well as the first at the beginning may be what the second one needs beside it
    tied = [c for c in others if c.cost**0.5 - best**0.5 <= _AS_GOOD * judge.gap]
    current = _other_beginnings(judge, first, current, tied if closed else others)
    last = look(current)
    stages = {name: _knowing(look(_without(problem, current, name)), name, last) for name in current.active}
    return Found(first.base, last.base, stages, first, last, min(first.noise, last.noise))


class _Judge(NamedTuple):
    """again: a look at what was looked at before, with better numbers; recalibrated: cross-validated cost without
    effects; floor: cost of the noise; gap: between their roots; begun: error of the free run without effects, where
    fits see stretches."""

    problem: Problem
    look: Callable[[Guess], Stage]
    again: Callable[[Guess], Stage]
    recalibrated: float
    floor: float
    rules: Rules
    begun: float | None

    def matters(self, stage: Stage, candidate: Candidate) -> bool:
        """It closes its share of the recalibrated gap, or most of what is left of it, visibly. Where fits see stretches
        alone, whose starts hide what grows slowly, the free run must improve by that share."""
        if stage.free_run is not None:
            begun = self.begun if self.begun is not None else stage.free_run
            return candidate.free_run is not None and stage.free_run - candidate.free_run >= self.rules.share * begun
        if stage.redundant(candidate.name):
            return False
        gained = stage.base.cost**0.5 - candidate.cost**0.5
        left = max(stage.base.cost**0.5 - self.floor**0.5, 0.0)
        fall = 1.0 - candidate.cost / stage.base.cost if stage.base.cost > 0 else 0.0
        surely = candidate.gain > stage.null.max()
        clear = gained >= (_PART if surely else 1.0) * self.rules.share * self.gap and fall >= self.rules.least
        return clear or (gained >= self.rules.rest * left and fall >= self.rules.visible)

    def counts(self, stage: Stage, candidate: Candidate) -> bool:
        """It matters, and is not luck."""
        return self.matters(stage, candidate) and stage.p_value(candidate) <= self.rules.p_value

    @property
    def gap(self) -> float:
        return max(self.recalibrated**0.5 - self.floor**0.5, 0.0)


def _named(candidates: Sequence[Candidate]) -> str:
    return ", ".join(f"{c.name} {100 * c.gain:.1f} %" for c in candidates)


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
    reach, own = reach_of(problem, signals, base), problem.of(None)
    guesses: list[Guess] = []
    for effect in problem.effects:
        if effect.name in (*base.active, *without):
            continue
        for numbers in effect.starts(reach):
            theta = problem.put(base.theta, effect.name, numbers)
            guesses.append(Guess((*base.active, effect.name), theta, base.x0))
    if 2 * len(guesses) + 2 <= settings.lanes:  # the same from the physics as given: the refit may have gone astray
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


def _best_of_each(
    problem: Problem, fitted: Sequence[tuple[Guess, float]], rules: Rules
) -> dict[str, tuple[Guess, float]]:
    """The best fit of every effect; one with fewer numbers (an end of a range that is not there) where another brings
    no visible fall of the error energy, because a superfluous number stands in for what is still to be found."""
    best: dict[str, tuple[Guess, float]] = {}
    for guess, cost in sorted(fitted, key=lambda found: _count(problem, found[0])):
        name = guess.active[-1]
        if not np.isfinite(cost):
            continue
        now = best.get(name)
        more = now is not None and _count(problem, guess) > _count(problem, now[0])
        if now is None or cost < (1.0 - rules.visible * more) * now[1]:
            best[name] = (guess, cost)
    return best


def _count(problem: Problem, guess: Guess) -> int:
    """Numbers of the effect that came in last; a limit at infinity is none."""
    return int(np.isfinite(guess.theta[problem.of(guess.active[-1])]).sum())


def _chosen(judge: _Judge, stage: Stage) -> Candidate | None:
    """The candidate that enters: of those that matter and beat the null the best in blocks left out, or a simpler one
    that it contains and that is as good, or one with fewer numbers that is within a standard error of it."""
    passing = [c for c in stage.candidates if judge.counts(stage, c)]
    if not passing:
        return None
    best = passing[0]
    as_good = [c for c in passing if c.cost**0.5 - best.cost**0.5 <= _AS_GOOD * (judge.gap + best.cost**0.5)]
    simpler = [c for c in as_good if c.name in judge.problem.effect(best.name).simpler]
    fewer = _count(judge.problem, best.guess)
    leaner = [c for c in as_good if _count(judge.problem, c.guess) < fewer and _within_one_error(c, best)]
    return next(iter((*simpler, *leaner)), best)


def _within_one_error(one: Candidate, best: Candidate) -> bool:
    """Is the difference in blocks left out below its standard error? Source of the rule: Hastie, Tibshirani, Friedman,
    The Elements of Statistical Learning, 2009, section 7.10."""
    if one.validated is None or best.validated is None:
        return False
    difference = block_sums(one.validated.held_out**2 - best.validated.held_out**2)
    return bool(difference.sum() <= len(difference) ** 0.5 * difference.std(ddof=1))


def _other_beginnings(judge: _Judge, first: Stage, current: Guess, others: Sequence[Candidate]) -> Guess:
    """The effect that does best alone may be none of two that only do well together, or the best only because the fit
    of another had not come to its end: others are tried, and followed where they make a better pair than the best one
    does, or do better alone. What was found first stands unless errors fall visibly."""
    pair = judge.look(current).base.cost
    if first.candidates and first.candidates[0].name in current.active:
        pair = min([pair, *(c.cost for c in judge.look(first.candidates[0].guess).candidates[:1])])
    for other in others:
        stage = judge.look(other.guess)
        best = _chosen(judge, stage)
        if best is not None and best.cost < pair:
            found = _settled(judge, best.guess)
        elif best is None and judge.counts(first, other):
            found = stage.base.guess
        else:
            continue
        if judge.look(found).base.cost < (1.0 - judge.rules.least) * judge.look(current).base.cost:
            current = found
    return current


def _settled(judge: _Judge, current: Guess) -> Guess:
    """Forward steps and exchanges until nothing changes; a second round is rare."""
    for _ in range(3):
        before = set(current.active)
        current = _exchange(judge, _forward(judge, current))
        if set(current.active) == before or not current.active:
            break
    return current


def _forward(judge: _Judge, current: Guess) -> Guess:
    while len(current.active) < judge.rules.most:
        best = _chosen(judge, judge.look(current))
        if best is None:
            break
        current = best.guess
    return current


def _exchange(judge: _Judge, current: Guess) -> Guess:
    """Every effect in turn, the first that came in first: what is best in its place?"""
    for name in current.active:
        if len(current.active) == 1:
            break
        rest = _without(judge.problem, current, name)
        best = _chosen(judge, _knowing(judge.look(rest), name, judge.look(current)))
        if best is None:
            current = judge.look(rest).base.guess
        elif best.name != name:
            current = best.guess
        elif _better_fit(best, judge.look(current).base, judge.rules):
            current = judge.again(best.guess).base.guess
    return current


def _better_fit(best: Candidate, fitted: Validated, rules: Rules) -> bool:
    """Has the look without an effect found it again with visibly better numbers? The fit had ended beside them."""
    same = best.validated is not None and best.validated.held_out.shape == fitted.held_out.shape
    return same and best.cost < (1.0 - rules.least) * fitted.cost


def _knowing(stage: Stage, name: str, beside: Stage) -> Stage:
    """The look without an effect, with the model that has it, beside which another look was taken, in the place of a
    worse fit of it: that is what others must do better than."""
    own, fitted = next((c for c in stage.candidates if c.name == name), None), beside.base
    if fitted.held_out.shape != stage.base.held_out.shape or (own is not None and own.cost <= fitted.cost):
        return stage
    gain = 1.0 - fitted.estimate.cost / stage.base.estimate.cost
    known = Candidate(name, gain, fitted, fitted.guess, beside.free_run)
    others = [c for c in stage.candidates if c.name != name]
    return stage._replace(candidates=tuple(sorted((known, *others), key=lambda c: (c.cost, -c.gain))))


def _with(theta: np.ndarray, places: np.ndarray, values: np.ndarray) -> np.ndarray:
    theta = theta.copy()
    theta[places] = values
    return theta


def _without(problem: Problem, guess: Guess, name: str) -> Guess:
    theta = guess.theta.copy()
    theta[problem.of(name)] = problem.theta[problem.of(name)]
    return Guess(tuple(n for n in guess.active if n != name), theta, guess.x0)
