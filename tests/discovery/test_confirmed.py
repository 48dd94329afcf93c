"""What the test record confirms and refutes: verdicts made by hand."""

import pytest
from discovery.by_hand import model, screening

from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.verdict import Clear, Judgement, Verdict, clear_of_noise, confirmed, without_correction
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


@pytest.mark.parametrize("clear", [Clear(True, False), Clear(False, True)])
@pytest.mark.parametrize("verdict", list(Verdict))
def test_names_that_leave_most_of_large_errors_do_not_explain_them(verdict, clear):
    given = Judgement(verdict, None, {})
    found = verdict in (Verdict.EFFECT_FOUND, Verdict.AMBIGUOUS)
    nothing = verdict in (Verdict.NO_DISCREPANCY, Verdict.MISCALIBRATED, Verdict.NOT_CONFIRMED)
    for closed in (0.49, 0.51):
        unexplained = (found and closed < 0.5) or (nothing and clear.test)
        told = confirmed(given, (0.1, 0.2), 0.1, closed=closed, clear=clear).verdict
        assert told is (Verdict.UNEXPLAINED if unexplained else verdict)
    if found:
        assert confirmed(given, (-0.1, 0.2), 0.1, closed=0.49, clear=clear).verdict is Verdict.NOT_CONFIRMED


@pytest.mark.parametrize("verdict", list(Verdict))
def test_near_the_noise_names_may_leave_most_of_the_gap(verdict):
    given = Judgement(verdict, None, {})
    assert confirmed(given, (0.1, 0.2), 0.1, closed=0.1) is given


@pytest.mark.parametrize(("improvement", "refuted"), [((-0.3, -0.1), True), ((-0.1, 0.1), False), ((0.1, 0.2), False)])
def test_names_that_stand_for_an_unknown_effect_must_do_no_harm(improvement, refuted):
    given = Judgement(Verdict.UNKNOWN_EFFECT, None, {NAME: ()})
    expected = Verdict.NOT_CONFIRMED if refuted else Verdict.UNKNOWN_EFFECT
    assert confirmed(given, improvement, 2.0).verdict is expected
    nobody = given._replace(alternatives={})
    assert confirmed(nobody, improvement, 2.0) is nobody, "the recalibrated physics may do harm"


@pytest.mark.parametrize(("energy", "estimation"), [(4.1, True), (3.9, False)])
@pytest.mark.parametrize(
    ("error", "segmented", "test"), [(0.21, False, True), (0.19, False, False), (9.0, True, False)]
)
def test_errors_are_clear_of_the_noise_above_twice_its_size(problem, energy, estimation, error, segmented, test):
    final = model(problem, energy, (NAME,))
    final = final._replace(free_run=(final.estimate.error**2).mean((1, 2)) if segmented else None)
    last = screening(final, {})
    selection = Selection(model(problem, 9.0), final, {}, screening(model(problem, 9.0), {}), last, 1.0)
    assert clear_of_noise(selection, error, 0.1, Criteria()) == Clear(estimation, test)
