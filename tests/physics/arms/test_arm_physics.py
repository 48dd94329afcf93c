from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from arm_samples import DISTURBED, KUKA, OBLIQUE, THETA, S, published, slope_by_hand, step_by_hand, urdf
from toys import quick_jit

from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.check import check_physics

FREE = {"coulomb_friction": 0.0, "limits": False}
TORQUE = np.array([1.0, 5.0, 3.5, 0.8, 0.7, 0.7])


@cache
def mapped(backend="pinocchio", **settings):
    """The step for `[batch, 12]`; Pinocchio's because it compiles in no time."""
    settings = {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}
    physics = arm(backend=backend, **settings)
    return quick_jit(jax.vmap(lambda x, u: physics.step(physics.params, x, u)))


def samples(count, seed=0, size=1.0):
    """States inside the limits, the first at rest at zero, and torques."""
    draw = np.random.default_rng(seed)
    q = draw.uniform(KUKA.position_min, KUKA.position_max, (count, 6))
    v = draw.uniform(-1, 1, (count, 6)) * KUKA.velocity_max
    x = np.concatenate([q, v], -1)
    x[0] = 0.0
    return x, size * TORQUE * draw.normal(size=(count, 6))


def by_hand(tables, x, u, **more):
    return np.stack([step_by_hand(tables, a, b, **more) for a, b in zip(x, u, strict=True)])


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("backend", ["jax", "pinocchio"])
def test_step_is_the_documented_equation(backend):
    x, u = samples(40, size=3.0)
    found = mapped(backend, **{name: tuple(value) for name, value in DISTURBED.items()})(x, u)
    np.testing.assert_allclose(found, by_hand(KUKA, x, u, theta=THETA, s=S), rtol=1e-9, atol=1e-10)


EYE = np.linspace(0.5, 1.0, 6)
SETTINGS = [
    ({"gravity": (0.3, -2.0, -9.0)}, {"gravity": np.array([0.3, -2.0, -9.0])}),
    ({"preset": None}, {"gravity": np.array([0.0, 0.0, -9.81]), "position_min": -np.inf * EYE}),
    ({"joint_offset": 0.2}, {"offset": np.full(6, 0.2)}),
    ({"gear_ratio": tuple(100 * EYE)}, {"gear": 100 * EYE}),
    ({"viscous_friction": 0.0}, {"viscous": 0 * EYE}),
    ({"coulomb_friction": tuple(EYE)}, {"coulomb": EYE}),
    ({"position_max": 0.1}, {"position_max": np.full(6, 0.1)}),
    ({"position_min": tuple(-EYE)}, {"position_min": -EYE}),
    ({"velocity_max": 0.7}, {"velocity_max": np.full(6, 0.7)}),
    ({"limits": False}, {}),
    ({"dt": 0.05}, {}),
]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("settings", "fields"), SETTINGS, ids=lambda x: ",".join(x))
def test_a_setting_takes_the_place_of_the_presets(settings, fields):
    x, u = samples(12, size=3.0)
    tables = KUKA._replace(**fields)
    if "preset" in settings:
        tables = tables._replace(position_max=np.inf * EYE, velocity_max=np.inf * EYE)
    found = mapped(**settings)(x, u)
    more = {name: settings[name] for name in ("limits", "dt") if name in settings}
    np.testing.assert_allclose(found, by_hand(tables, x, u, **more), rtol=1e-9, atol=1e-10)
    assert np.abs(found - mapped()(x, u)).max() > 1e-3  # the setting matters


@pytest.mark.usefixtures("x64")
def test_small_steps_converge_to_scipys_solution_with_order_four():
    x, u = samples(3)
    smooth = KUKA._replace(coulomb=np.zeros(6))
    slope, exact = slope_by_hand(smooth), []
    for a, b in zip(x, u, strict=True):
        field = {"fun": lambda _, x, b=b: slope(x, b), "t_span": (0.0, 0.1), "y0": a}
        exact.append(scipy.integrate.solve_ivp(**field, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1])
    # the first steps resolve the fastest joint, whose friction has a time constant of 30 ms
    steps = (4, 8, 16, 32)
    errors = [np.abs(mapped(sub_steps=n, **FREE)(x, u) - np.array(exact)).max() for n in steps]
    assert errors[-1] < 1e-7
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(-4, abs=0.35)


@pytest.mark.usefixtures("x64")
def test_states_keep_within_the_limits():
    x, u = samples(200, size=50.0)
    found = np.asarray(mapped()(x, u))
    low = np.concatenate([KUKA.position_min, -KUKA.velocity_max])
    high = np.concatenate([KUKA.position_max, KUKA.velocity_max])
    assert np.all((found >= low) & (found <= high))
    assert np.any(found == low)
    assert np.any(found == high)


