"""From predictions to metrics.json: nothing is lost, nothing is averaged over silently."""

from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from small import INFO, small_fit
from toys import quick_jit

from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.records.record import Record, cast, record, stack
from pgrssnn_jax.records.scaling import Affine, Units, identity, in_units
from pgrssnn_jax.training import evaluation as evaluate
from pgrssnn_jax.training.evaluation import Predictions, Trained, predict, predict_from, validated_outputs
from pgrssnn_jax.training.members import Member, MemberMapping, keys_of, map_members, repeat
from pgrssnn_jax.training.optimise import MemberState, MemberStatus
from pgrssnn_jax.training.plan import MemberTests
from pgrssnn_jax.training.settings import FitSettings

MEMBERS = [Member(0, 0), Member(1, 0), Member(2, 0)]


def measured(samples: int = 20, seed: int = 0) -> Record:
    rng = np.random.default_rng(seed)
    return record(rng.normal(size=(2, samples, 1)), rng.normal(size=(2, samples, 1)), INFO)


@cache
def small():
    """The physics alone with trained parameters, which compiles quickly."""
    return small_fit(spec=ModelSpec(networks=False), settings=FitSettings(physics_parameters="trained"))


@cache
def begun():
    fit, data = small()
    return quick_jit(map_members(fit.begin, MemberMapping()))(keys_of(MEMBERS), data)


class Case(NamedTuple):
    state: MemberState
    test: Record
    predictions: Predictions
    validated: np.ndarray


def case(outcomes=(0, 1, 0), finite=(True, True, True)) -> Case:
    """Three members that are wrong by 1, 2 and 3 V everywhere."""
    state = begun()._replace(
        outcome=jnp.array(outcomes, jnp.int32), best_epoch=jnp.array([5, 6, 7]), epoch=jnp.array([9, 9, 9])
    )
    test = stack([measured()] * 3)
    wrong = np.array([1.0, 2.0, 3.0])[:, None, None, None]
    return Case(state, test, Predictions(test.y + wrong, np.array(finite), np.zeros((3, 2, 2))), test.y - wrong)


def trained(state: MemberState, units: Units | None = None, start: np.ndarray | None = None) -> Trained:
    fit, data = small()
    units = units or Units(*(repeat(identity(1), 3) for _ in range(2)))
    start = np.full((3, 2), np.nan) if start is None else start
    return Trained(fit.objective, MemberMapping(), MEMBERS, state, data.scaling, units, start)


def rows_of(state, test, predictions, validated, n_inits=(0, 5)):
    tests = MemberTests(test, test, list(n_inits))
    return evaluate.member_rows(trained(state), tests, predictions, test, validated)


def test_every_member_has_its_figures_and_its_reason():
    rows = rows_of(*case())
    for figures in ("test", "validation"):
        assert [row[figures]["rmse"][0] for row in rows] == pytest.approx([1.0, 2.0, 3.0])
    assert [row["best_epoch"] for row in rows] == [5, 6, 7]
    assert rows[1]["reason"] == MemberStatus.STOPPED_EARLY.sentence
    assert set(rows[0]["by_n_init"]) == {"0", "5"}


def test_a_failed_member_stays_in_the_table_and_out_of_the_means():
    state, test, predictions, validated = case(outcomes=(0, MemberStatus.LOSS_NOT_FINITE, 0))
    rows = rows_of(state, test, predictions, validated)
    assert rows[1]["status"] == "failed"
    assert rows[1]["test"] is None
    mean, deviation = evaluate.ensemble(rows, test, predictions)
    found = evaluate.summary(rows, test, mean, [0, 5])
    assert (found["planned"], found["finished"], found["failed"]) == (3, 2, 1)
    assert found["rmse_mean"] == pytest.approx(2.0)
    assert found["rmse_std"] == pytest.approx(np.std([1, 3], ddof=1))
    assert found["rmse_best"] == pytest.approx(1.0)
    assert found["rmse_ensemble"] == pytest.approx(2.0)
    np.testing.assert_allclose(deviation, 1.0)


