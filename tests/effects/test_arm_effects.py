from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toys import quick_jit

from pgrssnn_jax.effects.arm import arm_effects
from pgrssnn_jax.effects.base import Effect, SignalRange, add
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.tables import described, pinocchio_model
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.check import check_physics

pytestmark = pytest.mark.usefixtures("x64")
KUKA = described("kuka_kr300")
DT = 0.01  # s, of one Euler step, which shows the acceleration
NAMES = {
    "torque_gain",
    "wrist_coupling",
    "torque_bias",
    "gravity_counterbalance",
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "payload",
    "rotor_inertia",
    "gravity_direction",
    "joint_limit",
    "stiction",
    "velocity_disturbance",
    "home_offset",
}
MASSES = {"payload", "rotor_inertia", "gravity_direction"}
SPEED = np.linspace(0.01, 0.4, 6)
NUMBERS: dict[str, dict[str, Any]] = {
    "torque_gain": {"gain": np.linspace(0.8, 1.2, 6)},
    "wrist_coupling": {"c45": 0.1, "c46": -0.2, "c56": 0.3},
    "torque_bias": {"theta": np.linspace(-4.0, 5.0, 6)},
    "gravity_counterbalance": {"moment": 300.0, "angle": 0.4},
    "viscous_friction": {"B": np.linspace(0.0, 0.01, 6)},
    "coulomb_friction": {"Tc": np.linspace(0.1, 0.4, 6)},
    "stribeck_friction": {"torque": np.linspace(0.3, 0.1, 6), "speed": 0.2},
    "payload": {"mass": 40.0, "distance": 0.3},
    "rotor_inertia": {"J": np.linspace(1e-3, 2e-3, 6)},
    "gravity_direction": {"about_x": 0.1, "about_y": -0.2},
    "joint_limit": {"lower": np.full(6, -0.4), "upper": np.linspace(0.1, 0.6, 6)},
    "stiction": {"speed": SPEED},
    "velocity_disturbance": {"S": np.linspace(-0.2, 0.2, 6)},
    "home_offset": {"offset": np.linspace(-0.1, 0.1, 6)},
}