def test_there_is_no_friction_at_rest():
    """Any torque moves an arm without weight."""
    weight_free = {"gravity": (0.0, 0.0, 0.0)}
    x, u = np.zeros((1, 12), np.float32), np.full((1, 6), 1e-4, np.float32)
    moved = np.asarray(mapped(integrator="euler", **weight_free)(x, u))
    assert np.all(moved[0, 6:] != 0)
    np.testing.assert_array_equal(moved, mapped(integrator="euler", coulomb_friction=9.0, **weight_free)(x, u))


@pytest.mark.usefixtures("x64")
def test_disturbance_is_added_beyond_the_limit_from_the_velocity_before():
    x = np.zeros((1, 12))
    x[0, 6:] = KUKA.velocity_max
    u = 100 * TORQUE[None]
    plain = mapped()(x, u)
    np.testing.assert_array_equal(plain[0, 6:], KUKA.velocity_max)
    moved = mapped(velocity_disturbance=tuple(S))(x, u)
    np.testing.assert_allclose(moved[0, 6:], (1 + S) * KUKA.velocity_max, rtol=1e-14)
    np.testing.assert_array_equal(moved[0, :6], plain[0, :6])


def jacobians(**settings):
    physics = arm(backend="pinocchio", **settings)
    return jax.jit(jax.vmap(jax.jacrev(physics.step, (0, 1, 2)), (None, 0, 0))), physics


@pytest.mark.usefixtures("x64")
def test_stopped_gradient_leaves_that_of_the_disturbance_alone():
    x, u = samples(4)
    run, physics = jacobians(physics_gradient="stopped", **DISTURBED)
    by_params, by_x, by_u = run(physics.params, x, u)
    expected = np.zeros((4, 12, 12))
    expected[:, np.arange(6, 12), np.arange(6, 12)] = S
    np.testing.assert_array_equal(by_x, expected)
    assert not np.any(by_u)
    through = by_params.pop("S")
    np.testing.assert_array_equal(through[:, np.arange(6, 12), np.arange(6)], x[:, 6:])
    assert np.count_nonzero(through) == np.count_nonzero(x[:, 6:])
    assert not any(np.any(g) for g in by_params.values())


@pytest.mark.usefixtures("x64")
def test_stopped_gradient_without_a_disturbance_is_zero():
    run, physics = jacobians(physics_gradient="stopped")
    assert not any(np.any(g) for g in jax.tree.leaves(run(physics.params, *samples(4))))


@pytest.mark.usefixtures("x64")
def test_stopping_the_gradient_changes_no_value():
    x, u = samples(10)
    settings = {"velocity_disturbance": tuple(S), "torque_bias": tuple(THETA)}
    np.testing.assert_array_equal(mapped(physics_gradient="stopped", **settings)(x, u), mapped(**settings)(x, u))


