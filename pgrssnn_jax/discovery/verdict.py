"""What may be said, and with what right.

no_discrepancy   the nominal physics is as good as the recalibrated one, and its errors are noise
miscalibrated    only parameters were wrong, and the errors that are left are noise
effect_found     named effects close the gap
ambiguous        named effects close it, but others predict as well on these data
unknown_effect   what is missing is in no catalogue, but the errors follow the signals
unexplained      errors stand clearly above the noise, and nothing accounts for most of them
not_confirmed    something was found on the estimation record, and the test record refutes it
"""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.discovery.candidates import Candidate, Model, Screening
from pgrssnn_jax.discovery.nameless import Nameless, least_fall
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria

EXPLAINED = 0.5  # part of the gap that names must close to be more than a help: 463 right answers close 0.65 at least
# Standard errors by which a correction without a name predicts better where the test record must confirm it, too: 95 %
# intervals without zero. Where fits see segments no test record does (`certain`).
_BETTER = 2.0


class Verdict(StrEnum):
    NO_DISCREPANCY = "no_discrepancy"
    MISCALIBRATED = "miscalibrated"
    EFFECT_FOUND = "effect_found"
    AMBIGUOUS = "ambiguous"
    UNKNOWN_EFFECT = "unknown_effect"
    UNEXPLAINED = "unexplained"
    NOT_CONFIRMED = "not_confirmed"


class Clear(NamedTuple):
    """Do errors stand clearly above the noise, on the estimation record and on the test record?"""

    estimation: bool
    test: bool


NEAR_THE_NOISE = Clear(estimation=False, test=False)


class Judgement(NamedTuple):
    """unnamed: the screening and candidate of the correction that no name covers; alternatives: per effect, candidates
    that predict as well in its place."""

    verdict: Verdict
    unnamed: tuple[Screening, Candidate] | None
    alternatives: dict[str, tuple[Candidate, ...]]


def judge(
    problem: Problem,
    selection: Selection,
    nameless: Nameless,
    nominal: float,
    criteria: Criteria,
    convention: str | None = None,
) -> Judgement:
    """On the estimation record alone. nominal: weighted RMS error of the nominal physics, with its best initial state;
    convention: an effect that is none."""
    unnamed = _unnamed(selection, nameless, criteria)
    active = [name for name in selection.final.estimate.active if name != convention]
    alternatives = {name: _alternatives(problem, selection.screenings[name], name, criteria) for name in active}
    if unnamed is not None or nameless.line is not None or _dependent(nameless, criteria):
        verdict = Verdict.UNKNOWN_EFFECT
    elif active:
        verdict = Verdict.AMBIGUOUS if any(alternatives.values()) else Verdict.EFFECT_FOUND
    elif selection.last.rms() > criteria.clear * selection.floor:
        verdict = Verdict.UNEXPLAINED
    else:
        shifted = nominal > criteria.shifted * selection.first.rms()
        verdict = Verdict.MISCALIBRATED if shifted else Verdict.NO_DISCREPANCY
    return Judgement(verdict, unnamed, alternatives)


def with_channels(judgement: Judgement, selection: Selection, elsewhere: Mapping[str, Sequence[Model]]) -> Judgement:
    """The same where an effect at another channel is as likely: that is an alternative, too."""
    others = dict(judgement.alternatives)
    for name, models in elsewhere.items():
        gain = next((c.gain for c in selection.screenings[name].candidates if c.name == name), 0.0)
        others[name] = (*others.get(name, ()), *(Candidate(name, gain, one.estimate.guess, one) for one in models))
    verdict = judgement.verdict
    if verdict is Verdict.EFFECT_FOUND and any(others.values()):
        verdict = Verdict.AMBIGUOUS
    return judgement._replace(verdict=verdict, alternatives=others)


def reading_convention(problem: Problem, model: Model) -> str | None:
    """`input_delay` where it is one sample to within its 95 % interval, of every input: a logger that reads before the
    inputs act, and no effect."""
    name, physics = "input_delay", problem.physics
    if name not in model.estimate.active or physics.output_timing != "after_step":
        return None
    places = problem.of(name)
    away, deviation = np.abs(model.estimate.theta[places] - physics.dt), model.deviation[places]
    return name if np.all((away <= 2.0 * deviation) & (2.0 * deviation < physics.dt)) else None


def without_correction(judgement: Judgement) -> Judgement:
    """Of a judgement without the correction that the test record refutes. Where it alone was found, near the noise,
    that finding is not confirmed."""
    nothing = judgement.verdict in (Verdict.NO_DISCREPANCY, Verdict.MISCALIBRATED)
    return judgement._replace(verdict=Verdict.NOT_CONFIRMED) if nothing else judgement


def clear_of_noise(selection: Selection, error: float, noise: float, criteria: Criteria) -> Clear:
    """error: of the model that predicts the test record best; noise: in the same metric. Where fits see segments, runs
    of whole sequences have errors of their own scale, and the test record does not count."""
    segmented = selection.final.free_run is not None
    there = not segmented and error > criteria.clear * noise
    return Clear(selection.last.rms() > criteria.clear * selection.floor, there)


