"""A robot that nothing was settled on: a UR5, in whose description all friction is missing, and one thing more."""

import numpy as np
import pinocchio as pin
import pytest
from robots import published

import pgrssnn_jax as pg

DT, LINES = 0.02, np.array([0.08, 0.17, 0.31, 0.5])  # s, Hz
VISCOUS, COULOMB = np.array([3, 4, 2, 0.6, 0.5, 0.4]), np.array([5, 6, 4, 1.2, 1.0, 0.8])  # Nm s/rad, Nm


def recorded(file, seed, sequences, payload=0.0, home=0.0, gain=1.0):
    rng, model = np.random.default_rng(seed), pin.buildModelFromUrdf(str(file))
    model.friction[:] = model.damping[:] = 0.0
    n, time = model.nv, DT * np.arange(1, 601)[None, :, None, None]
    size = rng.normal(size=(sequences, 1, n, len(LINES))) * np.array([0.5, 0.25, 0.12, 0.06])
    w = 2 * np.pi * LINES
    angle = w * time + rng.uniform(0, 2 * np.pi, size.shape)
    q, v, a = ((size * wave).sum(-1) for wave in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
    body = pin.Inertia(payload, np.zeros(3), payload * 0.05**2 * np.eye(3))
    model.appendBodyToJoint(n, body, pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.0])))
    data = model.createData()
    moved = [pin.rnea(model, data, *one).copy() for one in zip(*(x.reshape(-1, n) for x in (q, v, a)), strict=True)]
    torque = (np.reshape(moved, q.shape) + VISCOUS * v + COULOMB * np.sign(v)) / gain
    u = torque + 0.01 * np.abs(torque).max((0, 1)) * rng.normal(size=q.shape)
    names = ({f"{what}_{i + 1}": unit for i in range(n)} for what, unit in (("torque", "Nm"), ("position", "rad")))
    inputs, outputs = names
    return pg.record(u, q + home + 1e-4 * rng.normal(size=q.shape), dt=DT, inputs=inputs, outputs=outputs)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "name", "key", "value"),
    [
        ({"payload": 2.0}, "payload", "mass", 2.0),
        ({"home": np.array([0, -0.6, 0, 0, 0, 0])}, "home_offset", "offset", [0, -0.6, 0, 0, 0, 0]),
        ({"gain": np.array([1, 1.12, 1, 1, 1, 1])}, "torque_gain", "gain", [1, 1.12, 1, 1, 1, 1]),
    ],
)
def test_friction_and_one_thing_more_are_found_with_their_numbers(changes, name, key, value):
    file = published("ur5_joint_limited_robot.urdf")
    physics = pg.physics.arm(urdf=file, dt=DT)
    found = pg.discover(physics, recorded(file, 1, 8, **changes), recorded(file, 2, 3, **changes), quiet=True)
    numbers = {e.name: {k: np.asarray(p["value"]) for k, p in e.parameters.items()} for e in found.effects}
    assert found.verdict == "effect_found"
    assert set(numbers) == {"viscous_friction", "coulomb_friction", name}
    np.testing.assert_allclose(numbers["viscous_friction"]["B"], VISCOUS, rtol=0.05)
    np.testing.assert_allclose(numbers["coulomb_friction"]["Tc"], COULOMB, rtol=0.03)
    np.testing.assert_allclose(numbers[name][key], value, rtol=0.03, atol=1e-3)
