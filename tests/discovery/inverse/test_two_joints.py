"""The whole way on an arm of two joints, from arrays to the description of the corrected robot."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.inverse.discover import motion_evidence
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import set_up
from pgrssnn_jax.training.settings import training_settings

DT, BIAS = 0.05, 6.0  # s, Nm
FEW = {"torque_bias", "torque_gain", "viscous_friction", "payload"}


@pytest.fixture(scope="module")
def description(tmp_path_factory):
    file = tmp_path_factory.mktemp("robot") / "crane.urdf"
    link = (
        "<link name='{0}'><inertial><origin xyz='0.2 0 0.3'/><mass value='{1}'/>"
        "<inertia ixx='.1' iyy='.1' izz='.1' ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )
    joint = (
        "<joint name='{0}' type='continuous'><parent link='{1}'/><child link='{2}'/><origin xyz='0 0 0.5'/>"
        "<axis xyz='0 1 0'/><dynamics damping='2.0' friction='1.5'/></joint>"
    )
    links = "".join(link.format(*one) for one in (("base", 9), ("boom", 5), ("jib", 2)))
    joints = joint.format("luff", "base", "boom") + joint.format("fold", "boom", "jib")
    file.write_text(f"<robot name='crane'>{links}{joints}</robot>")
    return file


def recorded(description, seed, sequences, noise=1e-4):
    """Torques by Pinocchio, with a constant one at the second joint that the description does not have. A torque
    and the position beside it belong to one moment. noise: of the positions, rad."""
    rng, t = np.random.default_rng(seed), DT * np.arange(1, 241)[None, :, None, None]
    w = 2 * np.pi * np.array([0.11, 0.23, 0.4])
    size, phase = rng.normal(0, 0.3, (sequences, 1, 2, 3)), rng.uniform(0, 6, (sequences, 1, 2, 3))
    q, v, a = ((size * wave).sum(-1) for wave in (
        np.sin(w * t + phase), w * np.cos(w * t + phase), -(w**2) * np.sin(w * t + phase)
    ))  # fmt: skip
    model = pin.buildModelFromUrdf(str(description))
    model.damping[:] = model.friction[:] = 0.0
    data = model.createData()
    at = np.stack([np.cos(q), np.sin(q)], -1).reshape(*q.shape[:2], 4)  # continuous joints
    runs = zip(at, v, a, strict=True)
    moved = np.stack([[pin.rnea(model, data, *one).copy() for one in zip(*run, strict=True)] for run in runs])
    u = moved + 2.0 * v + 1.5 * np.sign(v) - np.array([0.0, BIAS]) + rng.normal(0, 0.05, v.shape)
    channels = ({f"{what}_{i}": unit for i in (1, 2)} for what, unit in (("torque", "Nm"), ("position", "rad")))
    inputs, outputs = channels
    return pg.record(u, q + rng.normal(0, noise, q.shape), dt=DT, inputs=inputs, outputs=outputs)


def others(crane):
    return sorted({effect.name for effect in pg.effects.catalogue(crane)} - FEW)


def test_arms_with_noisy_positions_are_simulated_and_a_line_says_so(description):
    crane, said = pg.physics.arm(urdf=description, dt=DT), list[str]()
    records = recorded(description, 0, 6, noise=0.1), recorded(description, 1, 3, noise=0.1)
    setup = set_up(crane, *records, DiscoverySettings(), training_settings("pg_rssnn"), notify=said.append)
    said.clear()
    assert motion_evidence(setup, said.append) is None
    need = "accelerations ten times their noise (joints 1, 2 have less)"
    assert said == [f"evidence: simulated runs, because torques need {need}"]
    forced = setup._replace(settings=replace(setup.settings, evidence="inverse_dynamics"))
    assert motion_evidence(forced, said.append) is not None


@pytest.mark.slow
def test_a_constant_torque_is_found_and_the_corrected_robot_is_saved(description, tmp_path):
    crane = pg.physics.arm(urdf=description, dt=DT)
    found = pg.discover(crane, recorded(description, 0, 6), recorded(description, 1, 3), quiet=True)
    assert found.verdict == "effect_found"
    assert [(effect.name, effect.joints) for effect in found.effects] == [("torque_bias", (2,))]
    assert found.effects[0].parameters["theta"]["value"][1] == pytest.approx(BIAS, rel=0.03)
    assert found.gap["after"]["test"] < 0.3 * found.gap["recalibrated"]["test"]
    found.save(tmp_path / "run")
    again = pin.buildModelFromUrdf(str(tmp_path / "run" / "corrected.urdf"))
    np.testing.assert_allclose(again.damping, 2.0, rtol=0.1)
    beside = json.loads((tmp_path / "run" / "corrected.json").read_text())
    assert beside["effects"]["torque_bias"]["theta"]["value"][1] == pytest.approx(BIAS, rel=0.03)


def test_the_constant_torque_is_named_among_few_effects(description, tmp_path):
    crane = pg.physics.arm(urdf=description, dt=DT)
    records = recorded(description, 0, 3), recorded(description, 1, 2)
    found = pg.discover(crane, *records, without=others(crane), quiet=True)
    assert found.details["evidence"]["torque_read"] == "position read after"
    assert [(effect.name, effect.joints) for effect in found.effects] == [("torque_bias", (2,))]
    assert found.verdict == "effect_found"
    assert {row["name"] for row in found.details["ranking"]} <= FEW
    found.save(tmp_path / "run")
    assert (tmp_path / "run" / "corrected.urdf").exists()
    assert [row["horizon_s"] for row in found.details["free_run"]] == [1.0, 5.0, None]
    first = found.details["free_run"][0]  # longer ones of a crane that stands on its head fall over
    assert first["after"] < 0.2 * first["recalibrated"]
    page = (tmp_path / "run" / "report.html").read_text()
    assert "torque_bias" in page
    assert "Free run of the test record by its torques" in page


def test_where_noise_hides_when_a_torque_acts_it_is_held_over_its_sample(description):
    """As a step of the physics takes it. The positions with less noise, above, tell that it acts before its reading."""
    crane = pg.physics.arm(urdf=description, dt=DT)
    records = recorded(description, 0, 3, noise=0.2), recorded(description, 1, 2, noise=0.2)
    found = pg.discover(crane, *records, without=others(crane), evidence="inverse_dynamics", quiet=True)
    assert found.details["evidence"]["torque_read"] == "position read half a sample later"
