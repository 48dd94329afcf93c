"""Dry friction against steps so small that nothing is lost: an oscillator that slides, turns around and sticks."""

import json
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oscillators import DT, START, forces, freely, oscillator, simulated, solved
from toys import quick_jit

from pgrssnn_jax.effects import add_effect
from pgrssnn_jax.effects.stored import physics_to_json, stored_physics
from pgrssnn_jax.physics.base import Physics

pytestmark = pytest.mark.usefixtures("x64")
NUMBERS: dict[str, dict[str, float]] = {
    "coulomb_friction": {"a": 0.6},
    "stribeck_friction": {"a": 0.4, "d": 0.3, "v_s": 0.2},
}


def brake(name: str, v: Any) -> Any:
    n = NUMBERS[name]
    return n["a"] + (n["d"] * jnp.exp(-((v / n["v_s"]) ** 2)) if "d" in n else 0.0)


@cache
def expected_of(name: str) -> np.ndarray:
    """In every tiny step friction cuts the speed."""

    def tiny(x: Any, u: Any, h: float) -> Any:
        q, v = x
        _, free = freely(q, v, u, h)
        after = jnp.sign(free) * jnp.maximum(jnp.abs(free) - h * brake(name, v), 0.0)
        return q + 0.5 * h * (v + after), after

    return solved(tiny)


@pytest.mark.parametrize("name", NUMBERS)
def test_an_oscillator_slides_turns_and_sticks(name):
    expected = expected_of(name)
    rests = np.abs(expected[:, 1]) < 1e-9
    assert 0.1 < rests.mean() < 0.9
    coarse, fine = (
        np.abs(simulated(add_effect(oscillator(sub_steps=n), name, **NUMBERS[name])) - expected) for n in (1, 4)
    )
    most = {"coulomb_friction": 1e-4, "stribeck_friction": 5e-4}[name]  # m, of a motion of about 0.5 m
    assert coarse[:, 0].max() < most
    assert fine[:, 0].max() < most / 8
    found = simulated(add_effect(oscillator(), name, **NUMBERS[name]))
    assert (found[rests, 1] == 0.0).mean() > 0.95, "at rest it is at rest"


@pytest.mark.parametrize("name", NUMBERS)
def test_of_a_physics_that_has_only_steps_it_is_nearly_as_good(name):
    physics = add_effect(oscillator()._replace(extension=None), name, **NUMBERS[name])
    assert np.abs(simulated(physics) - expected_of(name))[:, 0].max() < 6e-3


def test_friction_at_its_limit_holds_and_beyond_it_lets_go():
    physics = add_effect(oscillator(), "coulomb_friction", a=0.5)
    params, rest = jax.tree.map(jnp.asarray, physics.params), jnp.zeros(2)
    step = quick_jit(physics.step)
    np.testing.assert_array_equal(step(params, rest, jnp.full(1, 0.499)), rest)
    assert step(params, rest, jnp.full(1, 0.6))[1] == pytest.approx(0.1 * DT, rel=0.02)


def test_numbers_move_the_motion_as_differences_say():
    """Where it slides, turns and sticks, the derivative of a run is that of the run, but for the switching itself."""

    def run(a: Any) -> Any:
        physics = add_effect(oscillator(), "coulomb_friction", a=0.5)
        params = jax.tree.map(jnp.asarray, physics.params)
        params = params._replace(effects={"coulomb_friction": {"a": jnp.reshape(a, 1)}})

        def sample(x: Any, u: Any) -> Any:
            x = physics.step(params, x, u[None])
            return x, x

        return jax.lax.scan(sample, jnp.asarray(START), jnp.asarray(forces()))[1]

    slope, value = quick_jit(jax.jacfwd(run))(jnp.asarray(0.5)), quick_jit(run)
    differences = (value(jnp.asarray(0.5 + 1e-6)) - value(jnp.asarray(0.5 - 1e-6))) / 2e-6
    assert np.isfinite(slope).all()
    np.testing.assert_allclose(slope, differences, atol=1e-3 * np.abs(differences).max())


MANY = {
    "viscous_friction": {"c": 0.2},
    "input_delay": {"delay": 0.07},
    "coulomb_friction": {"a": 0.3},
    "input_saturation": {"high": 1.5},
    "cubic_spring": {"k": 1.0},
}


def with_many(physics: Physics, names: Any = MANY) -> Physics:
    for name in names:
        physics = add_effect(physics, name, **MANY[name])
    return physics


def one_step(physics: Physics) -> np.ndarray:
    x, params = jnp.linspace(0.4, -0.3, len(physics.states)), jax.tree.map(jnp.asarray, physics.params)
    return np.asarray(quick_jit(physics.step)(params, x, jnp.full(1, 2.0)))


def test_the_integrator_of_the_physics_integrates_its_effects_too():
    changed = with_many(oscillator()).variant(integrator="euler", sub_steps=3)
    np.testing.assert_array_equal(one_step(changed), one_step(with_many(oscillator(integrator="euler", sub_steps=3))))
    assert np.abs(one_step(changed) - one_step(with_many(oscillator()))).max() > 1e-5


def test_effects_inside_and_around_a_step_come_in_any_order_and_back_from_a_file():
    physics = with_many(oscillator())
    swapped = with_many(oscillator(), ["coulomb_friction", "viscous_friction", "input_delay", "cubic_spring"])
    np.testing.assert_allclose(one_step(with_many(swapped, ["input_saturation"])), one_step(physics), rtol=1e-14)
    stored = json.loads(json.dumps(physics_to_json(physics)))
    np.testing.assert_array_equal(one_step(stored_physics(oscillator(), stored, where="here")), one_step(physics))
