"""Limits against steps so small that nothing is lost: an oscillator between stops, vessels that overflow."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oscillators import freely, oscillator, simulated, solved
from toys import quick_jit

from pgrssnn_jax.effects import add_effect, catalogue
from pgrssnn_jax.effects.base import SignalRange
from pgrssnn_jax.physics.base import Physics, Signal, continuous

pytestmark = pytest.mark.usefixtures("x64")
LOW, HIGH = -0.2, 0.32  # m


def between(x: Any, u: Any, h: float) -> Any:
    q, v = freely(*x, u, h)
    v = jnp.where((q > HIGH) & (v > 0) | (q < LOW) & (v < 0), 0.0, v)
    return jnp.clip(q, LOW, HIGH), v


@pytest.mark.parametrize("only_steps", [False, True])
def test_an_oscillator_runs_against_its_stops_and_comes_back(only_steps):
    expected = solved(between)
    assert 0.05 < (expected[:, 0] >= HIGH).mean() < 0.9
    assert 0.02 < (expected[:, 0] <= LOW).mean() < 0.9
    physics = oscillator()._replace(extension=None) if only_steps else oscillator()
    found = simulated(add_effect(physics, "hard_stop", low=LOW, high=HIGH))
    free = simulated(physics)
    assert np.abs(free[:, 0] - expected[:, 0]).max() > 0.1
    assert np.abs(found[:, 0] - expected[:, 0]).max() < 1e-3  # m
    assert np.all((found[:, 0] >= LOW) & (found[:, 0] <= HIGH))


def vessels(**settings: Any) -> Physics:
    """Two vessels in a row that drain by their levels."""
    return continuous(
        "vessels",
        lambda p, x, u: jnp.stack([u[0] - 0.8 * x[0], 0.8 * x[0] - 0.5 * x[1]]),
        lambda p, x, u: x[1:],
        {"one": 1.0},
        states=(Signal("upper", "m"), Signal("lower", "m", like="level")),
        inputs=(Signal("u"),),
        outputs=(Signal("level", "m"),),
        dt=0.2,
        **settings,
    )


LEVELS = {"ceiling": [1.2, np.inf], "floor": [0.6, 0.9]}
INFLOW = np.repeat(np.random.default_rng(0).uniform(0.0, 2.0, 12), 10)


@quick_jit
def in_tiny_steps(low, high):
    """Levels `[time, 2]`, kept between these."""

    def sample(x, u):
        def tiny(_, x):
            return jnp.clip(x + 1e-4 * jnp.stack([u - 0.8 * x[0], 0.8 * x[0] - 0.5 * x[1]]), low, high)

        x = jax.lax.fori_loop(0, 2000, tiny, x)
        return x, x

    return jax.lax.scan(sample, jnp.ones(2), INFLOW)[1]


@pytest.mark.parametrize(("name", "levels"), LEVELS.items())
@pytest.mark.parametrize("only_steps", [False, True])
def test_a_level_stays_within_its_limit(name, levels, only_steps):
    none, levels = np.full(2, np.inf), np.array(levels)
    expected = np.asarray(in_tiny_steps(-none, levels) if name == "ceiling" else in_tiny_steps(levels, none))
    u, cut = INFLOW, np.minimum if name == "ceiling" else np.maximum
    assert 0.1 < (expected[:, 0] == levels[0]).mean() < 0.9
    physics = add_effect(vessels()._replace(extension=None) if only_steps else vessels(), name, level=levels)
    params, step = jax.tree.map(jnp.asarray, physics.params), quick_jit(physics.step)
    x, found = jnp.ones(2), []
    for one in u:
        x = step(params, x, jnp.full(1, one))
        found.append(x)
    error = np.abs(np.array(found) - expected)
    assert error.max() < (0.15 if only_steps else 4e-3)  # m, in samples of a sixth of a time constant
    assert np.all(cut(found, levels) == found)


def test_limits_of_any_unit_begin_inside_the_range_of_the_data():
    span = np.array([[-0.4, -1.0], [0.9, 0.8]])
    by_name = {one.name: one for one in catalogue(oscillator())}
    for unit in (1e-3, 1e3):
        reach = SignalRange(unit * span, np.zeros((2, 1)), unit * span[:, :1])
        for start in by_name["hard_stop"].guesses(reach):
            ends = np.concatenate([start["low"], start["high"]]) / unit
            assert np.all((ends > -0.4) & (ends < 0.9) | np.isinf(ends))
    stop = by_name["hard_stop"]
    assert stop.active is not None
    at = np.array([[0.1, 0.0], [HIGH, 0.0], [LOW, 0.0]])
    found = stop.active({"low": np.array([LOW]), "high": np.array([HIGH])}, at, np.zeros((3, 1)))
    np.testing.assert_array_equal(found, [False, True, True])
    none = stop.active({"low": np.array([-np.inf]), "high": np.array([np.inf])}, at, np.zeros((3, 1)))
    assert not none.any(), "a limit that is not there acts nowhere"
