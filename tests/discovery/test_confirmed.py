"""What the test record confirms and refutes: verdicts made by hand."""

import pytest
from discovery.by_hand import model, screening

from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.verdict import Judgement, Verdict, confirmed, mostly_open, without_correction
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.tanks import cascaded_tanks

NAME = "bypass"


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = cascaded_tanks()
    return build_problem(physics, [e for e in catalogue(physics) if e.name == NAME], accelerate=False)


@pytest.mark.parametrize(
    ("verdict", "expected"),
    [
        (Verdict.NO_DISCREPANCY, Verdict.NOT_CONFIRMED),
        (Verdict.MISCALIBRATED, Verdict.NOT_CONFIRMED),
        (Verdict.UNEXPLAINED, Verdict.UNEXPLAINED),
        (Verdict.EFFECT_FOUND, Verdict.EFFECT_FOUND),
    ],
)
def test_a_correction_that_alone_was_found_and_is_refuted_is_not_confirmed(verdict, expected):
    assert without_correction(Judgement(verdict, None, {})).verdict is expected


@pytest.mark.parametrize("verdict", list(Verdict))
def test_the_test_record_refutes_findings_alone(verdict):
    given = Judgement(verdict, None, {})
    refuted = verdict in (Verdict.EFFECT_FOUND, Verdict.AMBIGUOUS)
    for improvement, relative in (((-0.01, 0.2), 0.1), ((0.1, 0.2), 1.0)):
        assert confirmed(given, improvement, relative).verdict is (Verdict.NOT_CONFIRMED if refuted else verdict)
    assert confirmed(given, (0.1, 0.2), 0.1) is given


@pytest.mark.parametrize("verdict", list(Verdict))
def test_names_that_leave_most_of_large_errors_do_not_explain_them(verdict):
    given = Judgement(verdict, None, {})
    found = verdict in (Verdict.EFFECT_FOUND, Verdict.AMBIGUOUS)
    assert confirmed(given, (0.1, 0.2), 0.1, mostly_open=True).verdict is (Verdict.UNEXPLAINED if found else verdict)
    refuted = confirmed(given, (-0.1, 0.2), 0.1, mostly_open=True).verdict
    assert refuted is (Verdict.NOT_CONFIRMED if found else verdict)


@pytest.mark.parametrize(("energy", "closed", "expected"), [(4.1, 0.49, True), (4.1, 0.51, False), (3.9, 0.49, False)])
def test_most_is_open_where_errors_are_clearly_above_the_noise_and_half_of_the_gap_is_left(
    problem, energy, closed, expected
):
    last = screening(model(problem, energy, (NAME,)), {})
    selection = Selection(model(problem, 9.0), last.base, {}, screening(model(problem, 9.0), {}), last, 1.0)
    assert mostly_open(selection, closed, Criteria()) == expected


@pytest.mark.parametrize(("improvement", "refuted"), [((-0.3, -0.1), True), ((-0.1, 0.1), False), ((0.1, 0.2), False)])
def test_names_that_stand_for_an_unknown_effect_must_do_no_harm(improvement, refuted):
    given = Judgement(Verdict.UNKNOWN_EFFECT, None, {NAME: ()})
    expected = Verdict.NOT_CONFIRMED if refuted else Verdict.UNKNOWN_EFFECT
    assert confirmed(given, improvement, 2.0).verdict is expected
    nobody = given._replace(alternatives={})
    assert confirmed(nobody, improvement, 2.0) is nobody, "the recalibrated physics may do harm"
