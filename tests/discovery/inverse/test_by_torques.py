"""Hidden effects are found by torques alone, from logs that another library made."""

import json

import numpy as np
import pinocchio as pin
import pytest
from arm_logs import KUKA, log

import pgrssnn_jax as pg
from benchmarks.hidden import arm
from benchmarks.hidden.nominal import nominal
from pgrssnn_jax.physics.arms.tables import pinocchio_model

QUIET = {"network_epochs": 0, "quiet": True}


def discovered(**changes):
    described = pg.physics.arm(gravity=tuple(KUKA.gravity))
    return pg.discover(described, log(1, **changes), log(2, sequences=3, **changes), **QUIET)


def loaded(mass, place, gyration=0.1):
    model = pinocchio_model(KUKA)
    body = pin.Inertia(mass, np.zeros(3), mass * gyration**2 * np.eye(3))
    model.appendBodyToJoint(KUKA.n, body, pin.SE3(np.eye(3), KUKA.tip + np.asarray(place)))
    return model


def heavier(share):
    factor = 1.0 + np.array(share)
    return pinocchio_model(KUKA._replace(mass=factor * KUKA.mass, inertia=factor[:, None, None] * KUKA.inertia))


def numbers(found):
    return {e.name: {k: np.asarray(p["value"]) for k, p in e.parameters.items()} for e in found.effects}


@pytest.mark.slow
def test_a_payload_is_weighed_and_everything_is_told(tmp_path):
    """The tip of this arm points against the last joint's axis: outwards is -z."""
    found = discovered(model=loaded(80.0, (0.05, 0.0, -0.15)))
    assert found.verdict == "effect_found"
    assert [effect.name for effect in found.effects] == ["payload"]
    payload = numbers(found)["payload"]
    assert payload["mass"] == pytest.approx(80.0, rel=0.03)
    assert payload["distance"] == pytest.approx(0.15, abs=0.02)
    assert payload["x"] == pytest.approx(0.05, abs=0.02)
    low, high = found.effects[0].parameters["mass"]["interval"]
    assert low < 80.0 < high
    assert found.gap["after"]["test"] < 0.3 * found.gap["recalibrated"]["test"]
    assert 0.9 < found.gap["closed_fraction"] < 1.1
    assert found.details["evidence"]["kind"] == "inverse_dynamics"
    assert [row["joint"] for row in found.details["joints"]] == [1, 2, 3, 4, 5, 6]
    found.save(tmp_path / "run")
    saved = json.loads((tmp_path / "run" / "discovery.json").read_text(), parse_constant=pytest.fail)
    assert saved["numbers"]["order"] == ["payload"]
    assert {path.stem for path in (tmp_path / "run" / "figures").iterdir()} == {
        "torques", "joints", "candidates", "shifts"
    }  # fmt: skip


@pytest.mark.slow
def test_nothing_is_found_where_friction_is_ten_per_cent_off():
    found = discovered(friction=1 + 0.1 * np.array([1, -1, 1, -1, 1, -1]))
    assert found.verdict in ("no_discrepancy", "miscalibrated")
    assert not found.effects
    assert found.gap["closed_fraction"] == pytest.approx(0.0, abs=0.05)
    assert found.gap["floor"] <= found.gap["after"]["train"]
    assert found.details["evidence"]["torque_read"] == "position read after"  # of these logs


@pytest.mark.slow
def test_a_held_torque_acts_half_a_sample_before_its_reading():
    """Read at another moment, speeds are wrong by the acceleration in it, and motor inertia makes good for that."""
    case = arm.build(777011, noise=0.01)
    found = pg.discover(nominal(case), case.train, case.test, **QUIET)
    assert found.details["evidence"]["torque_read"] == "position read half a sample later"
    assert found.verdict == "miscalibrated"
    assert not found.effects


@pytest.mark.slow
def test_noise_of_the_torques_is_known_for_noise():
    """All of it: positions are filtered, torques are not."""
    noise = 0.2  # Nm
    found = discovered(torque_noise=noise)
    assert found.verdict == "no_discrepancy"
    expected = np.mean([noise / joint["std"] for joint in found.details["joints"]])
    assert found.gap["floor"] == pytest.approx(expected, rel=0.2)


