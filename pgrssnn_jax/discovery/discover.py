"""The whole of a discovery: recalibrate, select, locate, judge, final numbers, validate. Nothing here writes a file.

record, physics ──> recalibrated ──> selected effects ──> judgement ──> final numbers ──> test record, once
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.correction_on_test import improvement_by_correction
from pgrssnn_jax.discovery.estimate import Guess, evaluate
from pgrssnn_jax.discovery.identify import Combination, Departure, Numbers, final_numbers
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.nameless import Nameless, look_beyond
from pgrssnn_jax.discovery.noise import above_white_noise, longest_memory
from pgrssnn_jax.discovery.nonparametric import Corrections
from pgrssnn_jax.discovery.null import LEAST_GAIN
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem
from pgrssnn_jax.discovery.responses import path_of
from pgrssnn_jax.discovery.scoring import Scoring
from pgrssnn_jax.discovery.search import Named, finished, search, timed, with_elaborate_effects
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.discovery.smoother import Correction, smoothed_correction
from pgrssnn_jax.discovery.stretches import end_to_end
from pgrssnn_jax.discovery.unknown import Formula, formula
from pgrssnn_jax.discovery.validate import Proved, Validations, train_validations, validations_on_test
from pgrssnn_jax.discovery.verdict import (
    Clear,
    Judgement,
    Verdict,
    as_good_as_names,
    clear_of_noise,
    confirmed,
    judge,
    reading_convention,
    stand_ins_refuted,
    with_channels,
    without_correction,
)
from pgrssnn_jax.records.record import Record

_LOCATED = 24  # sequences or segments whose correction is estimated


class Location(NamedTuple):
    """signals: sequences whose correction was estimated; correction: of the recalibrated physics; x: its states."""

    signals: Signals
    correction: Correction
    x: Float[np.ndarray, "seq time x"]


class Discovery(NamedTuple):
    """Everything that was found out. signals and estimation: sequences of the record, uncut; convention: the effect
    that says no more than when the data were read; refuted: names of effects, or of a correction without a name, that
    the test record refutes."""

    problem: Problem
    signals: Signals
    estimation: Record
    selection: Selection
    nameless: Nameless
    judgement: Judgement
    clear: Clear
    formula: Formula | None
    location: Location
    convention: str | None
    refuted: tuple[str, ...]
    departures: list[Departure]
    undetermined: list[Combination]
    optimism: float | None
    train: Validations
    test: Validations
    seconds: dict[str, float]

    @property
    def proved(self) -> Proved:
        return Proved(self.estimation, self.train, self.test)


class Judged(NamedTuple):
    """formula: of a correction without a name; convention: an effect that is none, but a way of reading; rms: weighted
    error of the nominal physics."""

    corrections: Corrections
    nameless: Nameless
    rms: float
    judgement: Judgement
    formula: Formula | None
    convention: str | None


class Tested(NamedTuple):
    """refuted: names of effects, or of a correction, that are left out."""

    named: Named
    judged: Judged
    numbers: Numbers
    proved: Proved
    refuted: tuple[str, ...]


def discover(setup: Setup, notify: Callable[[str], None]) -> Discovery:
    """Of a physics whose free run over the record stays finite (`checks.check_physics`)."""
    chosen = setup.settings
    problem = build_problem(setup.physics, setup.first_effects, fixed=chosen.fixed, accelerate=chosen.accelerate)
    if not chosen.stretches and (reason := problem.code.uncompiled):
        notify(f"free runs take longer, not compiled: {reason}")
    return discover_in(problem, setup, notify)


def discover_in(
    problem: Problem, setup: Setup, notify: Callable[[str], None], corrected: Corrected | None = None
) -> Discovery:
    """problem: with the effects that are looked for first; corrected: kept where many records are examined with one
    physics and catalogue."""
    chosen, seconds, corrected = setup.settings, dict[str, float](), corrected or Corrected()
    with jax.enable_x64(True):
        first = search(problem, setup, notify, seconds)
        named = finished(with_elaborate_effects(first, setup, corrected, notify, seconds), seconds)
        notify("locating: the correction that each equation would need")
        with timed(seconds, "locate"):
            location = _located(named)
        notify("judging: what corrections without a name would explain")
        with timed(seconds, "judge"):
            judged = _judged(named, corrected, chosen)
        notify("proving: intervals, and the test record")
        named, judged, numbers, proved, refuted = _tested(named, judged, setup, seconds)
    told = with_channels(judged.judgement, named.selection, numbers.elsewhere)
    test, least = proved.test, min(one.error for one in proved.test.models.values())
    clear = clear_of_noise(named.selection, least, proved.floor, chosen.criteria)
    return Discovery(
        problem=numbers.problem,
        signals=named.how.uncut,
        estimation=proved.estimation,
        selection=named.selection._replace(recalibrated=numbers.recalibrated, final=numbers.final),
        nameless=judged.nameless,
        judgement=confirmed(told, test.improvement, test.relative, closed=proved.closed_fraction, clear=clear),
        clear=clear,
        formula=judged.formula,
        location=location,
        convention=judged.convention,
        refuted=refuted,
        departures=numbers.departures,
        undetermined=numbers.undetermined,
        optimism=numbers.optimism,
        train=proved.train,
        test=proved.test,
        seconds=seconds,
    )


def _judged(named: Named, corrected: Corrected, chosen: DiscoverySettings) -> Judged:
    """Nonparametric corrections beside the names, and the verdict on the estimation record."""
    problem, how, selection = named.problem, named.how, named.selection
    active = tuple(sorted({*selection.final.estimate.active, *selection.last.base.estimate.active}))
    corrections = Corrections(problem, corrected, active, named.known, how.signals, how.settings)
    nameless = look_beyond(corrections, how, selection, chosen.criteria, np.random.default_rng(chosen.seed))
    before = evaluate(problem, how.signals(problem), named.nominal)
    rms = (before.cost / selection.first.size) ** 0.5
    convention = reading_convention(problem, selection.final)
    judgement = judge(problem, selection, nameless, rms, chosen.criteria, convention)
    told = _told(corrections, how, selection, judgement)
    return Judged(corrections, nameless, rms, judgement, told, convention)


def _tested(named: Named, judged: Judged, setup: Setup, seconds: dict[str, float]) -> Tested:
    """Final numbers and validation; effects or a correction that the test record refutes are left out."""
    numbers, proved = _proved(named, setup, seconds)
    with timed(seconds, "prove"):
        judged, replaced = _with_better_correction(named, judged, setup, proved)
    refuted = replaced or stand_ins_refuted(judged.judgement, proved.test.improvement)
    bare = _without_stand_ins(named, judged) if refuted else (named, judged)
    with timed(seconds, "prove"):
        helpful = bare[1] if replaced else _with_helpful_correction(*bare, setup)
    if refuted and helpful:
        return Tested(bare[0], helpful, *_proved(bare[0], setup, seconds), refuted)
    if refuted or helpful:
        return Tested(named, helpful or judged, numbers, proved, ())
    judged, refuted = _without_correction(named, judged, setup)
    return Tested(named, judged, numbers, proved, refuted)


def _with_better_correction(
    named: Named, judged: Judged, setup: Setup, proved: Proved
) -> tuple[Judged, tuple[str, ...]]:
    """Named effects that predict the estimation record no better than a correction in their place, and the test record
    worse, stand for an unknown effect. The judgement that says so, and their names. Where errors have a memory, one
    record holds too few independent ones to compare."""
    selection, criteria = named.selection, setup.settings.criteria
    rival, final = as_good_as_names(judged.judgement, selection, judged.nameless, criteria), selection.final.estimate
    if rival is None or above_white_noise(final.error, named.how.signals(named.problem).weight, criteria.clear):
        return judged, ()
    low, _ = improvement_by_correction(judged.corrections, rival[1], named.nominal, final.guess, setup)
    if low <= criteria.exact * max(proved.test.recalibrated.error - proved.floor, 0.0):
        return judged, ()
    judgement = judged.judgement._replace(verdict=Verdict.UNKNOWN_EFFECT, unnamed=rival)
    told = _told(judged.corrections, named.how, selection, judgement)
    return judged._replace(judgement=judgement, formula=told), tuple(judgement.alternatives)


def _with_helpful_correction(named: Named, judged: Judged, setup: Setup) -> Judged | None:
    """The judgement, if its correction without a name predicts the test record better, or there is none. Of several
    that say the same on the estimation record (a curve of the input, or in the only equation with that input) and go on
    differently beyond it, the first that does."""
    if judged.judgement.unnamed is None or named.how.segmented:
        return judged
    (screening, chosen), final = judged.judgement.unnamed, named.selection.final.estimate.guess
    fitted = [one for one in screening.candidates if one.model and one is not chosen]
    for one in (chosen, *(other for other in fitted if abs(other.score - chosen.score) <= LEAST_GAIN)):
        low, _ = improvement_by_correction(judged.corrections, one, named.nominal, final, setup)
        if low > 0.0:
            judgement = judged.judgement._replace(unnamed=(screening, one))
            told = _told(judged.corrections, named.how, named.selection, judgement)
            return judged if one is chosen else judged._replace(judgement=judgement, formula=told)
    return None


def _without_correction(named: Named, judged: Judged, setup: Setup) -> tuple[Judged, tuple[str, ...]]:
    """The judgement without the correction, and its name."""
    unnamed, (problem, selection) = judged.judgement.unnamed, (named.problem, named.selection)
    assert unnamed is not None
    rest = judged.nameless.without_corrections(), judged.rms, setup.settings.criteria, judged.convention
    again = without_correction(judge(problem, selection, *rest))
    return judged._replace(judgement=again, formula=None), (unnamed[1].name,)


def _without_stand_ins(named: Named, judged: Judged) -> tuple[Named, Judged]:
    """The recalibrated physics, and the correction without a name that was found beside it."""
    alone, selection = judged.nameless.alone, named.selection
    assert alone is not None
    bare = selection._replace(final=selection.recalibrated, screenings={}, last=selection.first)
    judgement = judged.judgement._replace(alternatives={})
    nameless = judged.nameless._replace(beside=alone, alone=None)
    return named._replace(selection=bare), judged._replace(nameless=nameless, judgement=judgement, convention=None)


def _proved(named: Named, setup: Setup, seconds: dict[str, float]) -> tuple[Numbers, Proved]:
    """Final numbers, and all models on the estimation record uncut and on the test record."""
    problem, how, selection, chosen = named.problem, named.how, named.selection, setup.settings
    with timed(seconds, "numbers"):
        numbers = final_numbers(problem, how, selection, chosen.tolerance, chosen.criteria)
    with timed(seconds, "prove"):
        guesses = (named.nominal, numbers.recalibrated.estimate.guess, numbers.final.estimate.guess)
        whole = setup.estimation._replace(u=how.uncut.u, y=how.uncut.y, mask=how.uncut.weight > 0)
        memory = longest_memory(numbers.final.estimate.error)
        train = train_validations(problem, whole, guesses, how.uncut.start if how.segmented else None)
        test = validations_on_test(problem, setup, guesses, numbers.without, how.settings, memory)
    return numbers, Proved(whole, train, test)


def _told(corrections: Corrections, how: Scoring, selection: Selection, judgement: Judgement) -> Formula | None:
    """The formula of a correction without a name."""
    if judgement.unnamed is None:
        return None
    screening, best = judgement.unnamed
    flexible = corrections.by_all() if how.segmented else corrections.by(best.name)
    signals = how.signals(flexible)
    guess = best.model.estimate if best.model else best.guess
    _, x = simulate(flexible, signals.u, guess.theta[None], guess.x0[None])
    return formula(flexible, signals, screening, best, x[0])


def _located(named: Named) -> Location:
    """The correction signal of the recalibrated physics on the first sequences."""
    problem, how, selection = named.problem, named.how, named.selection
    record = how.signals(problem)
    pieces = len(record.u) // len(how.uncut.u)  # segments of each sequence
    count = pieces * max(1, _LOCATED // pieces)
    few = Signals(*(a[:count] for a in record))
    base = selection.recalibrated.estimate
    path = path_of(problem, few, Guess((), base.theta, base.x0[:count]))
    correction = smoothed_correction(problem, few, path, base.error[:count], selection.noise**0.5)
    correction = correction._replace(mean=end_to_end(correction.mean, pieces), std=end_to_end(correction.std, pieces))
    u, y, weight, block = (end_to_end(a, pieces, axis=0) for a in few[:4])
    whole = Signals(u, y, weight, block, few.start[::pieces], few.precision[::pieces])
    return Location(whole, correction, end_to_end(path.x, pieces, axis=0))
