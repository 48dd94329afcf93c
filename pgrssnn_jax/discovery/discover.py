"""The whole of a discovery: recalibrate, select, judge, locate, final numbers, validate. Nothing here writes a file.

record, physics ──> recalibrated ──> selected effects ──> judgement ──> final numbers ──> test record, once
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.identify import Combination, Departure
from pgrssnn_jax.discovery.judged import Judged, judged_on_estimation
from pgrssnn_jax.discovery.nameless import Nameless
from pgrssnn_jax.discovery.order import order_may_matter, reversed_on_inputs
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem
from pgrssnn_jax.discovery.responses import path_of
from pgrssnn_jax.discovery.search import Named, Notify, finished, search, timed, with_elaborate_effects
from pgrssnn_jax.discovery.select import Selection, preferred_model
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.discovery.smoother import Correction, smoothed_correction
from pgrssnn_jax.discovery.stretches import end_to_end
from pgrssnn_jax.discovery.tested import tested
from pgrssnn_jax.discovery.unknown import Formula
from pgrssnn_jax.discovery.validate import Proved, Validations
from pgrssnn_jax.discovery.verdict import Clear, Judgement, clear_of_noise, confirmed, with_channels
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


def discover(setup: Setup, notify: Notify) -> Discovery:
    """Of a physics whose free run over the record stays finite (`checks.check_physics`)."""
    chosen = setup.settings
    problem = build_problem(setup.physics, setup.first_effects, fixed=chosen.fixed, accelerate=chosen.accelerate)
    if not chosen.stretches and (reason := problem.code.uncompiled):
        notify(f"free runs take longer, not compiled: {reason}")
    return discover_in(problem, setup, notify)


def discover_in(problem: Problem, setup: Setup, notify: Notify, corrected: Corrected | None = None) -> Discovery:
    """problem: with the effects that are looked for first; corrected: kept where many records are examined with one
    physics and catalogue."""
    chosen, seconds, corrected = setup.settings, dict[str, float](), corrected or Corrected()
    with jax.enable_x64(True):
        named, judged = _in_either_order(problem, setup, corrected, notify, seconds)
        notify("locating: the correction that each equation would need")
        with timed(seconds, "locate"):
            location = _located(named)
        notify("proving: intervals, and the test record")
        named, judged, numbers, proved, refuted = tested(named, judged, setup, seconds)
    told = with_channels(judged.judgement, named.selection, numbers.elsewhere)
    clear, test = clear_of_noise(named.selection, proved.least_error, proved.floor, chosen.criteria), proved.test
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


def _in_either_order(
    problem: Problem, setup: Setup, corrected: Corrected, notify: Notify, seconds: dict[str, float]
) -> tuple[Named, Judged]:
    """Effects, and the verdict on them; those of inputs in the opposite order where that predicts better."""
    found, criteria = _searched(problem, setup, corrected, notify, seconds), setup.settings.criteria
    if not order_may_matter(*found, criteria):
        return found
    notify("looking for effects that act on the inputs in the opposite order")
    turned = setup._replace(effects=reversed_on_inputs(setup.effects))
    whole = corrected.with_catalogue(problem, turned.first_effects)
    other = _searched(whole, turned, corrected, notify, seconds)
    one, before = other[0].selection.final, found[0].selection.final
    return other if preferred_model(one, before, criteria.alike) else found


def _searched(
    problem: Problem, setup: Setup, corrected: Corrected, notify: Notify, seconds: dict[str, float]
) -> tuple[Named, Judged]:
    """Effects, and the verdict on them: with the elaborate ones too where errors or the verdict ask for them."""
    first = search(problem, setup, notify, seconds)
    named = finished(with_elaborate_effects(first, setup, corrected, notify, seconds), seconds)
    judged = _judged(named, corrected, setup, notify, seconds)
    if judged.judgement.unnamed is None:
        return named, judged
    further = with_elaborate_effects(named, setup, corrected, notify, seconds, missing=True)
    if further is named:
        return named, judged
    named = finished(further, seconds)
    return named, _judged(named, corrected, setup, notify, seconds)


def _judged(named: Named, corrected: Corrected, setup: Setup, notify: Notify, seconds: dict[str, float]) -> Judged:
    notify("judging: what corrections without a name would explain")
    with timed(seconds, "judge"):
        return judged_on_estimation(named, corrected, setup.settings)


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
