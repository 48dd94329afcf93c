"""Starts eliminated against one large fit, stretches end to end, the local polynomial against a known motion."""

import jax.numpy as jnp
import numpy as np
import pytest

from pgrssnn_jax.discovery.linear import _without_starts
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.discovery.stretches import end_to_end, smoothed, stretches
from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.records.record import Channel, RecordInfo, record


def test_starts_are_eliminated_as_by_one_large_fit():
    """Two stretches with their own starts and a prior on these, against the stacked least-squares problem."""
    draw = np.random.default_rng(1)
    columns, starts = draw.standard_normal((2, 12, 3)), draw.standard_normal((2, 12, 2))
    error, precision, off = (
        draw.standard_normal((2, 12)),
        np.array([[4.0, 0.0], [1.0, 9.0]]),
        draw.standard_normal((2, 2)),
    )
    rest, pull, energy = _without_starts(precision, off, columns, starts, error)
    normal = np.einsum("snk,snl->kl", columns, rest)
    step = np.linalg.solve(normal, pull.sum(0))
    rows, right = [], []
    for s in range(2):
        local = np.zeros((12, 4))
        local[:, 2 * s : 2 * s + 2] = starts[s]
        rows.append(np.hstack([columns[s], local]))
        right.append(error[s])
        prior = np.zeros((2, 7))
        prior[:, 3 + 2 * s : 5 + 2 * s] = np.diag(np.sqrt(precision[s]))
        rows.append(prior)
        right.append(np.sqrt(precision[s]) * off[s])
    whole, aim = np.vstack(rows), np.concatenate(right)
    best = np.linalg.lstsq(whole, aim, rcond=None)[0]
    np.testing.assert_allclose(step, best[:3], rtol=1e-5)
    left = ((aim - whole @ best) ** 2).sum()
    np.testing.assert_allclose(energy.sum() - pull.sum(0) @ step, left, rtol=1e-5)


def test_stretches_end_to_end_are_the_sequences_again():
    whole = np.arange(2 * 12 * 3).reshape(2, 12, 3)
    pieces = whole.reshape(2 * 4, 3, 3)
    np.testing.assert_array_equal(end_to_end(pieces, 4, axis=0), whole)
    np.testing.assert_array_equal(end_to_end(np.stack([pieces, -pieces]), 4), np.stack([whole, -whole]))


def test_a_local_polynomial_finds_position_rate_and_noise():
    draw, dt = np.random.default_rng(2), 0.1
    time = dt * np.arange(400)
    motion = np.sin(0.5 * time)[None, :, None]
    found = smoothed(motion + 0.02 * draw.standard_normal(motion.shape), dt)
    inside = slice(20, -20)
    assert found.noise[0] == pytest.approx(0.02, rel=0.15)
    off = found.value[0, inside, 0] - motion[0, inside, 0]
    assert np.sqrt(np.mean(off**2)) == pytest.approx(found.value_error[0], rel=0.4)
    rate = found.rate[0, inside, 0] - 0.5 * np.cos(0.5 * time[inside])
    assert np.sqrt(np.mean(rate**2)) == pytest.approx(found.rate_error[0], rel=0.4)


@pytest.mark.parametrize("output_timing", ["after_step", "before_step"])
def test_a_stretch_starts_in_the_state_that_its_first_input_meets(output_timing):
    """A cart under a constant push, sampled before or after it acts."""
    dt, push, time = 0.1, 0.5, 60

    def step(p, x, u):
        return jnp.stack([x[0] + dt * x[1] + 0.5 * dt**2 * u[0], x[1] + dt * u[0]])

    states = (Signal("position", "m", like="place"), Signal("speed", "m/s", rate_of="place"))
    cart = discrete("cart", step, lambda p, x, u: x[:1], {"mass": 1.0}, states=states, inputs=(Signal("push", "N"),),
                    outputs=(Signal("place", "m"),), dt=dt, output_timing=output_timing)  # fmt: skip
    t = dt * (np.arange(time) + (output_timing == "after_step"))
    y = (1.0 + 0.3 * t + 0.5 * push * t**2)[:, None]
    info = RecordInfo((Channel("push", "N"),), (Channel("place", "m"),), dt, "simulated")
    found = stretches(build_problem(cart, ()), record(np.full((time, 1), push), y, info), 20, folds=2, at_rest=False)
    begins = dt * np.arange(0, time, 20)
    np.testing.assert_allclose(found.start[:, 0], 1.0 + 0.3 * begins + 0.5 * push * begins**2, atol=6e-3)
    np.testing.assert_allclose(found.start[:, 1], 0.3 + push * begins, atol=1e-3)
