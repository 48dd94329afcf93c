"""What the test record leaves of names that stand for an unknown effect: a curved sensor, which the catalogue lacks, in
the estimation record alone."""

import pytest
from discovery.small_cases import choices, setup_of
from discovery.test_further import PLAIN, problem_of, record_of

from pgrssnn_jax.discovery.discover import Discovery, discover_in
from pgrssnn_jax.discovery.verdict import Verdict

NAME = "sensor_offset"


def found_where(bend: float) -> Discovery:
    problem = problem_of(*PLAIN)
    train, test = record_of(600, bend, seed=1), record_of(600, 0.0, seed=11)
    return discover_in(problem, setup_of(problem, train, test, choices(n_init=1, fixed=["C"])), lambda line: None)


def test_harmful_names_are_left_out_where_errors_are_clear_without_them():
    found = found_where(0.05)
    assert found.selection.first.rms() > 2.0 * found.selection.floor
    assert found.judgement.verdict in (Verdict.UNKNOWN_EFFECT, Verdict.UNEXPLAINED)
    assert found.refuted[0] == NAME
    assert found.selection.final.estimate.active == ()
    assert found.formula is None
    assert found.test.after.error == pytest.approx(found.test.recalibrated.error)


def test_harmful_names_near_the_noise_are_not_confirmed():
    found = found_where(0.008)
    assert found.selection.first.rms() < 1.5 * found.selection.floor
    assert found.judgement.verdict is Verdict.NOT_CONFIRMED
    assert found.refuted == ()
    assert found.selection.final.estimate.active == (NAME,)
