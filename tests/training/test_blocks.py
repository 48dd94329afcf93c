"""How long a system remembers: against exponentials by hand, integrators, and autoregressions of known correlation."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.records.record import Channel, RecordInfo, record
from pgrssnn_jax.training.blocks import correlation_time, memory

INFO = RecordInfo((Channel("u"),), (Channel("y"),), 1.0, "simulated")


def decaying(pole, growth=0.0):
    return discrete(
        "decaying",
        lambda p, x, u: p["a"] * x + u + growth * x**3,
        lambda p, x, u: x,
        {"a": pole},
        states=(Signal("x", like="y"),),
        inputs=(Signal("u"),),
        outputs=(Signal("y"),),
        dt=1.0,
    )


def measured(pole, samples=300, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, 1))
    u[0] = 0.0  # at rest, so that the first output is where the run starts
    y = lfilter([1.0], [1.0, -pole], u, axis=0)
    return record(u, y + noise * rng.standard_normal(y.shape), INFO)


@pytest.mark.parametrize("pole", [0.5, 0.9, 0.97])
def test_a_first_order_system_remembers_its_time_constant(pole):
    found = memory(decaying(pole), measured(pole, noise=0.1))
    assert found == pytest.approx(-1.0 / np.log(pole), abs=1.5)


def test_an_integrator_remembers_its_whole_record():
    assert memory(decaying(1.0), measured(0.9)) == 300


def test_slow_errors_are_remembered_where_the_system_forgets():
    rng = np.random.default_rng(1)
    plain = measured(0.5, 4000)
    slow = lfilter([1.0], [1.0, -0.95], rng.standard_normal((1, 4000, 1)), axis=1)
    found = memory(decaying(0.5), plain._replace(y=plain.y + slow))
    assert found == pytest.approx(2 * 0.95 / 0.05, rel=0.4)


def test_a_physics_that_leaves_the_range_remembers_everything():
    assert memory(decaying(0.9, growth=10.0), measured(0.9)) == 300


@pytest.mark.parametrize("pole", [0.0, 0.8, 0.95])
def test_the_correlation_time_of_an_autoregression(pole):
    rng = np.random.default_rng(2)
    errors = lfilter([1.0], [1.0, -pole], rng.standard_normal(40_000))
    assert correlation_time(errors) == pytest.approx(pole / (1 - pole), rel=0.15, abs=0.1)
    assert correlation_time(1e-6 * errors) == pytest.approx(correlation_time(errors), rel=1e-6, abs=1e-9)


def test_constant_errors_have_no_correlation_time():
    assert correlation_time(np.ones(50)) == 0.0
    assert correlation_time(np.asarray(jnp.zeros(50))) == 0.0