def confirmed(
    judgement: Judgement,
    improvement: tuple[float, float],
    relative_error: float,
    *,
    closed: float = 1.0,
    clear: Clear = NEAR_THE_NOISE,
) -> Judgement:
    """The same after the test record: an improvement whose interval contains none, or a model that predicts no better
    than the mean of the record (error relative to its standard deviation), is no finding; nor are effects that stand
    for an unknown one and do harm. Effects that close less than half of the gap (`closed`) help, but do not explain
    errors clear of the noise. Where nothing is named and only the test record has such errors, something is missing all
    the same."""
    if clear.test and judgement.verdict in (Verdict.NO_DISCREPANCY, Verdict.MISCALIBRATED, Verdict.NOT_CONFIRMED):
        return judgement._replace(verdict=Verdict.UNEXPLAINED)
    found = judgement.verdict in (Verdict.EFFECT_FOUND, Verdict.AMBIGUOUS)
    harmful = refuted_names(judgement, improvement)
    if harmful or (found and (improvement[0] <= 0.0 or relative_error >= 1.0)):
        return judgement._replace(verdict=Verdict.NOT_CONFIRMED)
    if found and any(clear) and closed < EXPLAINED:
        return judgement._replace(verdict=Verdict.UNEXPLAINED)
    return judgement


def refuted_names(
    judgement: Judgement, improvement: tuple[float, float], relative_error: float = 0.0, *, clear: bool = False
) -> tuple[str, ...]:
    """Named effects that stand for an unknown one, where they make the test record worse; others that are no finding
    there (`confirmed`), where errors are clear of the noise: something else is missing."""
    harmful = judgement.verdict is Verdict.UNKNOWN_EFFECT and improvement[1] < 0.0
    found = judgement.verdict in (Verdict.EFFECT_FOUND, Verdict.AMBIGUOUS)
    helps = improvement[0] > 0.0 and relative_error < 1.0
    return tuple(judgement.alternatives) if harmful or (found and clear and not helps) else ()


def _unnamed(selection: Selection, nameless: Nameless, criteria: Criteria) -> tuple[Screening, Candidate] | None:
    """A correction without a name that beats the null and predicts better than the named effects, in their place or
    beside them, by a good part of the gap or of what they leave. In the place of names, which have beaten the null, it
    is a further look and has the p-value of a further effect."""
    final = selection.final
    segmented = final.free_run is not None  # the names of an arm act on all joints, a correction on one
    beside = criteria.nameless if final.estimate.active and not segmented else criteria.share
    sure = criteria.certain if segmented else _BETTER
    wanted = [(nameless.alone, final, criteria.share, criteria.further)] if nameless.alone else []
    wanted.append((nameless.beside, nameless.beside.base, beside, criteria.p_value))
    for screening, rival, share, p_value in wanted:
        for one in screening.candidates:
            if one.model is None or screening.p_value(one) > p_value:
                continue
            closed = selection.last.rms() - screening.rms(one.model)
            better, error = _compared(one.model, rival)
            if closed >= least_fall(selection, criteria, share) and better > sure * error:
                return screening, one
    return None


def as_good_as_names(
    judgement: Judgement, selection: Selection, nameless: Nameless, criteria: Criteria
) -> tuple[Screening, Candidate] | None:
    """The best correction in the place of named effects, where the estimation record cannot tell the two apart: by its
    left-out blocks the effects are no better within two standard errors, and nothing else was found, or only that the
    errors follow the signals. Where other names predict as well, one of them may be what the test record asks for."""
    final, screening = selection.final, nameless.alone
    only_follow = judgement.verdict is Verdict.UNKNOWN_EFFECT and judgement.unnamed is None and nameless.line is None
    if screening is None or not (judgement.verdict is Verdict.EFFECT_FOUND or only_follow):
        return None
    for best in screening.candidates:  # by their scores
        if best.model is not None and screening.p_value(best) <= criteria.further:
            worse, error = final.better_than(best.model)
            return (screening, best) if worse <= _BETTER * error else None
    return None


def _compared(one: Model, other: Model) -> tuple[float, float]:
    """How much better one predicts, and the standard error: left-out blocks, or whole sequences where fits see segments
    of them."""
    return one.better_than(other) if one.free_run is None else one.nearer_than(other)


def _dependent(nameless: Nameless, criteria: Criteria) -> bool:
    """Do the errors follow the signals by some law?"""
    follows = nameless.follows
    return follows is not None and follows.share >= criteria.follows and follows.p_value <= criteria.p_value


def _alternatives(problem: Problem, screening: Screening, name: str, criteria: Criteria) -> tuple[Candidate, ...]:
    """Candidates that predict as well in the place of an effect, or under which the record is as likely: with more
    numbers they predict left-out blocks worse, whatever is true. Simpler forms of it aside, because they were
    preferred."""
    own = next((c for c in screening.candidates if c.name == name), None)
    if own is None or own.model is None:
        return ()
    rivals = []
    for other in screening.candidates:
        related = other.name in problem.effect(name).simpler or name in problem.effect(other.name).simpler
        if other.name == name or related or other.model is None or screening.redundant(other.name):
            continue
        worse, error = _compared(own.model, other.model)
        better, base_error = other.model.better_than(screening.base)
        counts = better > criteria.standard_errors * base_error and screening.p_value(other) <= criteria.further
        if counts and (worse <= criteria.tied * error or own.gain - other.gain <= criteria.alike):
            rivals.append(other)
    return tuple(rivals)
