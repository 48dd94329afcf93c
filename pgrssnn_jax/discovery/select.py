"""Which effects are missing: steps forward, then every effect judged again against the model without it.

Forward: of the candidates that beat the null, predict left-out blocks better and close a share of the gap, the one with
the best score enters. Backward: every effect in turn is taken out; what does best in its place comes in, or nothing.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from pgrssnn_jax.discovery.candidates import Candidate, Model, Screening, count_of_numbers
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.null import nats
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.settings import Criteria

_ROUNDS = 2  # of steps forward and exchanges; a second one is rare


class Selection(NamedTuple):
    """recalibrated: no effect; final: with the effects found; screenings: of the catalogue without each of them, by its
    name; first and last: those beside nothing and beside everything found; noise: variance of its white part."""

    recalibrated: Model
    final: Model
    screenings: dict[str, Screening]
    first: Screening
    last: Screening
    noise: float

    @property
    def floor(self) -> float:
        """Weighted RMS error of the noise alone."""
        return self.noise**0.5


class Judge(NamedTuple):
    """When a candidate counts. gap: RMS error of the recalibrated physics above that of the white noise; spent: p-value
    with which each effect came in last; their sum bounds the probability that any of them is luck."""

    problem: Problem
    criteria: Criteria
    gap: float
    noise: float
    spent: dict[str, float]

    def counts(self, screening: Screening, candidate: Candidate) -> bool:
        """Its gain is not luck; it closes its share of the gap and predicts left-out blocks better by more than a
        standard error, or it closes most of what others leave and predicts them better with certainty."""
        if candidate.model is None or screening.redundant(candidate.name):
            return False
        better, error = candidate.model.better_than(screening.base)
        closed, left = screening.rms() - screening.rms(candidate.model), screening.rms() - self.noise
        share = closed >= self.criteria.share * self.gap
        if not share and not closed >= self.criteria.rest * left > 0.0:
            return False
        sure = not share or self.problem.effect(candidate.name).elaborate
        if better <= (self.criteria.certain if sure else self.criteria.standard_errors) * error:
            return False
        p_value, others = screening.p_value(candidate), screening.base.estimate.active
        if not others or not share:
            return p_value <= self.criteria.p_value
        return p_value + sum(self.spent.get(name, 0.0) for name in others) <= self.criteria.further

    def best(self, screening: Screening) -> Candidate | None:
        """Of the candidates that count the one with the best score, or a simpler one within a standard error of it.
        Source of the rule: Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2009, section 7.10."""
        passing = [c for c in screening.candidates if self.counts(screening, c)]
        if not passing:
            return None
        best = passing[0]
        simpler = [c for c in passing[1:] if self._preferred(screening, c, best)]
        return simpler[0] if simpler else best

    def _preferred(self, screening: Screening, one: Candidate, best: Candidate) -> bool:
        """A special case of the best one also where that closes hardly more: what is left may be an error of the model
        in another place, or of an integrator."""
        if one.name in self.problem.effect(best.name).simpler:
            more = screening.rms(one.model) - screening.rms(best.model)
            return _as_good(one, best) or more < self.criteria.share * self.gap
        fewer = count_of_numbers(self.problem, one.guess) < count_of_numbers(self.problem, best.guess)
        return fewer and _as_good(one, best)


def _as_good(one: Candidate, best: Candidate) -> bool:
    if one.model is None or best.model is None:
        return False
    worse, error = best.model.better_than(one.model)
    return worse <= error


def select(
    problem: Problem,
    start: Guess,
    criteria: Criteria,
    notify: Callable[[str], None],
    screen: Callable[[Guess | Model], Screening],
) -> Selection:
    """From a recalibrated guess without effects to the model that explains the record. screen: the scores of the whole
    catalogue beside a model."""
    known: dict[tuple[str, ...], Screening] = {}

    def screened(base: Guess | Model) -> Screening:
        active = base.active if isinstance(base, Guess) else base.estimate.active
        key = tuple(sorted(active))
        if key not in known or (isinstance(base, Model) and base.score > known[key].base.score + 1.0):
            known[key] = screen(base)
            best = known[key].candidates[:3]
            notify(
                f"beside {', '.join(active) or 'the physics'}: " + ", ".join(f"{c.name} {c.gain:+.1f}" for c in best)
            )
        return known[key]

    first = screened(start)
    noise = first.noise**0.5
    if first.base.free_run is not None:  # of segments; the free run over sequences has errors of its own scale
        judge = Judge(problem, criteria, first.rms(), float("inf"), {})
    else:
        judge = Judge(problem, criteria, max(first.rms() - noise, 0.0), noise, {})
    model = _settled(judge, screened, first.base)
    for other in _other_beginnings(criteria, first, model):
        found = _settled(judge, screened, other)
        if found.better_than(model)[0] > found.better_than(model)[1]:
            model = found
    last, screenings = _judged(problem, screened, model)
    if screenings and min(_p_value(one, name) for name, one in screenings.items()) > criteria.p_value:
        alone = judge.best(first)  # none is certain beside the others
        last, screenings = _judged(problem, screened, alone.model if alone and alone.model else first.base)
    return Selection(first.base, last.base, screenings, first, last, min(first.noise, last.noise))


def _judged(
    problem: Problem, screened: Callable[[Guess | Model], Screening], model: Model
) -> tuple[Screening, dict[str, Screening]]:
    """The screening beside a model, and those without each of its effects."""
    last = screened(model)
    names = model.estimate.active
    return last, {name: _with_known(screened(without(problem, model, name)), last) for name in names}


def _p_value(screening: Screening, name: str) -> float:
    return next(screening.p_value(c) for c in screening.candidates if c.name == name)


def _settled(judge: Judge, screened: Callable[[Guess | Model], Screening], model: Model) -> Model:
    """Forward steps and exchanges until nothing changes."""
    for _ in range(_ROUNDS):
        before = set(model.estimate.active)
        while len(model.estimate.active) < judge.criteria.most:
            screening = screened(model)
            best = judge.best(screening)
            if best is None or best.model is None:
                break
            judge.spent[best.name] = screening.p_value(best)
            model = best.model
        model = _pruned(judge, screened, model)
        if set(model.estimate.active) == before or not model.estimate.active:
            break
    return model


def _pruned(judge: Judge, screened: Callable[[Guess | Model], Screening], model: Model) -> Model:
    """Every effect in turn, the first that came in first: what is best in its place, if anything?"""
    for name in model.estimate.active:
        if name not in model.estimate.active:
            continue  # it left with another one
        smaller = _with_known(screened(without(judge.problem, model, name)), screened(model))
        best = judge.best(smaller)
        if best is not None:
            judge.spent[best.name] = smaller.p_value(best)
        model = smaller.base if best is None or best.model is None else best.model
    return model


def _other_beginnings(criteria: Criteria, first: Screening, model: Model) -> Sequence[Model]:
    """The effect that does best alone may be none of two that only do well together."""
    left = first.rms(model) > criteria.above * first.noise**0.5
    possible = [c for c in first.candidates if c.model and first.p_value(c) <= criteria.further]
    others = [c.model for c in possible if c.model and c.name not in model.estimate.active]
    return others[: criteria.beam] if left else []


def _with_known(screening: Screening, beside: Screening) -> Screening:
    """The screening without an effect, with the model that has it in the place of a worse fit of it."""
    fitted = beside.base
    (name,) = set(fitted.estimate.active) - set(screening.base.estimate.active)
    own = next((c for c in screening.candidates if c.name == name), None)
    other_segments = fitted.counts.shape != screening.base.counts.shape  # scores of longer ones do not compare
    if other_segments or (own is not None and own.score >= fitted.score):
        return screening
    gain = nats(1.0 - fitted.estimate.cost / screening.base.estimate.cost, screening.size)
    known = Candidate(name, float(gain), fitted.estimate.guess, fitted)
    others = [c for c in screening.candidates if c.name != name]
    return screening._replace(candidates=tuple(sorted((known, *others), key=lambda c: (-c.score, -c.gain))))


def without(problem: Problem, model: Model, name: str) -> Guess:
    """A guess without one effect, its numbers neutral."""
    guess = model.estimate.guess
    theta = guess.theta.copy()
    theta[problem.of(name)] = problem.theta[problem.of(name)]
    return Guess(tuple(n for n in guess.active if n != name), theta, guess.x0)
