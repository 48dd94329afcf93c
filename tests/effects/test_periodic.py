"""Periodic disturbances against the equation that they stand for, integrated in small steps."""

import jax.numpy as jnp
import numpy as np
import pytest
from oscillators import oscillator
from scipy.integrate import solve_ivp

from pgrssnn_jax.effects import add_effect, catalogue
from pgrssnn_jax.effects.base import Effect, SignalRange
from pgrssnn_jax.effects.places import levels
from pgrssnn_jax.physics.base import Physics, Signal, continuous
from pgrssnn_jax.physics.simulate import first_output_state, free_run

pytestmark = pytest.mark.usefixtures("x64")
DT, PHASE, AMPLITUDE = 0.1, 0.7, 0.5
NAMES = ("periodic_disturbance", "periodic_sensor_error")


def tank() -> Physics:
    """dx/dt = u - 0.4 x."""
    return continuous(
        "tank",
        lambda p, x, u: u - p["k"] * x,
        lambda p, x, u: x,
        {"k": 0.4},
        dt=DT,
        states=(Signal("level", "m", like="level"),),
        inputs=(Signal("inflow", "m/s"),),
        outputs=(Signal("level", "m"),),
    )


def effect(name: str, physics: Physics | None = None) -> Effect:
    return next(one for one in catalogue(physics or tank()) if one.name == name)


@pytest.mark.parametrize(("frequency", "most"), [(0.3, 1e-3), (1.0, 4e-3), (2.5, 1e-2)])
def test_a_disturbance_of_the_input_moves_the_state_as_its_sinusoid_does(frequency, most):
    """2.5 Hz: four samples in a period."""
    u = np.random.default_rng(0).uniform(0.0, 1.0, (60, 1))
    disturbed = add_effect(tank(), "periodic_disturbance", amplitude=AMPLITUDE, frequency=frequency)
    y, _ = free_run(disturbed, u[None], np.array([[1.0, PHASE]]))

    def slope(t, x, held):
        return held + AMPLITUDE * np.sin(2 * np.pi * frequency * t + PHASE) - 0.4 * x

    x, expected = np.array([1.0]), []
    for k, held in enumerate(u[:, 0]):
        x = solve_ivp(slope, (k * DT, (k + 1) * DT), x, args=(held,), rtol=1e-9, atol=1e-12).y[:, -1]
        expected.append(x)
    plain, _ = free_run(tank(), u[None], np.array([[1.0]]))
    size = np.abs(plain[0] - np.array(expected)).max()
    assert size > 0.02
    assert np.abs(y[0] - np.array(expected)).max() < most * size


def test_an_error_of_the_sensor_is_a_sinusoid_at_the_times_of_the_readings():
    u = np.random.default_rng(0).uniform(0.0, 1.0, (1, 60, 1))
    disturbed = add_effect(tank(), "periodic_sensor_error", amplitude=AMPLITUDE, frequency=0.9)
    y, _ = free_run(disturbed, u, np.array([[1.0, PHASE]]))
    plain, _ = free_run(tank(), u, np.array([[1.0]]))
    times = DT * np.arange(1, 61)  # a reading follows the input of its sample
    expected = AMPLITUDE * np.sin(2 * np.pi * 0.9 * times + PHASE)
    np.testing.assert_allclose((y - plain)[0, :, 0], expected, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_a_phase_stays_within_a_turn_and_is_nobodys_state(name):
    disturbed = add_effect(tank(), name, amplitude=1.0, frequency=2.3)
    _, x = free_run(disturbed, np.ones((1, 500, 1)), np.array([[1.0, PHASE]]))
    assert 0.0 <= x[..., 1].min() < x[..., 1].max() < 2 * np.pi
    phase = disturbed.states[1]
    assert phase.inner, "networks neither see nor correct it"
    assert [place.state for place in levels(disturbed)] == [0], "nothing leaks from a phase"
    assert first_output_state(disturbed, np.array([[3.0]]), np.array([[2.0]])).tolist() == [[3.0, 0.0]]
    further = [one.name for one in catalogue(disturbed)]
    assert "leak" in further
    assert name not in further


@pytest.mark.parametrize("name", NAMES)
def test_fits_begin_at_the_lines_of_the_errors_and_nowhere_without_one(name):
    ends = np.array([[-2.0], [3.0]])
    assert effect(name).guesses(SignalRange(ends, ends, ends)) == []
    guesses = effect(name).guesses(SignalRange(ends, ends, ends, (0.8,)))
    assert {float(one["frequency"]) for one in guesses} == {0.8}
    assert all(0.0 < one["amplitude"].item() < 5.0 for one in guesses)


def test_a_disturbance_beyond_the_range_of_its_input_is_not_believed():
    credible, ends = effect("periodic_disturbance").credible, np.array([[-2.0], [3.0]])
    assert credible is not None
    span = SignalRange(ends, ends, ends, (0.8,))
    assert credible({"amplitude": np.array([4.9]), "frequency": 0.8}, span)
    assert not credible({"amplitude": np.array([5.1]), "frequency": 0.8}, span)


def test_phases_of_several_inputs_are_apart():
    two = continuous(
        "two",
        lambda p, x, u: jnp.stack([u[0] - x[0], u[1] - x[1]]),
        lambda p, x, u: x,
        {},
        dt=DT,
        states=(Signal("a", like="a"), Signal("b", like="b")),
        inputs=(Signal("to_a"), Signal("to_b")),
        outputs=(Signal("a"), Signal("b")),
    )
    disturbed = add_effect(two, "periodic_disturbance", amplitude=[1.0, 0.0], frequency=0.5)
    assert [state.name for state in disturbed.states] == ["a", "b", "to_a_phase", "to_b_phase"]
    _, x = free_run(disturbed, np.zeros((1, 40, 2)), np.zeros((1, 4)))
    assert np.abs(x[..., 0]).max() > 0.1
    assert np.abs(x[..., 1]).max() == 0.0


def test_every_physics_but_an_arm_has_them():
    assert all(effect(name, oscillator()).elaborate for name in NAMES)
