"""What may be said: every verdict, from selections and corrections made by hand, in units of the noise."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pytest
from discovery.by_hand import CERTAIN, NOISE, SAMPLES, model, screening

from pgrssnn_jax.discovery.candidates import Model
from pgrssnn_jax.discovery.follows import Follows
from pgrssnn_jax.discovery.nameless import Nameless
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.spectrum import Line
from pgrssnn_jax.discovery.verdict import (
    Judgement,
    Verdict,
    as_good_as_names,
    judge,
    refuted_names,
    with_channels,
)
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.tanks import cascaded_tanks

NAME, RIVAL = "bypass", "leak_tank1"
CORRECTION = "lower_level by upper_level"


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = cascaded_tanks()
    return build_problem(physics, [e for e in catalogue(physics) if e.name in (NAME, RIVAL)], accelerate=False)


class Examined(NamedTuple):
    judgement: Judgement
    selection: Selection
    nameless: Nameless


def judged(problem: Problem, *errors: float, **more: Any) -> Judgement:
    return examined(problem, *errors, **more).judgement


def examined(
    problem: Problem,
    recalibrated: float,
    named: float | None = None,
    *,
    nominal: float = 1.0,
    rivals: Mapping[str, Model] | None = None,
    beside: float | Model | None = None,
    instead: float | Model | None = None,
    p_value: float = CERTAIN,
    line: Line | None = None,
    follows: Follows | None = None,
    runs: np.ndarray | None = None,
) -> Examined:
    """Energies of the recalibrated physics, with the named effect, and with a correction beside it or instead; nominal:
    errors relative to the recalibrated ones; runs: errors of the final model over whole sequences, where fits see
    segments."""
    base = model(problem, recalibrated)
    final = (base if named is None else model(problem, named, (NAME,)))._replace(free_run=runs)
    first = screening(base, {} if named is None else {NAME: final, **(rivals or {})})
    selection = Selection(base, final, {} if named is None else {NAME: first}, first, screening(final, {}), 1.0)

    def corrected(above: Model, best: float | Model | None):
        if best is None:
            return screening(above, {})
        better = best if isinstance(best, Model) else model(problem, best, (*above.estimate.active, CORRECTION))
        return screening(above, {CORRECTION: better}, {CORRECTION: p_value})

    alone = None if named is None else corrected(base, instead)
    nameless = Nameless(corrected(final, beside), alone, line, follows)
    judgement = judge(problem, selection, nameless, nominal * first.rms(), Criteria())
    return Examined(judgement, selection, nameless)


@pytest.mark.parametrize(
    ("recalibrated", "nominal", "expected"),
    [
        (1.0, 1.0, Verdict.NO_DISCREPANCY),
        (1.0, 1.2, Verdict.MISCALIBRATED),
        (3.9, 1.0, Verdict.NO_DISCREPANCY),  # rms error below `clear` times the noise
        (4.1, 1.0, Verdict.UNEXPLAINED),
        (4.1, 1.2, Verdict.UNEXPLAINED),
        (1e4, 30.0, Verdict.UNEXPLAINED),
    ],
)
def test_without_an_effect_the_size_of_the_errors_decides(problem, recalibrated, nominal, expected):
    assert judged(problem, recalibrated, nominal=nominal).verdict is expected


def test_names_that_close_the_gap_are_found(problem):
    found = judged(problem, 1e4, 1.0)
    assert found.verdict is Verdict.EFFECT_FOUND
    assert found.unnamed is None


def test_a_rival_that_predicts_as_well_makes_it_ambiguous_and_a_worse_one_does_not(problem):
    near = NOISE + 0.05 * np.random.default_rng(1).standard_normal(NOISE.shape)
    found = judged(problem, 1e4, 1.0, rivals={RIVAL: model(problem, 1.0, (RIVAL,), near)})
    assert found.verdict is Verdict.AMBIGUOUS
    assert [other.name for other in found.alternatives[NAME]] == [RIVAL]
    assert judged(problem, 1e4, 1.0, rivals={RIVAL: model(problem, 1.5, (RIVAL,))}).verdict is Verdict.EFFECT_FOUND


def test_what_is_within_the_end_of_a_fit_is_no_difference_however_sure_it_is(problem):
    for energy, expected in ((1.0 + 1e-9, Verdict.AMBIGUOUS), (1.01, Verdict.EFFECT_FOUND)):
        rival = model(problem, energy, (RIVAL,))
        worse = model(problem, 1.0, (NAME,)).blocks - rival.blocks
        assert worse.sum() > 2.0 * len(worse) ** 0.5 * worse.std(ddof=1), "larger in every block, and surely so"
        assert judged(problem, 1e4, 1.0, rivals={RIVAL: rival}).verdict is expected


@pytest.mark.parametrize(("nats", "expected"), [(0.8, Verdict.AMBIGUOUS), (1.2, Verdict.EFFECT_FOUND)])
def test_an_effect_with_more_numbers_is_an_alternative_where_the_record_is_as_likely(problem, nats, expected):
    """It predicts every left-out block worse, as more numbers do."""
    rival = model(problem, np.exp(2.0 * nats / SAMPLES), (RIVAL,))
    rival = rival._replace(squares=1.02 * rival.squares)
    assert judged(problem, 1e4, 1.0, rivals={RIVAL: rival}).verdict is expected


def test_a_correction_is_unknown_where_no_name_helps(problem):
    found = judged(problem, 400.0, beside=100.0)
    assert found.verdict is Verdict.UNKNOWN_EFFECT
    assert found.unnamed is not None
    assert found.unnamed[1].name == CORRECTION
    assert judged(problem, 400.0, beside=100.0, p_value=0.02).verdict is Verdict.UNEXPLAINED, "luck brings as much"


@pytest.mark.parametrize(
    ("named", "corrected", "expected"),
    [
        (9.0, 3.9, Verdict.UNKNOWN_EFFECT),  # half of what names leave is wanted: from an rms error of 3 to 2
        (9.0, 4.1, Verdict.EFFECT_FOUND),
        (3.9, 2.2, Verdict.UNKNOWN_EFFECT),  # near the noise too: from 1.97 to 1.49
        (3.9, 2.3, Verdict.EFFECT_FOUND),
    ],
)
def test_a_correction_of_most_of_what_names_leave_is_unknown(problem, named, corrected, expected):
    assert judged(problem, 4e4, named, beside=corrected).verdict is expected


def test_what_names_leave_may_be_too_little_to_ask(problem):
    """Least is a share of 0.002 of a gap of 1999 noises: 4.0."""
    assert judged(problem, 4e6, 25.0, beside=2.0).verdict is Verdict.EFFECT_FOUND


@pytest.mark.parametrize(
    ("corrected", "expected"), [(2.0, Verdict.UNKNOWN_EFFECT), (144.0, Verdict.EFFECT_FOUND)]
)  # a quarter of the gap of 19 is wanted: from an rms error of 14 to 9.25
def test_beside_names_a_correction_must_close_a_good_part_of_the_gap(problem, corrected, expected):
    assert judged(problem, 400.0, 196.0, beside=corrected).verdict is expected


def test_in_the_place_of_names_less_is_enough_but_it_must_predict_better(problem):
    assert judged(problem, 400.0, 9.0, instead=4.0).verdict is Verdict.UNKNOWN_EFFECT
    uneven = 1.0 + 0.9 * np.where(np.arange(SAMPLES) // 32 % 2, 1.0, -1.0)
    unsure = model(problem, 8.0 / np.mean(uneven), (CORRECTION,), NOISE * np.sqrt(uneven)[None, :, None])
    better, error = unsure.better_than(model(problem, 9.0))
    assert 0.0 < better < 2.0 * error
    assert judged(problem, 400.0, 9.0, instead=unsure).verdict is Verdict.EFFECT_FOUND


@pytest.mark.parametrize(("every", "expected"), [(8, Verdict.EFFECT_FOUND), (5, Verdict.UNKNOWN_EFFECT)])
def test_beside_names_a_correction_must_predict_better_by_two_standard_errors(problem, every, expected):
    """Better in three or four of twenty blocks: by 1.8 or 2.2 standard errors."""
    squares = np.where(np.arange(SAMPLES) // 32 % every, 1.0, 0.7)
    blocks = model(problem, 9.0, error=NOISE * np.sqrt(squares)[None, :, None]).squares
    somewhere = model(problem, 4.0, (CORRECTION,))._replace(squares=blocks)
    better, error = somewhere.better_than(model(problem, 9.0))
    assert error < better < 3.0 * error
    assert judged(problem, 400.0, 9.0, beside=somewhere).verdict is expected


@pytest.mark.parametrize(("errors", "expected"), [(2.5, Verdict.EFFECT_FOUND), (3.5, Verdict.UNKNOWN_EFFECT)])
def test_where_fits_see_segments_a_correction_must_certainly_come_nearer(problem, errors, expected):
    """No test record confirms it there. errors: standard errors of the mean over 16 sequences."""
    spread = np.resize([1.0, -1.0], 16)
    spread *= 16**0.5 / spread.std(ddof=1)
    runs = np.full(16, 9.0)
    nearer = model(problem, 4.0, (NAME, CORRECTION))._replace(free_run=runs * np.exp(-0.1 * (errors + spread)))
    mean, error = nearer.nearer_than(model(problem, 9.0)._replace(free_run=runs))
    assert mean / error == pytest.approx(errors)
    assert judged(problem, 16.0, 9.0, beside=nearer, runs=runs).verdict is expected


@pytest.mark.parametrize(("p_value", "expected"), [(0.04, Verdict.UNKNOWN_EFFECT), (0.06, Verdict.EFFECT_FOUND)])
def test_in_the_place_of_names_a_correction_has_their_p_value_to_spend(problem, p_value, expected):
    assert judged(problem, 400.0, 9.0, instead=4.0, p_value=p_value).verdict is expected


@pytest.mark.parametrize(
    ("instead", "p_value", "expected"),
    [
        (9.0, CERTAIN, True),
        (8.99, CERTAIN, True),
        (9.0, 0.06, False),  # as likely by chance
        (36.0, CERTAIN, False),  # the names predict better
        (4.0, CERTAIN, False),  # it predicts better, and is known already
        (None, CERTAIN, False),
    ],
)
def test_a_correction_in_the_place_of_names_may_be_as_good(problem, instead, p_value, expected):
    found = examined(problem, 400.0, 9.0, instead=instead, p_value=p_value)
    rival = as_good_as_names(*found, Criteria())
    assert (rival is not None) is expected
    assert rival is None or rival[1].name == CORRECTION


def test_where_other_names_predict_as_well_no_correction_takes_their_place(problem):
    found = examined(problem, 400.0, 9.0, rivals={RIVAL: model(problem, 9.0, (RIVAL,))}, instead=9.0)
    assert found.judgement.verdict is Verdict.AMBIGUOUS
    assert as_good_as_names(*found, Criteria()) is None


@pytest.mark.parametrize("line", [None, Line(60.0, 0.1, 0.5, 0)])
def test_so_may_it_where_the_errors_of_the_names_follow_the_signals(problem, line):
    found = examined(problem, 400.0, 49.0, instead=49.0, follows=Follows(0.6, 0.005), line=line)
    assert found.judgement.verdict is Verdict.UNKNOWN_EFFECT
    assert (as_good_as_names(*found, Criteria()) is not None) is (line is None)


def test_nothing_is_as_good_as_no_name(problem):
    assert as_good_as_names(*examined(problem, 1.0), Criteria()) is None


@pytest.mark.parametrize("instead", [4.0, None])
@pytest.mark.parametrize(("improvement", "expected"), [((-0.3, -0.1), (NAME,)), ((-0.3, 0.1), ())])
def test_names_that_stand_for_an_unknown_effect_may_do_harm(problem, instead, improvement, expected):
    found = judged(problem, 400.0, 9.0, instead=instead, beside=None if instead else 4.0)
    assert found.verdict is Verdict.UNKNOWN_EFFECT
    assert refuted_names(found, improvement) == expected


@pytest.mark.parametrize(
    ("improvement", "relative", "expected"),
    [((-0.3, 0.1), 0.5, (NAME,)), ((0.1, 0.3), 1.1, (NAME,)), ((0.1, 0.3), 0.5, ())],
)
def test_names_that_do_not_help_are_refuted_where_errors_are_clear_of_the_noise(
    problem, improvement, relative, expected
):
    found = judged(problem, 400.0, 9.0)
    assert found.verdict is Verdict.EFFECT_FOUND
    assert refuted_names(found, improvement, relative, clear=True) == expected
    assert refuted_names(found, improvement, relative) == ()


def test_a_spectral_line_is_unknown(problem):
    assert judged(problem, 9.0, line=Line(60.0, 0.1, 0.5, 0)).verdict is Verdict.UNKNOWN_EFFECT


@pytest.mark.parametrize(
    ("named", "follows", "expected"),
    [
        (None, Follows(0.6, 0.005), Verdict.UNKNOWN_EFFECT),
        (None, Follows(0.6, 0.05), Verdict.UNEXPLAINED),  # noise of the same colour seems to as well
        (None, Follows(0.05, 0.005), Verdict.UNEXPLAINED),  # nearly all of it is noise in the system
        (49.0, Follows(0.6, 0.005), Verdict.UNKNOWN_EFFECT),  # the names are a help
        (49.0, Follows(0.6, 0.05), Verdict.EFFECT_FOUND),
        (49.0, None, Verdict.EFFECT_FOUND),  # near the noise nobody asks
    ],
)
def test_errors_that_follow_the_signals_are_unknown_also_beside_names(problem, named, follows, expected):
    assert judged(problem, 100.0, named, follows=follows).verdict is expected


@pytest.mark.parametrize("verdict", [Verdict.EFFECT_FOUND, Verdict.UNKNOWN_EFFECT])
def test_an_effect_that_is_as_likely_at_another_channel_is_ambiguous(problem, verdict):
    name, other = "sensor_offset", model(problem, 1.0, ("sensor_offset",))
    beside = screening(model(problem, 100.0), {name: other})
    selection = Selection(beside.base, other, {name: beside}, beside, beside, 1.0)
    given = Judgement(verdict, None, {name: ()})
    assert with_channels(given, selection, {}) == given
    found = with_channels(given, selection, {name: [other]})
    assert found.verdict is (Verdict.AMBIGUOUS if verdict is Verdict.EFFECT_FOUND else verdict)
    (one,) = found.alternatives[name]
    assert one.model is other
    assert one.gain == beside.candidates[0].gain
