"""Every effect of an arm against Pinocchio's dynamics with other torques or masses, and against the arm without it."""

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from arm_cases import DT, NUMBERS, SPEED, effect, mapped, samples
from toys import quick_jit

import pgrssnn_jax as pg
from pgrssnn_jax.effects.base import SignalRange, add
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.tables import described, pinocchio_model

pytestmark = pytest.mark.usefixtures("x64")
KUKA = described("kuka_kr300")
G = KUKA.gear
EULER = arm(integrator="euler", dt=DT, limits=False)


def with_drive(drive, v):
    return drive - G**2 * KUKA.viscous * v - G * KUKA.coulomb * np.sign(v)


def coupled(u, v):
    drive = G * u
    drive[3] += 0.1 * drive[4] - 0.2 * drive[5]
    drive[4] += 0.3 * drive[5]
    tau, speed = with_drive(drive, v), v[5] - 0.7 * v[4]
    tau[4:] -= np.array([-0.7, 1.0]) * (G[5] ** 2 * 0.02 * speed + abs(G[5]) * 0.3 * np.tanh(speed / 0.02))
    return tau


def balanced(q, u, v):
    tau = with_drive(G * u, v)
    tau[1] -= 300.0 * np.sin(q[1] - 0.4)
    return tau


TORQUES = {
    "torque_gain": lambda q, v, u: with_drive(np.linspace(0.8, 1.2, 6) * G * u, v),
    "wrist_coupling": lambda q, v, u: coupled(u, v),
    "torque_bias": lambda q, v, u: with_drive(G * u, v) + np.linspace(-4.0, 5.0, 6),
    "gravity_counterbalance": lambda q, v, u: balanced(q, u, v),
    "viscous_friction": lambda q, v, u: with_drive(G * u, v) - G**2 * np.linspace(0.0, 0.01, 6) * v,
    "coulomb_friction": lambda q, v, u: with_drive(G * u, v) - G * np.linspace(0.1, 0.4, 6) * np.tanh(v / 0.02),
    "linear_spring": lambda q, v, u: with_drive(G * u, v) - np.linspace(20.0, 200.0, 6) * q,
    "asymmetric_friction": lambda q, v, u: (
        with_drive(G * u, v)
        - np.abs(G) * np.linspace(-0.2, 0.3, 6) * np.tanh(v / 0.02) ** 2
        - G**2 * np.linspace(-0.002, 0.005, 6) * np.abs(v)
    ),
    "stribeck_friction": lambda q, v, u: (
        with_drive(G * u, v) - G * np.linspace(0.3, 0.1, 6) * np.exp(-((v / 0.2) ** 2)) * np.tanh(v / 0.02)
    ),
}


