"""Which effects are missing: steps forward, then every effect judged again against the model without it.

Forward: of the candidates that beat the null, predict left-out blocks better and close a share of the gap, the one with
the best score enters. Backward: every effect in turn is taken out; what does best in its place comes in, or nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from pgrssnn_jax.discovery.candidates import Candidate, Model, Screening, count_of_numbers, moved, ranked
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


Screened = Callable[[Guess | Model], Screening]


class Chosen(NamedTuple):
    """A model with the p-value with which each of its effects came in last. Their sum bounds the probability that any
    of them is luck."""

    model: Model
    p_values: Mapping[str, float]


class Judge(NamedTuple):
    """When a candidate counts. gap: RMS error of the recalibrated physics above that of the white noise."""

    problem: Problem
    criteria: Criteria
    gap: float
    noise: float

    def counts(self, screening: Screening, candidate: Candidate, p_values: Mapping[str, float]) -> bool:
        """Its gain is significant; it closes its share of the gap and predicts left-out blocks better by more than a
        standard error, or it closes most of the rest and predicts them better with certainty. p_values: of the effects
        of the base."""
        if candidate.model is None or screening.redundant(candidate.name):
            return False
        better, error = candidate.model.better_than(screening.base)
        closed, left = screening.rms() - screening.rms(candidate.model), screening.rms() - self.noise
        share = closed >= self.criteria.share * self.gap
        least = max(self.criteria.rest * left, self.criteria.exact * self.gap)
        if not share and not (left > 0.0 and closed >= least):
            return False
        if candidate.model.free_run is not None:
            nearer, spread = candidate.model.nearer_than(screening.base)
            if nearer <= self.criteria.certain * spread:
                return False
        sure = not share or self.problem.effect(candidate.name).elaborate
        if better <= (self.criteria.certain if sure else self.criteria.standard_errors) * error:
            return False
        p_value, others = screening.p_value(candidate), screening.base.estimate.active
        if not others or not share:
            return p_value <= self.criteria.p_value
        return p_value + sum(p_values.get(name, 0.0) for name in others) <= self.criteria.further

    def best(self, screening: Screening, p_values: Mapping[str, float]) -> Candidate | None:
        """Of the candidates that count the one with the best score, or a simpler one within a standard error of it.
        Source of the rule: Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2009, section 7.10."""
        passing = [c for c in screening.candidates if self.counts(screening, c, p_values)]
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
            sure = not _as_good(one, best, self.criteria.certain)
            least = self.criteria.exact if sure else self.criteria.share
            return _as_good(one, best) or more < least * self.gap
        if best.name in self.problem.effect(one.name).simpler:  # which may have more numbers: one for every input
            return False
        fewer = count_of_numbers(self.problem, one.guess) < count_of_numbers(self.problem, best.guess)
        return fewer and _as_good(one, best)


def _as_good(one: Candidate, best: Candidate, errors: float = 1.0) -> bool:
    """To within so many standard errors."""
    if one.model is None or best.model is None:
        return False
    worse, error = best.model.better_than(one.model)
    return worse <= errors * error


Screenings = dict[tuple[str, ...], Screening]  # by the sorted names of the base's effects


def active_in(base: Guess | Model) -> tuple[str, ...]:
    return base.active if isinstance(base, Guess) else base.estimate.active


def remembered(screen: Screened, known: Screenings, notify: Callable[[str], None]) -> Screened:
    """The scores of the whole catalogue beside a model; each is made once, and kept in `known`."""

    def screened(base: Guess | Model) -> Screening:
        active = active_in(base)
        key = tuple(sorted(active))
        if key not in known or (isinstance(base, Model) and base.score > known[key].base.score + 1.0):
            known[key] = screen(base)
            best = known[key].candidates[:3]
            notify(
                f"beside {', '.join(active) or 'the physics'}: " + ", ".join(f"{c.name} {c.gain:+.1f}" for c in best)
            )
        return known[key]

    return screened


def select(problem: Problem, start: Guess, criteria: Criteria, screened: Screened) -> Selection:
    """From a recalibrated guess without effects to the model that explains the record."""
    first = screened(start)
    judge = _judge(problem, criteria, first)
    model = _settled(judge, screened, Chosen(first.base, {})).model
    for other in _other_beginnings(judge, first, model):
        found = _settled(judge, screened, other).model
        model = found if preferred_model(found, model, criteria.alike) else model
    model = _with_fewest_effects(judge, first, model)
    last, screenings = _judged(problem, screened, model)
    if screenings and min(_p_value(one, name) for name, one in screenings.items()) > criteria.p_value:
        alone = judge.best(first, {})  # none is certain beside the others
        last, screenings = _judged(problem, screened, alone.model if alone and alone.model else first.base)
    return Selection(first.base, last.base, screenings, first, last, min(first.noise, last.noise))


def counting(problem: Problem, criteria: Criteria, first: Screening, screening: Screening) -> bool:
    """Does any candidate of a screening count? first: the screening beside nothing."""
    return _judge(problem, criteria, first).best(screening, {}) is not None


def _judge(problem: Problem, criteria: Criteria, first: Screening) -> Judge:
    if first.base.free_run is not None:  # of segments; the free run over sequences has errors of its own scale
        return Judge(problem, criteria, first.rms(), float("inf"))
    noise = first.noise**0.5
    return Judge(problem, criteria, max(first.rms() - noise, 0.0), noise)


def _judged(problem: Problem, screened: Screened, model: Model) -> tuple[Screening, dict[str, Screening]]:
    """The screening beside a model, and those without each of its effects."""
    last = screened(model)
    names = model.estimate.active
    return last, {name: _with_known(screened(without(problem, model, name)), last) for name in names}


def _p_value(screening: Screening, name: str) -> float:
    return next(screening.p_value(c) for c in screening.candidates if c.name == name)


def _settled(judge: Judge, screened: Screened, chosen: Chosen) -> Chosen:
    """Forward steps and exchanges until nothing changes."""
    for _ in range(_ROUNDS):
        before = set(chosen.model.estimate.active)
        chosen = _pruned(judge, screened, _forward(judge, screened, chosen))
        if set(chosen.model.estimate.active) == before or not chosen.model.estimate.active:
            break
    return chosen


def _forward(judge: Judge, screened: Screened, chosen: Chosen) -> Chosen:
    while len(chosen.model.estimate.active) < judge.criteria.most:
        screening = screened(chosen.model)
        best = judge.best(screening, chosen.p_values)
        if best is None or best.model is None:
            break
        chosen = Chosen(best.model, {**chosen.p_values, best.name: screening.p_value(best)})
    return chosen


def _pruned(judge: Judge, screened: Screened, chosen: Chosen) -> Chosen:
    """Every effect in turn, the first that came in first: what is best in its place, if anything?"""
    model, p_values = chosen
    for name in model.estimate.active:
        if name not in model.estimate.active:
            continue  # it left with another one
        smaller = _with_known(screened(without(judge.problem, model, name)), screened(model))
        best = judge.best(smaller, p_values)
        if best is None or best.model is None:
            model = smaller.base
        else:
            model, p_values = best.model, {**p_values, best.name: smaller.p_value(best)}
    return Chosen(model, p_values)


def preferred_model(one: Model, other: Model, alike: float) -> bool:
    """Does one predict better by more than a standard error, or as well with fewer effects? More effects must make the
    record likelier, too: where two of them say the same as a third, they fit a trifle better."""
    (better, error), more = one.better_than(other), len(one.estimate.active) - len(other.estimate.active)
    least = max(error, alike) if more else error
    return better > least if more >= 0 else -better <= least


def _other_beginnings(judge: Judge, first: Screening, model: Model) -> Sequence[Chosen]:
    """The effect that does best alone may be none of two that only do well together. Where none is certain alone, and
    errors stay clearly above the noise, one of two may be certain beside the other: without it, what the other leaves
    looks like noise with a memory. Near the noise only rivals are tried."""
    criteria, names = judge.criteria, model.estimate.active
    ratio = first.rms(model) / max(first.noise**0.5, 1e-300)
    others = [c for c in first.candidates if c.name not in names]
    if not names:
        tried = others if ratio > criteria.clear else []
        return [Chosen(c.model, {c.name: 0.0}) for c in tried if c.model][: criteria.beam]  # judged beside the other
    tried = others if ratio > criteria.above else _rivals(judge, first, model, others)
    possible = [(c, first.p_value(c)) for c in tried]
    return [Chosen(c.model, {c.name: p}) for c, p in possible if c.model and p <= criteria.further][: criteria.beam]


def _rivals(judge: Judge, first: Screening, model: Model, others: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that alone close the gap as far as the model does, to within the share that deserves a name; none
    where the model leaves nothing that an effect could explain."""
    criteria, reached = judge.criteria, first.rms(model)
    if reached - judge.noise <= criteria.exact * judge.gap:
        return []
    least = reached + criteria.share * judge.gap
    return [c for c in others if judge.counts(first, c, {}) and first.rms(c.model) <= least]


