"""What every effect of an arm promises: neutral numbers change nothing, fits begin where it says, derivatives exist."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arm_cases import NAMES, NUMBERS, backend_of, effect, mapped, samples
from hypothesis import given, settings
from hypothesis import strategies as st
from toys import quick_jit

from pgrssnn_jax.effects.arm import arm_effects
from pgrssnn_jax.effects.base import Effect, SignalRange, add
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.check import check_physics

pytestmark = pytest.mark.usefixtures("x64")


def test_the_arms_effects_have_their_names():
    assert {e.name for e in arm_effects(arm())} == NAMES


@pytest.mark.parametrize("name", sorted(NAMES))
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_neutral_numbers_change_nothing(name, seed):
    backend = backend_of(name)
    with jax.enable_x64(True):
        given_ = samples(20, seed)
        (x, y), (expected_x, expected_y) = (mapped(n, backend, True)(*given_) for n in (name, None))
    np.testing.assert_allclose(x, expected_x, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(y, expected_y, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", sorted(NAMES))
def test_other_numbers_change_something(name):
    (x, y), (other_x, other_y) = (mapped(n, backend_of(name))(*samples(20)) for n in (name, None))
    assert max(np.abs(x - other_x).max(), np.abs(y - other_y).max()) > 1e-4


def test_known_disturbances_are_not_looked_for():
    known = arm(velocity_disturbance=0.1)
    assert {e.name for e in arm_effects(known)} == NAMES - {"velocity_disturbance"}
    known = arm(velocity_disturbance=0.1, torque_bias=1.0)
    assert {e.name for e in arm_effects(known)} == NAMES - {"velocity_disturbance", "torque_bias"}


@pytest.fixture(scope="module")
def crane(tmp_path_factory) -> Physics:
    """Two joints from a URDF."""
    link = "<inertial><origin xyz='0.1 0 0.3'/><mass value='2'/><inertia ixx='.1' iyy='.1' izz='.1' {}/></inertial>"
    link = link.format("ixy='0' ixz='0' iyz='0'")
    joint = (
        "<joint name='{1}_joint' type='continuous'><parent link='{0}'/><child link='{1}'/><axis xyz='0 1 0'/></joint>"
    )
    parts = [f"<link name='{name}'>{link}</link>" for name in ("boom", "jib")]
    parts += [joint.format(*pair) for pair in (("base", "boom"), ("boom", "jib"))]
    file = tmp_path_factory.mktemp("arm") / "crane.urdf"
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


@pytest.fixture(scope="module")
def arms(crane) -> list[tuple[Physics, list[Effect]]]:
    return [(physics, arm_effects(physics)) for physics in (arm(), crane)]


@pytest.mark.parametrize("name", sorted(NAMES))
def test_fits_start_from_numbers_that_an_effect_may_have(name, arms):
    for physics, effects in arms:
        for one in (e for e in effects if e.name == name):
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


@pytest.mark.slow
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


@pytest.mark.compiles
def test_derivatives_at_neutral_numbers_are_finite():
    physics = arm(derivatives="forward")
    physics = add(physics, *arm_effects(physics))
    numbers = {name: jax.tree.map(jnp.asarray, physics.params.effects[name]) for name in sorted(NAMES)}
    found = quick_jit(jax.jacfwd(run_of(physics)))(numbers)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
    for name in NAMES - {"joint_limit", "stiction", "gravity_counterbalance", "payload", "stribeck_friction"}:
        moves = {key: np.any(leaf) for key, leaf in found[name].items()}
        assert all(moves[key] for key in moves if key != "ratio"), name  # of a motor without inertia and friction


def test_single_precision_stays_single():
    physics = arm()
    physics = add(physics, *arm_effects(physics))
    x, u = jax.ShapeDtypeStruct((12,), jnp.float32), jax.ShapeDtypeStruct((6,), jnp.float32)
    assert jax.eval_shape(physics.step, physics.params, x, u).dtype == jnp.float32
