"""From records and settings to what training needs: parts, windows, units, and bad input before any work."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small import simulated

from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Signal
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.build import record_from
from pgrssnn_jax.records.record import Record, crop, stack
from pgrssnn_jax.training.members import Member
from pgrssnn_jax.training.plan import MemberTests, Plan, member_tests, plan_training, sharing_devices
from pgrssnn_jax.training.recipes import DEFAULT, RECIPES
from pgrssnn_jax.training.settings import training_settings

TANKS = cascaded_tanks()._replace(outputs=(Signal("level_voltage", "V", range=(-1.0, 20.0)),))
WHOLE = simulated(TANKS, samples=60, seed=1, noise=0.1)
OTHER = simulated(TANKS, samples=30, seed=2, noise=0.1)


def plan(train: Record = WHOLE, validation: Record | None = None, model: str = "pg_rssnn", **settings: Any) -> Plan:
    chosen = training_settings(model, {"hidden": 3, "n_seeds": 2, **settings})
    return plan_training(TANKS, train, chosen, validation=validation)


def of_members(found: Plan, test: Record = OTHER, wanted=(0, 5)) -> MemberTests:
    return member_tests(found.fit.objective, found.members, found.units, wanted, test)


def test_the_tail_validates_where_nothing_is_said():
    found = plan()
    assert (found.data.train.u.shape, found.data.validation.u.shape) == ((2, 1, 45, 1), (2, 1, 15, 1))
    np.testing.assert_array_equal(found.train.u[0], WHOLE.u[:, :45])
    np.testing.assert_array_equal(found.validation.y[1], WHOLE.y[:, 45:])
    assert found.members == [Member(0, 0), Member(1, 0)]
    assert found.data.train.u.dtype == np.float32


def test_the_part_that_came_with_the_data_validates_unless_another_is_given():
    whole = WHOLE._replace(validation=OTHER)
    assert plan(whole).data.validation.u.shape == (2, 1, 30, 1)
    assert plan(whole).data.train.u.shape == (2, 1, 60, 1)
    assert plan(whole, crop(OTHER, 0, 20)).data.validation.u.shape == (2, 1, 20, 1)


def test_windows_cut_training_sequences_only():
    found = plan(validation=OTHER, window=16)
    assert found.data.train.u.shape == (2, 3, 16, 1)
    np.testing.assert_array_equal(found.train.u[0].reshape(-1), WHOLE.u[0, :48, 0])
    assert found.data.validation.u.shape == (2, 1, 30, 1)
    assert of_members(found).record.u.shape == (2, 1, 30, 1)
    with pytest.raises(ValueError, match="data.window: expected between 1 and 60 samples .*, found 61"):
        plan(validation=OTHER, window=61)


def test_realisations_are_trained_with_every_seed():
    two = stack([WHOLE, WHOLE._replace(y=WHOLE.y + 1.0)])
    found = plan(two, seed=3)
    assert found.members == [Member(3, 0), Member(4, 0), Member(3, 1), Member(4, 1)]
    np.testing.assert_allclose(found.data.train.y[2] - found.data.train.y[0], 1.0, rtol=1e-5)
    assert found.train.u.shape == (2, 1, 45, 1)
    shared = of_members(found)
    np.testing.assert_array_equal(shared.measured.u, np.stack([OTHER.u] * 4))
    own = of_members(found, stack([OTHER, OTHER._replace(y=OTHER.y + 2.0)]))
    np.testing.assert_allclose(own.measured.y[2] - own.measured.y[0], 2.0)
    with pytest.raises(ValueError, match="data: test: expected one record, or 2, one per dataset, found 3"):
        of_members(found, stack([OTHER] * 3))


def test_without_networks_one_seed_says_all():
    assert plan(model="physics_only").members == [Member(0, 0)]


def test_standardised_signals_return_to_measured_units():
    physics = lgssm()
    draw = np.random.default_rng(0)
    u, y = draw.normal(2.0, 3.0, (80, 1)), draw.normal(-1.0, 0.5, (80, 1))
    train = record_from(u, y, dt=1.0, inputs={"u": ""}, outputs={"y": ""}, start="rest")
    settings = training_settings(
        "pg_rssnn", {"published_scaling": True, "n_seeds": 2, "hidden": 3, "window": 20, "initial_state": "zero"}
    )
    found = plan_training(physics, train, settings)
    worked = found.data.train
    np.testing.assert_allclose(worked.u.mean((1, 2)), 0.0, atol=1e-5)
    for unit, own, measured in ((found.units.u, worked.u, found.train.u), (found.units.y, worked.y, found.train.y)):
        back = unit.offset[:, None, None] + unit.scale[:, None, None] * own
        np.testing.assert_allclose(back, np.broadcast_to(measured, back.shape), rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(found.validation.u[0], train.u[:, 60:])
    given = of_members(found, train)
    np.testing.assert_array_equal(given.measured.u[0], train.u)
    np.testing.assert_allclose(
        given.record.u[0], (train.u - found.units.u.offset[0]) / found.units.u.scale[0], rtol=1e-4, atol=1e-6
    )


def test_records_in_other_units_are_converted():
    millivolts = {"inputs": {"pump_voltage": "mV"}, "outputs": {"level_voltage": "mV"}}
    other = record_from(1e3 * WHOLE.u, 1e3 * WHOLE.y, dt=4.0, **millivolts)
    np.testing.assert_allclose(plan(other).data.train.y, plan().data.train.y, rtol=1e-5)
    np.testing.assert_allclose(of_members(plan(), other).measured.y[0], WHOLE.y, rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "start", "windows"),
    [
        ("zero", "unknown", [0, 5]),
        ("first_output", "unknown", [1, 5]),
        ("first_output", "shared", [0, 5]),
        ("estimated", "unknown", [7]),
    ],
)
def test_samples_that_say_where_a_test_record_starts_are_not_reported(kind, start, windows):
    train = WHOLE._replace(info=replace(WHOLE.info, start=start))
    found = plan(train, initial_state=kind, n_init=7)
    assert found.fit.objective.initial == InitialState(kind, 7, start == "shared")
    assert of_members(found).n_inits == windows
    with pytest.raises(ValueError, match="report_n_init: expected a count below the 30 samples of the test record"):
        of_members(found, wanted=(30, 50))


def wrong(**changes: Any) -> Record:
    return WHOLE._replace(**changes)


@pytest.mark.parametrize(
    ("train", "validation", "settings", "sentence"),
    [
        (wrong(y=100.0 * WHOLE.y), None, {}, "data: train: level_voltage: expected -1 to 20 V, .*: are they in V"),
        (WHOLE, OTHER._replace(y=OTHER.y - 1e3), {}, "data: validation: level_voltage: expected .* V, found values"),
        (wrong(u=1e19 + WHOLE.u), None, {}, "data: train: expected values up to 1e.18, found 1e.19"),
        (wrong(mask=np.zeros_like(WHOLE.mask)), OTHER, {}, "data.train: expected at least one measured output"),
        (WHOLE, None, {"initial_state": "estimated", "n_init": 45}, "n_init: expected fewer than the 15 samples"),
        (WHOLE, None, {"folds": 1}, "data.folds: expected 0 .* or at least 2, found 1"),
        (WHOLE, None, {"devices": 99}, "devices"),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence_before_any_work(train, validation, settings, sentence):
    with pytest.raises(ValueError, match=sentence):
        plan(train, validation, **settings)


def test_a_record_of_another_physics_is_refused():
    other = record_from(np.zeros((60, 1)), np.ones((60, 1)), dt=4.0, inputs={"u": ""}, outputs={"y": ""})
    for call in (lambda: plan(other), lambda: plan(validation=other), lambda: of_members(plan(), other)):
        with pytest.raises(ValueError, match=r"data: (train|validation|test): inputs: expected those of the physics"):
            call()


def test_without_acceleration_one_device_maps_the_members():
    found = plan(accelerate=False)
    assert found.mapping.devices == 1
    assert plan(devices=2).mapping.devices == 2


def test_own_data_takes_the_kernel_where_there_is_one_and_benchmarks_keep_xla(monkeypatch):
    monkeypatch.setattr("pgrssnn_jax.training.plan.missing_kernels", lambda: None)
    assert training_settings("pg_rssnn", DEFAULT.settings(discovered=False)).members.recurrence == "auto"
    assert plan().fit.objective.route == "native"
    assert plan().mapping.how == "loop"
    assert plan(recurrence="xla").fit.objective.route is None
    for name, recipe in RECIPES.items():
        for discovered in (False, True):
            assert recipe.settings(discovered=discovered)["recurrence"] == "xla", name


@pytest.mark.parametrize(
    ("model", "settings"),
    [("pg_rssnn", {"accelerate": False}), ("pg_rssnn_fb", {}), ("pg_fcssnn", {}), ("physics_only", {}), ("w_pgnn", {})],
)
def test_what_has_no_recurrence_of_its_own_or_no_acceleration_takes_xla(monkeypatch, model, settings):
    monkeypatch.setattr("pgrssnn_jax.training.plan.missing_kernels", lambda: None)
    assert plan(model=model, **settings).fit.objective.route is None
    with pytest.raises(ValueError, match="members.recurrence: expected xla or auto here, found native: "):
        plan(model=model, recurrence="native", **settings)


def test_devices_share_the_sequences_of_one_member_where_that_pays():
    spec = ModelSpec(hidden=64, gru_layers=3)
    assert sharing_devices(spec, 60, 605) == 2
    assert sharing_devices(spec, 1, 36_300) == 1  # one sequence cannot be shared
    assert sharing_devices(ModelSpec(), 31, 64) == 1


def test_a_kernel_that_is_missing_is_done_without_or_named(monkeypatch):
    monkeypatch.setattr("pgrssnn_jax.training.plan.missing_kernels", lambda: "no C++ compiler found")
    assert plan(recurrence="auto").fit.objective.route is None
    with pytest.raises(ValueError, match="members.recurrence: expected xla or auto here, found native: no C"):
        plan(recurrence="native")
    with pytest.raises(ValueError, match=r"members.recurrence: expected .*, found .torch"):
        plan(recurrence="torch")