@pytest.mark.parametrize(("name", "backend"), [*((name, "pinocchio") for name in TORQUES), ("wrist_coupling", "jax")])
def test_torques_accelerate_as_in_pinocchio(name, backend):
    x, u = samples(20)
    found = (np.asarray(mapped(name, backend, euler=True)(x, u)[0]) - x)[:, 6:] / DT
    model = pinocchio_model(KUKA)
    data = model.createData()
    expected = [
        pin.aba(model, data, q, v, TORQUES[name](q, v, a)).copy() for q, v, a in zip(*halves(x), u, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


def halves(x):
    return x[:, :6], x[:, 6:]


def loaded() -> pin.Model:
    model = pinocchio_model(KUKA)
    load = pin.Inertia(40.0, np.zeros(3), 40.0 * 0.2**2 * np.eye(3))
    model.appendBodyToJoint(6, load, pin.SE3(np.eye(3), np.array([0.1, -0.2, -0.24 - 0.3])))
    return model


def heavier() -> pin.Model:
    model = pinocchio_model(KUKA)
    model.armature = KUKA.armature + np.linspace(1e-3, 2e-3, 6) * G**2
    return model


def leaning() -> pin.Model:
    model = pinocchio_model(KUKA)
    model.gravity.linear = pin.rpy.rpyToMatrix(0.1, -0.2, 0.0).T @ KUKA.gravity
    return model


@pytest.mark.parametrize(
    ("name", "build"), [("payload", loaded), ("rotor_inertia", heavier), ("gravity_direction", leaning)]
)
def test_masses_accelerate_as_in_pinocchios_changed_model(name, build):
    x, u = samples(20)
    found = (np.asarray(mapped(name, "jax", euler=True)(x, u)[0]) - x)[:, 6:] / DT
    model = build()
    data = model.createData()
    expected = [pin.aba(model, data, q, v, with_drive(G * a, v)).copy() for q, v, a in zip(*halves(x), u, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


def test_a_last_motor_that_turns_with_two_joints_weighs_on_both():
    """M + c I cᵀ with c = (0, 0, 0, 0, r, 1), solved as a whole."""
    x, u = samples(20)
    inertia, c = 0.004 * G[5] ** 2, np.array([0.0, 0.0, 0.0, 0.0, 0.8, 1.0])
    heavier = add(EULER, effect("wrist_coupling"), numbers={"wrist_coupling": {"J": 0.004, "ratio": 0.8}})
    step = quick_jit(jax.vmap(lambda x, u: heavier.step(heavier.params, x, u)))
    found = (np.asarray(step(x, u)) - x)[:, 6:] / DT
    model = pinocchio_model(KUKA)
    data = model.createData()
    for one, (q, v, motor) in zip(found, zip(*halves(x), u, strict=True), strict=True):
        upper = np.triu(pin.crba(model, data, q))
        whole = upper + np.triu(upper, 1).T + inertia * np.outer(c, c)
        rest = with_drive(G * motor, v) - pin.rnea(model, data, q, v, np.zeros(6))
        np.testing.assert_allclose(one, np.linalg.solve(whole, rest), rtol=1e-8, atol=1e-8)


def test_a_joint_stops_at_its_limit_and_leaves_it_freely():
    x, u = samples(20)
    (found, _), (free, _) = (mapped(name)(x, u) for name in ("joint_limit", None))
    (q, v), (q_free, v_free) = halves(np.asarray(found)), halves(np.asarray(free))
    lower, upper = NUMBERS["joint_limit"]["lower"], NUMBERS["joint_limit"]["upper"]
    np.testing.assert_array_equal(q, np.clip(q_free, lower, upper))
    into = ((q_free >= upper) & (v_free > 0)) | ((q_free <= lower) & (v_free < 0))
    np.testing.assert_array_equal(v[into], 0.0)
    np.testing.assert_allclose(v[~into], v_free[~into], rtol=1e-14)  # two programs, each with its own rounding
    assert into.any()
    assert ((q_free > upper) & (v_free < 0)).any()


def test_stiction_holds_slow_joints_and_lets_fast_ones_go():
    x, u = samples(20)
    x[:, 6:] *= 0.1
    (found, _), (free, _) = (mapped(name)(x, 0.1 * u) for name in ("stiction", None))
    (q, v), (q_free, v_free) = halves(np.asarray(found)), halves(np.asarray(free))
    np.testing.assert_array_equal(q, q_free)
    np.testing.assert_allclose(v, v_free * (1 - np.exp(-((v_free / SPEED) ** 2))), rtol=1e-12, atol=1e-15)
    slow, fast = np.abs(v_free) < 0.1 * SPEED, np.abs(v_free) > 3 * SPEED
    assert np.all(np.abs(v[slow]) <= 0.01 * np.abs(v_free[slow]))
    np.testing.assert_allclose(v[fast], v_free[fast], rtol=2e-4)


def test_a_held_joint_breaks_loose_at_some_torque():
    """Held in every step from rest: a steady push of less than the breakaway moves it by next to nothing."""
    physics = add(
        arm(gravity=[0.0, 0.0, 0.0], coulomb_friction=0.0, limits=False, integrator="euler", backend="pinocchio"),
        effect("stiction"),
        numbers={"stiction": {"speed": np.full(6, 0.1)}},
    )

    def last(u):
        step = jax.vmap(lambda x, u: physics.step(physics.params, x, u))
        return jax.lax.scan(lambda x, _: (step(x, u), None), jnp.zeros((2, 12)), length=30)[0]

    push = np.zeros((2, 6))
    push[:, 0] = 0.1, 5.0
    q = np.asarray(quick_jit(last)(push))[:, 0]
    assert abs(q[0]) < 0.01
    assert q[1] > 0.5


def test_velocities_keep_a_part_of_those_before():
    x, u = samples(20)
    (found, _), (free, _) = (mapped(name)(x, u) for name in ("velocity_disturbance", None))
    np.testing.assert_allclose(found[:, 6:], free[:, 6:] + np.linspace(-0.2, 0.2, 6) * x[:, 6:], rtol=1e-12)
    known, _ = quick_jit(jax.vmap(with_known_disturbance()))(x, u)
    np.testing.assert_allclose(found, known, rtol=1e-12)


def with_known_disturbance():
    physics = arm(backend="pinocchio", velocity_disturbance=np.linspace(-0.2, 0.2, 6))
    return lambda x, u: (physics.step(physics.params, x, u), u)


def test_encoders_show_another_zero():
    """The state is what they read: a run from a reading is that of the arm from where it truly is, between its limits,
    which are places of the encoders."""
    x, u = samples(20)
    shift = np.concatenate([np.linspace(-0.1, 0.1, 6), np.zeros(6)])
    (new, y), (true, q) = mapped("home_offset")(x + shift, u), mapped(None)(x, u)
    free = (np.abs(np.asarray(q)) < KUKA.position_max - 0.1) & (np.asarray(q) > KUKA.position_min + 0.1)
    assert free.mean() > 0.5
    within = np.concatenate([free, free], 1)
    np.testing.assert_allclose(np.asarray(new)[within], (np.asarray(true) + shift)[within], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.asarray(y)[free], (np.asarray(q) + shift[:6])[free], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(y, np.clip(y, KUKA.position_min, KUKA.position_max))


def test_a_counterbalance_is_looked_for_among_torques_that_the_motor_has_to_hold():
    gear, most = np.abs(G), np.arange(1.0, 7.0)
    span = SignalRange(np.zeros((2, 12)), np.array([-most, most]), np.zeros((2, 6)))
    for start in effect("gravity_counterbalance").guesses(span):
        assert 0.05 * gear[1] * most[1] <= start["moment"] <= gear[1] * most[1]


def test_friction_drives_no_joint():
    with pytest.raises(ValueError, match=r"load_friction\.mu: expected 0 to 0.9 , found"):
        pg.add(EULER, "load_friction", mu=-0.1)