@pytest.mark.slow
def test_inverted_gravity_and_a_turned_joint_are_found_behind_a_payload():
    """A wrong structure and what could stand in for it, both."""
    upside_down = KUKA._replace(gravity=-KUKA.gravity)
    model = pinocchio_model(upside_down)
    body = pin.Inertia(60.0, np.zeros(3), 60.0 * 0.01 * np.eye(3))
    model.appendBodyToJoint(KUKA.n, body, pin.SE3(np.eye(3), KUKA.tip + np.array([0.0, 0.0, -0.1])))
    home = np.array([0.0, 0.0, -np.pi / 2, 0.0, 0.0, 0.0])
    found = numbers(discovered(tables=upside_down, model=model, home=home))
    assert {"gravity_direction", "home_offset", "payload"} <= set(found)
    assert abs(found["gravity_direction"]["about_x"]) == pytest.approx(np.pi, abs=0.02)
    np.testing.assert_allclose(found["home_offset"]["offset"], home, atol=0.02)
    assert found["payload"]["mass"] == pytest.approx(60.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes", "key", "value"),
    [
        ("torque_bias", {"bias": np.array([0.0, 150.0, -80.0, 0.0, 0.0, 0.0])}, "theta", [0, 150, -80, 0, 0, 0]),
        ("home_offset", {"home": np.array([0, 0.06, -0.05, 0, 0, 0])}, "offset", [0, 0.06, -0.05, 0, 0, 0]),
        ("load_friction", {"load": np.array([0, 0.1, 0, 0, 0, 0])}, "mu", [0, 0.1, 0, 0, 0, 0]),
        ("link_mass", {"model": heavier([0, 0, 0.25, 0, 0, 0])}, "share", [0, 0, 0.25, 0, 0, 0]),
        ("torque_gain", {"gain": np.array([1, 1, 1.12, 1, 1, 1])}, "gain", [1, 1, 1.12, 1, 1, 1]),
    ],
)
def test_single_effects_are_named_with_their_joints(name, changes, key, value):
    found = discovered(**changes)
    assert found.effects[0].name == name
    np.testing.assert_allclose(numbers(found)[name][key], value, rtol=0.15, atol=0.1 * np.abs(value).max())


@pytest.mark.slow
@pytest.mark.parametrize("angle", [-3.0, 1.5])
def test_a_spring_that_pushes_is_no_other_structure(angle):
    found = discovered(balance=(2400.0, angle), noise=1e-3)
    assert [effect.name for effect in found.effects] == ["gravity_counterbalance"]
    spring = numbers(found)["gravity_counterbalance"]
    assert spring["moment"] == pytest.approx(2400.0, rel=0.03)
    assert spring["angle"] == pytest.approx(angle, abs=0.03)


@pytest.mark.slow
def test_a_torque_that_no_effect_describes_is_unknown_and_its_joint_is_told():
    found = discovered(wave=300.0)
    assert found.verdict == "unknown_effect"
    assert found.gap["floor"] < 0.9 * found.gap["after"]["test"]
    assert found.details["follows"]["joints"] == [3]
    assert found.details["follows"]["share"] > 0.5
    assert found.details["formula"].startswith("torques of joint 3 follow the positions")
    assert found.details["formula"] in found.details["sentence"]


@pytest.mark.slow
def test_what_the_user_leaves_out_is_neither_named_nor_untestable():
    known, changes = pg.physics.arm(gravity=tuple(KUKA.gravity)), {"bias": np.array([0, 150.0, -80.0, 0, 0, 0])}
    records = log(1, **changes), log(2, sequences=3, **changes)
    found = pg.discover(known, *records, without=["torque_bias"], **QUIET)
    assert "torque_bias" not in [effect.name for effect in found.effects]
    assert "torque_bias" not in [one["name"] for one in found.details["untestable"]]
    assert "torque_bias" not in [row["name"] for row in found.details["ranking"]]


@pytest.mark.slow
def test_friction_that_is_another_one_is_named_with_its_joint():
    more = np.array([1.0, 1.0, 1.5, 1.0, 1.0, 1.0])
    names = {effect.name: effect.joints for effect in discovered(friction=more).effects}
    assert set(names) == {"coulomb_friction", "viscous_friction"}
    assert set(names.values()) == {(3,)}


@pytest.mark.slow
def test_what_has_changed_since_an_earlier_log_is_all_that_is_named():
    """A calibrated arm, then a tool and a bearing that has stiffened."""
    bias, stiff = np.array([0.0, 150.0, -80.0, 0.0, 0.0, 0.0]), np.array([1.0, 1.0, 1.6, 1.0, 1.0, 1.0])
    calibrated = discovered(bias=bias).physics
    changes = {"bias": bias, "friction": stiff, "model": loaded(40.0, (0.0, 0.0, -0.1))}
    later = pg.discover(calibrated, log(3, **changes), log(4, sequences=3, **changes), **QUIET)
    assert later.effects[0].name == "payload"
    assert {effect.name for effect in later.effects} == {"payload", "coulomb_friction", "viscous_friction"}
    assert numbers(later)["payload"]["mass"] == pytest.approx(40.0, rel=0.05)
    assert {effect.joints for effect in later.effects if effect.name != "payload"} == {(3,)}