def samples(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """States, some beyond the limits, the first at rest at zero; motor torques."""
    draw = np.random.default_rng(seed)
    x, u = draw.uniform(-1.5, 1.5, (count, 12)), 3.0 * draw.normal(size=(count, 6))
    x[0] = 0.0
    return x, u


def effect(name: str) -> Effect:
    return next(e for e in arm_effects(arm()) if e.name == name)


def changed(name: str, physics: Physics, neutral: bool = False) -> Physics:
    return add(physics, effect(name), numbers=None if neutral else {name: NUMBERS[name]})


@cache
def mapped(name: str | None, backend: str = "pinocchio", neutral: bool = False, euler: bool = False):
    """(x, u) `[batch, ...]` to the next states and their outputs. Pinocchio's backend compiles in no time."""
    physics = arm(backend=backend, **({"integrator": "euler", "dt": DT, "limits": False} if euler else {}))
    physics = physics if name is None else changed(name, physics, neutral)

    def both(x, u):
        new = physics.step(physics.params, x, u)
        return new, physics.measure(physics.params, new, u)

    return quick_jit(jax.vmap(both))


def backend_of(name: str) -> str:
    return "jax" if name in MASSES else "pinocchio"


def test_the_arms_effects_have_their_names():
    assert {e.name for e in arm_effects(arm())} == NAMES


@pytest.mark.parametrize("name", sorted(NAMES))
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_neutral_numbers_change_nothing(name, seed):
    backend = backend_of(name)
    with jax.enable_x64(True):
        given_ = samples(8, seed)
        (x, y), (expected_x, expected_y) = (mapped(n, backend, True)(*given_) for n in (name, None))
    np.testing.assert_allclose(x, expected_x, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(y, expected_y, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", sorted(NAMES))
def test_other_numbers_change_something(name):
    (x, y), (other_x, other_y) = (mapped(n, backend_of(name))(*samples(20)) for n in (name, None))
    assert max(np.abs(x - other_x).max(), np.abs(y - other_y).max()) > 1e-4


G = KUKA.gear


def with_drive(drive, v):
    return drive - G**2 * KUKA.viscous * v - G * KUKA.coulomb * np.sign(v)


def coupled(u, v):
    drive = G * u
    drive[3] += 0.1 * drive[4] - 0.2 * drive[5]
    drive[4] += 0.3 * drive[5]
    return with_drive(drive, v)


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
    "stribeck_friction": lambda q, v, u: (
        with_drive(G * u, v) - G * np.linspace(0.3, 0.1, 6) * np.exp(-((v / 0.2) ** 2)) * np.tanh(v / 0.02)
    ),
}


@pytest.mark.parametrize(("name", "backend"), [*((name, "pinocchio") for name in TORQUES), ("wrist_coupling", "jax")])
def test_torques_accelerate_as_in_pinocchio(name, backend):
    x, u = samples(12)
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
    load = pin.Inertia.FromDynamicParameters(np.array([40.0, *[0.0] * 9]))
    model.appendBodyToJoint(6, load, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.24 - 0.3])))
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
    x, u = samples(12)
    found = (np.asarray(mapped(name, "jax", euler=True)(x, u)[0]) - x)[:, 6:] / DT
    model = build()
    data = model.createData()
    expected = [pin.aba(model, data, q, v, with_drive(G * a, v)).copy() for q, v, a in zip(*halves(x), u, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)


def test_a_joint_stops_at_its_limit_and_leaves_it_freely():
    x, u = samples(60)
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
    x, u = samples(40)
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
    """The state is what they read: a run from a reading is that of the arm from where it truly is."""
    x, u = samples(20)
    shift = np.concatenate([np.linspace(-0.1, 0.1, 6), np.zeros(6)])
    (new, y), (true, q) = mapped("home_offset")(x + shift, u), mapped(None)(x, u)
    np.testing.assert_allclose(new, np.asarray(true) + shift, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(y, np.asarray(q) + shift[:6], rtol=1e-9, atol=1e-12)


def test_known_disturbances_are_not_looked_for():
    known = arm(velocity_disturbance=0.1)
    assert {e.name for e in arm_effects(known)} == NAMES - {"velocity_disturbance"}
    known = arm(velocity_disturbance=0.1, torque_bias=1.0)
    assert {e.name for e in arm_effects(known)} == NAMES - {"velocity_disturbance", "torque_bias"}


@pytest.fixture
def crane(tmp_path) -> Physics:
    """Two joints from a URDF."""
    link = "<inertial><origin xyz='0.1 0 0.3'/><mass value='2'/><inertia ixx='.1' iyy='.1' izz='.1' {}/></inertial>"
    link = link.format("ixy='0' ixz='0' iyz='0'")
    joint = (
        "<joint name='{1}_joint' type='continuous'><parent link='{0}'/><child link='{1}'/><axis xyz='0 1 0'/></joint>"
    )
    parts = [f"<link name='{name}'>{link}</link>" for name in ("boom", "jib")]
    parts += [joint.format(*pair) for pair in (("base", "boom"), ("boom", "jib"))]
    file = tmp_path / "crane.urdf"
    file.write_text(f"<robot name='crane'><link name='base'/>{''.join(parts)}</robot>")
    return arm(urdf=file)


def signal_range_of(physics: Physics) -> SignalRange:
    draw = np.random.default_rng(0)
    x, u = (np.sort(draw.normal(size=(2, len(s))), 0) for s in (physics.states, physics.inputs))
    return SignalRange(x, u, x[:, : len(u[0])])


def test_any_arm_takes_its_effects(crane):
    effects = arm_effects(crane)
    assert {e.name for e in effects} == NAMES - {"wrist_coupling"}
    check_physics(add(crane, *effects), "crane")


@pytest.mark.parametrize("name", sorted(NAMES))
def test_fits_start_from_numbers_that_an_effect_may_have(name, crane):
    for physics in (arm(), crane):
        for one in (e for e in arm_effects(physics) if e.name == name):
            starts = one.initial_guesses(signal_range_of(physics))
            assert starts
            for start in starts:
                add(physics, one, numbers={name: start})
                assert set(start) == set(one.parameters)
                for key, value in start.items():
                    low, high = one.parameters[key].bounds
                    assert np.all(np.isfinite(value) & (value >= low) & (value <= high))


def test_samples_in_which_an_effect_acts():
    x, u = samples(50)
    for name in ("joint_limit", "stiction", "stribeck_friction"):
        active = effect(name).active
        assert active is not None
        share = active(NUMBERS[name], x, u)
        assert share.shape == (50,)
        assert 0 < share.mean() <= 1
    for name in ("joint_limit", "stiction"):
        assert not effect(name).active(effect(name).neutral(), x, u).any()


SMOOTH = sorted(NAMES - {"joint_limit"})


def run_of(physics: Physics):
    """Three samples of a free run as a function of the numbers of all effects: outputs `[time, y]`."""
    x0, u = np.concatenate([np.full(6, 0.05), np.full(6, 0.3)]), np.linspace(0.5, 1.5, 18).reshape(3, 6)

    def run(numbers):
        params = physics.params._replace(effects=numbers)

        def body(x, u_t):
            x = physics.step(params, x, u_t)
            return x, physics.measure(params, x, u_t)

        return jax.lax.scan(body, jnp.asarray(x0), u)[1]

    return run


def everything(**settings: Any) -> tuple[Physics, dict[str, Any]]:
    physics = arm(dt=0.05, integrator="euler", **settings)
    physics = add(physics, *arm_effects(physics), numbers=NUMBERS)
    return physics, {name: jax.tree.map(jnp.asarray, physics.params.effects[name]) for name in sorted(NAMES)}


def test_derivatives_by_all_numbers_are_those_of_finite_differences_in_both_modes():
    physics, numbers = everything(derivatives="forward")
    run, h = run_of(physics), 1e-6
    found = quick_jit(jax.jacfwd(run))(numbers)
    value = quick_jit(run)
    for name in SMOOTH:
        for key, number in numbers[name].items():
            slopes = []
            for e in np.eye(number.size).reshape(-1, *number.shape):
                plus, minus = (value({**numbers, name: {**numbers[name], key: number + s * h * e}}) for s in (1, -1))
                slopes.append((plus - minus) / (2 * h))
            expected = np.stack(slopes, -1).reshape(*slopes[0].shape, *number.shape)
            np.testing.assert_allclose(found[name][key], expected, rtol=1e-4, atol=1e-6, err_msg=f"{name} {key}")
    reverse = run_of(everything()[0])
    weights = np.random.default_rng(1).normal(size=(3, 6))
    pulled = quick_jit(jax.grad(lambda numbers: jnp.sum(weights * reverse(numbers))))(numbers)
    for mine, other in zip(jax.tree.leaves(pulled), jax.tree.leaves(found), strict=True):
        expected = np.tensordot(weights, other, 2)
        np.testing.assert_allclose(mine, expected, rtol=1e-8, atol=1e-10)


def test_derivatives_at_neutral_numbers_are_finite():
    physics = arm(derivatives="forward")
    physics = add(physics, *arm_effects(physics))
    numbers = {name: jax.tree.map(jnp.asarray, physics.params.effects[name]) for name in sorted(NAMES)}
    found = quick_jit(jax.jacfwd(run_of(physics)))(numbers)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
    for name in NAMES - {"joint_limit", "stiction", "gravity_counterbalance", "payload", "stribeck_friction"}:
        assert all(np.any(leaf) for leaf in jax.tree.leaves(found[name])), name


def test_single_precision_stays_single():
    physics = arm()
    physics = add(physics, *arm_effects(physics))
    x, u = jax.ShapeDtypeStruct((12,), jnp.float32), jax.ShapeDtypeStruct((6,), jnp.float32)
    assert jax.eval_shape(physics.step, physics.params, x, u).dtype == jnp.float32
