"""Effects of any system, around a toy with two inputs, two outputs and three states whose loop is plain NumPy."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import TOY_PARAMS, quick_jit, toy_measure, toy_physics, toy_step

import pgrssnn_jax as pg
from pgrssnn_jax.effects.base import add
from pgrssnn_jax.effects.delay import LONGEST_DELAY
from pgrssnn_jax.effects.sensors_actuators import any_system_effects
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.simulate import free_run

pytestmark = pytest.mark.usefixtures("x64")
DT = 0.5
U = np.random.default_rng(4).normal(size=(40, 2))
X0 = np.array([0.2, -0.1, 0.4])
READS = ["after_step", "before_step"]


def changed(name, numbers, output_timing="after_step"):
    physics = toy_physics(output_timing)
    one = next(e for e in any_system_effects(physics) if e.name == name)
    return add(physics, one, numbers={name: numbers})


def outputs(name, numbers, output_timing="after_step", memory=()) -> np.ndarray:
    """y `[time, 2]` of the free run with an effect; behind its memory stands that before the sample."""
    physics = changed(name, numbers, output_timing)
    x = np.concatenate([X0, memory])
    x = np.concatenate([x, np.zeros(len(physics.states) - len(x))])
    return np.asarray(run_of(name, output_timing)(jax.tree.map(np.float64, physics.params), x, U))


@cache
def run_of(name, output_timing):
    physics = changed(name, {}, output_timing)

    def run(params, x, u):
        def body(x, u):
            new = physics.step(params, x, u)
            return new, physics.measure(params, new if output_timing == "after_step" else x, u)

        return jax.lax.scan(body, x, u)[1]

    return quick_jit(run)


def plain(inputs, output_timing="after_step", seen=None) -> np.ndarray:
    """seen: inputs in the direct part of the outputs, where they differ."""
    x, found = X0, []
    for u, direct in zip(inputs, inputs if seen is None else seen, strict=True):
        new = toy_step(TOY_PARAMS, x, u)
        found.append(toy_measure(TOY_PARAMS, new if output_timing == "after_step" else x, direct))
        x = new
    return np.stack(found)


ON_INPUT = {
    "input_offset": ({"offset": [0.3, -0.2]}, lambda u: u + np.array([0.3, -0.2])),
    "input_gain": ({"gain": [1.3, 0.6]}, lambda u: u * [1.3, 0.6]),
    "input_saturation": ({"low": [-0.5, -np.inf], "high": [0.7, 0.2]}, lambda u: np.clip(u, [-0.5, -9], [0.7, 0.2])),
    "input_dead_zone": ({"width": [0.4, 0.0]}, lambda u: u - np.clip(u, [-0.4, 0.0], [0.4, 0.0])),
}
ON_OUTPUT = {
    "sensor_offset": ({"offset": [0.3, -0.2]}, lambda y: y + np.array([0.3, -0.2])),
    "sensor_gain": ({"gain": [1.3, 0.6]}, lambda y: y * [1.3, 0.6]),
    "sensor_saturation": ({"low": [-0.1, -np.inf], "high": [0.2, 0.3]}, lambda y: np.clip(y, [-0.1, -9], [0.2, 0.3])),
}


@pytest.mark.parametrize("output_timing", READS)
@pytest.mark.parametrize("name", sorted(ON_INPUT))
def test_inputs_are_changed_on_their_way_in(name, output_timing):
    numbers, change = ON_INPUT[name]
    expected = plain(change(U), output_timing=output_timing)
    assert np.abs(expected - plain(U, output_timing=output_timing)).max() > 0.01
    np.testing.assert_allclose(outputs(name, numbers, output_timing), expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("output_timing", READS)
@pytest.mark.parametrize("name", sorted(ON_OUTPUT))
def test_outputs_are_changed_on_their_way_out(name, output_timing):
    numbers, change = ON_OUTPUT[name]
    expected = change(plain(U, output_timing=output_timing))
    assert np.abs(expected - plain(U, output_timing=output_timing)).max() > 0.01
    np.testing.assert_allclose(outputs(name, numbers, output_timing), expected, rtol=1e-12, atol=1e-14)


def delayed(samples: int) -> np.ndarray:
    """U moved back by whole samples, the first value held."""
    late = np.roll(U, samples, axis=0)
    late[:samples] = U[0]
    return late


HELD = np.tile(U[0], LONGEST_DELAY)


@pytest.mark.parametrize("samples", range(LONGEST_DELAY + 1))
def test_a_delay_of_whole_samples_moves_the_input(samples):
    found = outputs("input_delay", {"delay": [samples * DT] * 2}, memory=HELD)
    np.testing.assert_allclose(found, plain(delayed(samples)), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(("name", "number"), [("input_delay", "delay"), ("input_lag", "time_constant")])
def test_every_input_has_a_delay_and_a_lag_of_its_own(name, number):
    """Of two inputs whose sum is measured, each as if it were alone."""
    two = lgssm(A=[[0.0]], B=[[1.0, 1.0]], C=[[1.0]], inputs=["a", "b"], dt=DT)
    u = np.random.default_rng(3).standard_normal((1, 40, 2))

    def answered(a: float, b: float, u: np.ndarray) -> np.ndarray:
        physics = pg.add(two, name, **{number: [a, b]})
        return np.asarray(free_run(physics, u, np.zeros((1, len(physics.states))))[0])

    alone = [answered(*late, u * only) for late, only in (((1.3 * DT, 0.0), [1.0, 0.0]), ((0.0, 2.6 * DT), [0.0, 1.0]))]
    np.testing.assert_allclose(answered(1.3 * DT, 2.6 * DT, u), alone[0] + alone[1], atol=1e-12)
    assert np.abs(alone[0] + alone[1] - answered(1.3 * DT, 1.3 * DT, u)).max() > 0.1
    both = pg.add(two, name, **{number: 1.3 * DT})
    np.testing.assert_array_equal(both.params.effects[name][number], [1.3 * DT, 1.3 * DT], "one number is that of all")


@pytest.mark.parametrize("samples", [0.3, 2.0, 15.0])
def test_a_lag_is_the_mean_of_the_first_order_system_over_each_sample(samples):
    """From 5000 small steps of dz/dt = (u - z) / T by the implicit midpoint rule, T in samples; outputs are read at the
    end of a sample."""
    means, ends = map(np.asarray, means_of(samples, np.array([0.5, -1.0])))
    found = outputs("input_lag", {"time_constant": [samples * DT] * 2}, memory=np.array([0.5, -1.0]))
    np.testing.assert_allclose(found, plain(means, seen=ends), rtol=1e-7, atol=1e-9)


@quick_jit
def means_of(samples, z, steps=5000):
    def sample(z, u):
        def tiny(z, _):
            after = ((2 * samples * steps - 1) * z + 2 * u) / (2 * samples * steps + 1)
            return after, (z + after) / 2

        z, middles = jax.lax.scan(tiny, z, length=steps)
        return z, (middles.mean(0), z)

    return jax.lax.scan(sample, z, U)[1]


def test_memories_say_which_input_they_hold():
    for name, count in (("input_delay", LONGEST_DELAY), ("input_lag", 1)):
        memory = changed(name, {}).states[3:]
        assert [s.memory_of for s in memory] == ["f", "g"] * (2 * count)  # and before the sample, for the outputs
        assert len({s.name for s in memory}) == 4 * count


def test_a_lag_has_a_finite_slope_where_there_is_none():
    physics = changed("input_lag", {})
    x, u = jnp.concatenate([X0, U[0]]), jnp.asarray(U[1])

    def of(tau):
        return physics.params._replace(effects={"input_lag": {"time_constant": tau}})

    slope = quick_jit(jax.jacfwd(lambda tau: physics.step(of(tau), x, u)))(0.0)
    assert np.isfinite(slope).all()


def test_saturations_act_where_a_signal_is_beyond_its_limits():
    for one in any_system_effects(toy_physics()):
        if one.name == "input_saturation":
            acting = one.active({"low": np.array([-0.5, -np.inf]), "high": np.array([np.inf, 0.2])}, U[:, :1] * 0, U)
            np.testing.assert_array_equal(acting, (U[:, 0] < -0.5) | (U[:, 1] > 0.2))
        if one.name == "input_dead_zone":
            acting = one.active({"width": np.array([0.4, 0.0])}, U[:, :1] * 0, U)
            np.testing.assert_array_equal(acting, np.abs(U[:, 0]) < 0.4)
        if one.name == "sensor_saturation":
            x = np.random.default_rng(1).normal(size=(40, 3))
            y = np.stack([toy_measure(TOY_PARAMS, *pair) for pair in zip(x, U, strict=True)])
            wide = np.concatenate([x, U], 1)  # memory states of other effects lie behind
            acting = one.active({"low": np.array([-0.1, -0.5]), "high": np.array([0.5, 0.6])}, wide, U)
            np.testing.assert_array_equal(acting, ((y < [-0.1, -0.5]) | (y > [0.5, 0.6])).any(1))


def test_titles_say_the_side_on_which_an_effect_acts():
    titles = {effect.name: effect.title for effect in any_system_effects(toy_physics("after_step"))}
    assert titles["input_gain"] == "Input gain"
    assert titles["sensor_gain"] == "Sensor gain"
    assert {name: title.split()[0] for name, title in titles.items() if name.endswith("_offset")} == {
        "input_offset": "Input",
        "sensor_offset": "Sensor",
    }
