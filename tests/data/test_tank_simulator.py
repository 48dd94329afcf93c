"""The simulated plant behaves like the measured one, and is the same for the same seed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pgrssnn_jax.data.tank_simulator import SENSOR_END, TankSimulator, estimation_and_test, pump_voltage, simulate
from pgrssnn_jax.physics.tanks import cascaded_tanks


@pytest.fixture(scope="module")
def plant():
    return estimation_and_test(0)


def physics_alone(u, x0):
    physics = cascaded_tanks(integrator="rk4", sub_steps=4)
    x0, u = jnp.asarray(x0, jnp.float32), jnp.asarray(u, jnp.float32)

    def step(x, u_t):
        x = physics.step(physics.params, x, u_t)
        return x, physics.measure(physics.params, x, u_t)

    return np.asarray(jax.lax.scan(step, x0, u[:, None])[1][:, 0])


def test_same_seed_same_rig():
    first, second, other = (estimation_and_test(seed, 64) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


def test_records_reach_the_end_of_the_sensor_and_stay_in_its_range(plant):
    u, y = plant[:, :2], plant[:, 2:]
    assert plant.shape == (1024, 4)
    assert np.all(np.mean(y == SENSOR_END, axis=0) > 0.02)
    assert y.min() >= 0
    assert u.min() >= 0
    np.testing.assert_allclose(u.mean(0), 2.8, atol=0.05)
    np.testing.assert_allclose(u.std(0), 1.0, atol=0.05)


def test_both_records_start_at_the_same_levels(plant):
    # One sample of 4 s changes the level by a few tenths of a volt at most.
    assert abs(plant[0, 2] - plant[0, 3]) < 0.5


def test_the_pump_voltage_is_band_limited():
    wave = pump_voltage(np.random.default_rng(3), 1024)
    power = np.abs(np.fft.rfft(wave)) ** 2
    assert power[60:].sum() < 1e-3 * power[1:60].sum()


@pytest.mark.parametrize("record", [0, 1])
def test_the_published_physics_is_some_tenths_of_a_volt_off(plant, record):
    predicted = physics_alone(plant[:, record], np.full(2, plant[0, record + 2]))
    assert 0.1 < np.sqrt(np.mean((predicted - plant[:, record + 2]) ** 2)) < 1.2


def test_without_overflow_noise_and_saturation_it_is_the_published_model():
    plain = TankSimulator(k1=0.0464, k2=0.0003, k3=0.0412, k4=0.0586, k5=0.0039, rim=np.inf, noise=0.0)
    u = np.linspace(2.0, 3.0, 50)[:, None]
    found = simulate(u, np.array([[4.0], [5.0]]), np.random.default_rng(0), plain)
    np.testing.assert_allclose(found[:, 0], physics_alone(u[:, 0], [4.0, 5.0]), atol=1e-4)


def test_the_lower_tank_gets_its_share_of_the_spill():
    def level(share):
        simulator = TankSimulator(share=share, noise=0.0)
        return simulate(np.full((10, 1), 6.0), np.array([[9.0], [0.0]]), np.random.default_rng(0), simulator)[-1, 0]

    assert level(0.0) < level(0.5) < level(1.0)