def test_a_member_that_diverges_on_the_test_record_has_failed():
    rows = rows_of(*case(finite=(True, True, False)))
    assert [row["status"] for row in rows] == ["ok", "ok", "failed"]
    assert rows[2]["reason"] == MemberStatus.STATE_NOT_FINITE.sentence


def test_no_member_left_gives_no_figures_and_no_error():
    state, test, predictions, validated = case(outcomes=(2, 2, 2))
    rows = rows_of(state, test, predictions, validated)
    mean, _ = evaluate.ensemble(rows, test, predictions)
    found = evaluate.summary(rows, test, mean, [0])
    assert np.isnan(mean).all()
    assert found["finished"] == 0
    assert np.isnan(found["rmse_mean"])
    assert np.isnan(found["rmse_ensemble"])


def test_errors_that_cancel_make_the_ensemble_better_than_its_members():
    state, test, predictions, validated = case()
    predictions = predictions._replace(y=test.y + np.array([-1.0, 0.5, 0.5])[:, None, None, None])
    rows = rows_of(state, test, predictions, validated)
    mean, _ = evaluate.ensemble(rows, test, predictions)
    found = evaluate.summary(rows, test, mean, [0])
    assert found["rmse_ensemble"] == pytest.approx(0.0, abs=1e-12)
    assert found["rmse_best"] == pytest.approx(0.5)


def test_members_with_different_test_records_have_no_ensemble():
    state, test, predictions, validated = case()
    test = stack([measured(seed=0), measured(seed=1), measured(seed=2)])
    rows = rows_of(state, test, predictions, validated)
    mean, _ = evaluate.ensemble(rows, test, predictions)
    assert np.isnan(mean).all()
    assert np.isfinite(evaluate.summary(rows, test, mean, [0])["rmse_mean"])


def test_one_member_has_no_spread():
    state, test, predictions, validated = case(outcomes=(0, 2, 2))
    rows = rows_of(state, test, predictions, validated)
    assert evaluate.summary(rows, test, test.y[0], [0])["rmse_std"] == 0.0


def test_without_a_validation_record_there_are_no_figures_on_it():
    state, test, predictions, _ = case()
    rows = evaluate.member_rows(trained(state), MemberTests(test, test, [5]), predictions)
    assert [row["validation"] for row in rows] == [None] * 3
    assert set(rows[0]["by_n_init"]) == {"5"}


UNITS = Units(
    Affine(np.array([[0.5], [0.0], [-1.0]]), np.array([[2.0], [1.0], [4.0]])),
    Affine(np.array([[1.0], [2.0], [3.0]]), np.array([[2.0], [2.0], [4.0]])),
)


def test_standardised_predictions_return_to_measured_units():
    _, data = small()
    test = cast(stack([measured()] * 3), np.float32)
    (plain, aside), (found, validated) = (
        (predict(trained(begun(), units), test), validated_outputs(trained(begun(), units), data))
        for units in (None, UNITS)
    )
    for i in range(3):
        offset, scale = UNITS.y.offset[i, 0], UNITS.y.scale[i, 0]
        np.testing.assert_allclose(found.y[i], offset + scale * plain.y[i], rtol=1e-6)
        np.testing.assert_allclose(validated[i], offset + scale * aside[i], rtol=1e-6)
    np.testing.assert_array_equal(found.x0, plain.x0)


def test_a_run_from_given_states_takes_inputs_as_measured():
    """From where the runs on a test record began, in standardised units, the same is predicted."""
    one = measured()
    test = cast(in_units(stack([one] * 3), UNITS), np.float32)
    found = predict(trained(begun(), UNITS), test)
    again = predict_from(trained(begun(), UNITS), np.asarray(one.u), found.x0)
    np.testing.assert_allclose(again.y, found.y, rtol=1e-4, atol=1e-4)
    assert again.finite.all()
