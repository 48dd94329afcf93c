"""The measured Stäubli TX40: a description of rigid bodies alone, and a log of motors at 5 kHz."""

import numpy as np
import pytest

import pgrssnn_jax as pg

FOLDER = "staubli_tx40"
TRANSMISSION = np.diag([32.0, 32, 45, -48, 45, 32])
TRANSMISSION[5, 4] = 32.0  # motor 6 turns with joint 5 as well
ZERO = [0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0]
# Least squares on decimated data, and the literature where it names one: link side.
VISCOUS, COULOMB = [8.0, 5.5, 2.0, 1.1, 1.3], [7.4, 8.3, 6.3, 2.6, 3.0]  # Nm s/rad, Nm


@pytest.mark.slow
@pytest.mark.data
def test_friction_rotors_offsets_and_the_coupled_wrist_are_named(data):
    physics = pg.physics.arm(urdf=data / FOLDER / "tx40.urdf", dt=0.01)
    train, test = pg.load_arm_log(
        physics, data / FOLDER / "tx40.npz", time=None, sample_time=2e-4, position="motor_position",
        torque="motor_torque", position_side="motor", position_zero=ZERO, transmission=TRANSMISSION.tolist(),
    )  # fmt: skip
    found = pg.discover(physics, train, test, quiet=True)
    assert found.verdict == "effect_found"
    errors = [joint["all"]["after"] for joint in found.details["joints"]]
    assert max(errors) < 0.25
    assert np.mean(errors) < 0.18
    assert np.mean([joint["all"]["before"] for joint in found.details["joints"]]) > 0.5
    named = {e.name: e.parameters for e in found.effects}
    assert {"viscous_friction", "coulomb_friction", "rotor_inertia", "wrist_coupling"} <= set(named)
    np.testing.assert_allclose(np.array(named["viscous_friction"]["B"]["value"])[:5], VISCOUS, rtol=0.15)
    np.testing.assert_allclose(np.array(named["coulomb_friction"]["Tc"]["value"])[:5], COULOMB, rtol=0.2)
    assert named["torque_bias"]["theta"]["value"][1] == pytest.approx(-1.37, abs=0.6)  # the largest one by far
    wrist = {key: number["value"] for key, number in named["wrist_coupling"].items()}
    assert wrist["ratio"] == pytest.approx(1.0, abs=0.1)
    assert wrist["J"] == pytest.approx(0.010, rel=0.3)
    assert wrist["B"] == pytest.approx(0.616, rel=0.15)
    assert wrist["Tc"] == pytest.approx(1.95, rel=0.3)