@pytest.mark.compiles
@pytest.mark.usefixtures("x64")
def test_full_gradients_are_those_of_the_equation_in_both_backends():
    """A state inside the limits, away from the kinks of friction."""
    x = np.concatenate([np.zeros(6), np.full(6, 0.3)])
    u, h = np.array([2.0, 3.0, -2.0, 1.0, 1.0, 0.5]), 1e-6
    run, physics = jacobians(**DISTURBED)
    by_params, by_x, by_u = (jax.tree.map(lambda g: np.asarray(g[0]), g) for g in run(physics.params, x[None], u[None]))

    def slopes(at):
        both = [(at(sign * e)) for e in h * np.eye(len(at.of)) for sign in (1, -1)]
        return np.stack([(a - b) / (2 * h) for a, b in zip(both[::2], both[1::2], strict=True)], -1)

    def around(of, place):
        def at(e):
            return step_by_hand(*place(of + e), theta=THETA, s=S)

        at.of = of
        return at

    np.testing.assert_allclose(by_x, slopes(around(x, lambda x: (KUKA, x, u))), atol=1e-6)
    np.testing.assert_allclose(by_u, slopes(around(u, lambda u: (KUKA, x, u))), atol=1e-6)
    friction = slopes(around(KUKA.coulomb, lambda c: (KUKA._replace(coulomb=c), x, u)))
    np.testing.assert_allclose(by_params["Tc"], friction, atol=1e-6)
    plain = arm(**DISTURBED)
    other = quick_jit(jax.jacrev(plain.step, (0, 1, 2)))(plain.params, x, u)
    for a, b in zip(jax.tree.leaves(other), jax.tree.leaves((by_params, by_x, by_u)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-8)


def test_signals_carry_names_units_and_kinships():
    physics = arm()
    joints = range(1, 7)
    assert [(s.name, s.unit) for s in physics.inputs] == [(f"torque_{i}", "Nm") for i in joints]
    assert [(s.name, s.unit) for s in physics.outputs] == [(f"position_{i}", "rad") for i in joints]
    positions, velocities = physics.states[:6], physics.states[6:]
    assert [(s.name, s.unit, s.like) for s in positions] == [(f"position_{i}", "rad", f"position_{i}") for i in joints]
    expected = [(f"velocity_{i}", "rad/s", f"position_{i}") for i in joints]
    assert [(s.name, s.unit, s.rate_of) for s in velocities] == expected
    assert (physics.dt, physics.output_timing) == (0.1, "after_step")


@pytest.mark.parametrize("settings", [{}, DISTURBED, {"backend": "pinocchio", "physics_gradient": "stopped"}])
def test_physics_keeps_its_contract(settings):
    check_physics(arm(**settings), "arm")


def test_urdf_brings_its_own_joints(tmp_path):
    physics = arm(urdf=urdf(tmp_path, OBLIQUE), gear_ratio=[1.0, 2.0, 3.0])
    check_physics(physics, "arm")
    assert (len(physics.states), len(physics.inputs), len(physics.outputs)) == (6, 3, 3)
    # the URDF says it on the link side, where a gear of 3 makes the motor's friction act nine times
    np.testing.assert_allclose(physics.params["B"], [0.0, 0.0, 0.7 / 9])
    lock = ["panda_finger_joint1", "panda_finger_joint2"]
    assert len(arm(urdf=published("panda.urdf"), lock=lock).inputs) == 7


def test_measurement_reads_positions_unless_unknown():
    x, u = jnp.arange(12.0), jnp.ones(6)
    assert arm().measure({}, x, u).tolist() == list(range(6))
    assert arm(measured=False).measure({}, x, u).tolist() == [0.0] * 6


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"viscous_friction": [1.0] * 5}, r"physics.viscous_friction: expected one number or 6, .* found \[1.0, 1.0"),
        ({"torque_bias": float("nan")}, "physics.torque_bias: expected one number or 6, .* found nan"),
        ({"gravity": [0.0, 9.81]}, r"physics.gravity: expected three numbers in m/s², found \[0.0, 9.81\]"),
        ({"viscous_friction": -1.0}, "B: expected 0 to inf"),
        ({"velocity_disturbance": 2.0}, "S: expected -1 to 1"),
        ({"position_min": 1.0, "position_max": 0.5}, "physics.position_m.*: expected"),
        ({"velocity_max": -1.0}, "physics.velocity_max: expected"),
        ({"dt": 0.0}, "dt: expected a positive"),
        ({"sub_steps": 0}, "sub_steps: expected at least 1"),
        ({"integrator": "rk5"}, "integrator: expected one of"),
        ({"robot": "ur5"}, "physics.robot: expected one of"),
        ({"preset": "mine"}, "physics.preset: expected one of"),
        ({"lock": ["a"]}, r"physics.lock: expected none without physics.urdf, found \['a'\]"),
        ({"urdf": "nowhere.urdf"}, "physics.urdf: expected a URDF file, found no such file: nowhere.urdf"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        arm(**settings)


def test_friction_brakes_whatever_way_the_motor_turns():
    gear = KUKA.gear
    v = np.linspace(-0.5, 0.5, 6)
    x, u = np.concatenate([np.zeros(6), v])[None], np.zeros((1, 6))
    with jax.enable_x64(True):
        found = [mapped(gear_ratio=tuple(sign * gear), limits=False, dt=1e-4)(x, u) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


def test_the_motors_inertia_follows_the_gear():
    x, u = np.zeros((1, 12)), np.full((1, 6), 1e-3)
    free = {"gravity": (0.0, 0.0, 0.0), "viscous_friction": 0.0, "coulomb_friction": 0.0, "dt": 1e-3}
    other = {"motor_inertia": tuple(4.0 * KUKA.motor_inertia), "gear_ratio": tuple(KUKA.gear / 2.0)}
    with jax.enable_x64(True):
        steps = [mapped(**settings, **free)(x, pushed) for settings, pushed in (({}, u), (other, 2.0 * u))]
    np.testing.assert_allclose(steps[0], steps[1], rtol=1e-12)


def test_a_gear_of_zero_is_named():
    with pytest.raises(ValueError, match="physics.gear_ratio: expected numbers other than 0"):
        arm(gear_ratio=0.0)


def test_an_arm_can_be_checked_where_64_bits_are_on():
    with jax.enable_x64(True):
        check_physics(arm(), "arm")


def test_a_wrong_skeleton_is_named():
    with pytest.raises(ValueError, match="skeleton: expected points"):
        check_physics(arm()._replace(skeleton=lambda q: q), "arm")


def test_without_limits_no_position_is_too_large():
    assert {signal.range for signal in arm(limits=False).outputs} == {(-np.inf, np.inf)}
