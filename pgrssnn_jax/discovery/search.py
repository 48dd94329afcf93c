"""Which effects are missing: greedy steps forward, exchanges, and a pruning backwards, all judged by cross-validation.

Forward: every effect of the catalogue is fitted beside what is there, from all its starting values at once; the best
in blocks left out enters when it beats the null and matters. Then every effect that has come in must earn its place
again: it is taken out, and whatever does best without it comes in instead.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from pgrssnn_jax.discovery.estimate import Guess, Validated, block_sums
from pgrssnn_jax.discovery.look import Candidate, Rules, Stage, count_of_numbers
from pgrssnn_jax.discovery.problem import Problem

_PART = 0.25  # of the share that an effect must close, where no draw of the null gains as much
_MANY = 3  # effects: fewer from another beginning may do as well
_AS_GOOD = 0.005  # of the gap: how much worse a simpler effect may be than one that contains it


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
    catalogue beside a guess (`look.look_at`, or `linear.look_linear` for stretches)."""
    looked: dict[tuple[str, ...], Stage] = {}

    def look(base: Guess, *, again: bool = False) -> Stage:
        key = tuple(sorted(base.active))
        if again or key not in looked:
            looked[key] = examine(base)
            best = looked[key].candidates
            notify(f"beside {', '.join(base.active) or 'the physics'}: " + _named(best[:3]))
        return looked[key]

    first = look(start)
    again, floor = partial(look, again=True), first.noise * first.size
    judge = _Judge(problem, look, again, first.base.cost, floor, rules, first.free_run)
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


def _chosen(judge: _Judge, stage: Stage) -> Candidate | None:
    """The candidate that enters: of those that matter and beat the null the best in blocks left out, or a simpler one
    that it contains and that is as good, or one with fewer numbers that is within a standard error of it."""
    passing = [c for c in stage.candidates if judge.counts(stage, c)]
    if not passing:
        return None
    best = passing[0]
    as_good = [c for c in passing if c.cost**0.5 - best.cost**0.5 <= _AS_GOOD * (judge.gap + best.cost**0.5)]
    simpler = [c for c in as_good if c.name in judge.problem.effect(best.name).simpler]
    fewer = count_of_numbers(judge.problem, best.guess)
    leaner = [c for c in as_good if count_of_numbers(judge.problem, c.guess) < fewer and _within_one_error(c, best)]
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


def _without(problem: Problem, guess: Guess, name: str) -> Guess:
    theta = guess.theta.copy()
    theta[problem.of(name)] = problem.theta[problem.of(name)]
    return Guess(tuple(n for n in guess.active if n != name), theta, guess.x0)