def _with_fewest_effects(judge: Judge, first: Screening, model: Model) -> Model:
    """One effect that predicts as well as several do: each of them came in as the best step at its time."""
    if len(model.estimate.active) < 2:
        return model
    alone = [c for c in first.candidates if judge.counts(first, c, {}) and c.model is not None]
    best = max((c.model for c in alone if c.model is not None), key=lambda one: one.score, default=model)
    worse, error = model.better_than(best)
    return best if worse <= error else model


def _with_known(screening: Screening, beside: Screening) -> Screening:
    """The screening without an effect, with the model that has it in the place of a worse fit of it."""
    fitted = beside.base
    (name,) = set(fitted.estimate.active) - set(screening.base.estimate.active)
    own = next((c for c in screening.candidates if c.name == name), None)
    if own is not None and own.score >= fitted.score:
        return screening
    gain = nats(1.0 - fitted.estimate.cost / screening.base.estimate.cost, screening.size)
    known = Candidate(name, float(gain), fitted.estimate.guess, fitted)
    others = [c for c in screening.candidates if c.name != name]
    return screening._replace(candidates=ranked([known, *others]))


def without(problem: Problem, model: Model, name: str) -> Guess:
    """A guess without one effect, its numbers neutral."""
    guess = model.estimate.guess
    theta = moved(guess.theta, problem.of(name), problem.theta[problem.of(name)])
    return Guess(tuple(n for n in guess.active if n != name), theta, guess.x0)
