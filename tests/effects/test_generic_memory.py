"""Play and hysteresis against their equations in small steps."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from oscillators import START, forces, oscillator, simulated, slope, solved

from pgrssnn_jax.effects import add_effect, catalogue
from pgrssnn_jax.effects.base import SignalRange
from pgrssnn_jax.models.scaling import fit_scaling
from pgrssnn_jax.physics.simulate import first_output_state
from pgrssnn_jax.records.record import Channel, RecordInfo, record

pytestmark = pytest.mark.usefixtures("x64")
K, YIELD = 3.0, 0.1  # 1/s², m


def yielding(x: Any, u: Any, h: float) -> Any:
    """Heun's method, of dz/dt as it stands in books."""

    def rates(q: Any, v: Any, z: Any) -> Any:
        return v, slope(q, v, u) - K * z, v - (jnp.abs(v) * z + v * jnp.abs(z)) / (2.0 * YIELD)

    first = rates(*x)
    second = rates(*(one + h * rate for one, rate in zip(x, first, strict=True)))
    return tuple(one + 0.5 * h * (a + b) for one, a, b in zip(x, first, second, strict=True))


@pytest.mark.parametrize(("only_steps", "most"), [(False, 1e-3), (True, 5e-3)])
def test_a_spring_yields_as_its_equation_says(only_steps, most):
    expected = solved(yielding, (*START, 0.0))
    physics = oscillator()._replace(extension=None) if only_steps else oscillator()
    coarse = simulated(add_effect(physics, "hysteresis", k=K, s=YIELD))
    assert np.abs(simulated(oscillator())[:, 0] - expected[:, 0]).max() > 0.1
    assert np.abs(coarse - expected)[:, 0].max() < most
    assert np.abs(coarse - expected)[:, 2].max() < 5 * most
    assert np.abs(coarse[:, 2]).max() < YIELD


def test_a_spring_that_never_yields_is_linear():
    found = simulated(add_effect(oscillator(), "hysteresis", k=K))
    expected = simulated(add_effect(add_effect(oscillator(), "linear_spring", k=K), "constant_force", a=K * START[0]))
    np.testing.assert_allclose(found[:, :2], expected, atol=1e-9)


def test_a_spring_that_does_not_yield_within_its_way_is_not_believed():
    hysteresis = next(effect for effect in catalogue(oscillator()) if effect.name == "hysteresis")
    assert hysteresis.credible is not None
    x, other = np.array([[-0.2, -9.0], [0.3, 9.0]]), np.zeros((2, 1))
    for s, believed in ((0.4, True), (0.6, False), (1e11, False)):
        assert hysteresis.credible({"k": np.array([K]), "s": np.array([s])}, SignalRange(x, other, other)) is believed


def test_hysteresis_takes_further_effects_inside_and_around():
    one, other = oscillator(), oscillator()
    for name, number in (("viscous_friction", {"c": 0.3}), ("input_delay", {"delay": 0.08})):
        one = add_effect(one, name, **number)
    one = add_effect(one, "hysteresis", k=K, s=YIELD)
    other = add_effect(other, "hysteresis", k=K, s=YIELD)
    for name, number in (("input_delay", {"delay": 0.08}), ("viscous_friction", {"c": 0.3})):
        other = add_effect(other, name, **number)
    np.testing.assert_allclose(simulated(one)[:, :2], simulated(other)[:, :2], atol=1e-12)
    changed = other.variant(sub_steps=3)
    assert np.abs(simulated(changed)[:, :2] - simulated(other)[:, :2]).max() < 1e-3
    names = [effect.equation for effect in catalogue(other) if effect.acts_on == "dynamics"]
    assert not any("yielding" in name for name in names), "a memory takes no effects"


def test_what_a_spring_remembers_begins_at_zero_and_has_a_scale():
    physics = add_effect(oscillator(), "hysteresis", k=K, s=YIELD)
    u, y = forces()[None, :, None], simulated(physics)[None, :, :1]
    np.testing.assert_array_equal(first_output_state(physics, y[:, 0], u[:, 0])[:, 1:], 0.0)
    info = RecordInfo((Channel("u"),), (Channel("q", "m"),), physics.dt, "simulated", "here")
    assert 0.01 * YIELD < fit_scaling(record(u, y, info), physics).x.scale[2] < YIELD


def test_play_follows_behind_its_input():
    physics = add_effect(oscillator(), "backlash", half_width=0.2)
    state = jnp.zeros(3)
    seen = []
    for u in (0.1, 0.5, 0.4, 0.15, 0.0, -0.5):
        state = physics.step(physics.params, state, jnp.full(1, u))
        seen.append(float(state[2]))
    np.testing.assert_allclose(seen, [0.0, 0.3, 0.3, 0.3, 0.2, -0.3], atol=1e-12)
