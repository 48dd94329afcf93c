"""The size of the noise, surrogates of errors, and what a candidate gains by luck."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.estimate import Estimate
from pgrssnn_jax.discovery.noise import noise_floor, surrogates
from pgrssnn_jax.discovery.null import Added, null_law


def white(sigma=0.3, shape=(2, 1500, 2), seed=0):
    return sigma * np.random.default_rng(seed).standard_normal(shape)


def test_the_floor_of_white_noise_is_its_energy():
    error = white()
    assert noise_floor(error, np.ones(error.shape)) == pytest.approx(0.09 * error.size, rel=0.05)


def test_what_varies_slowly_is_no_noise():
    slow = np.sin(np.arange(1500) / 40)[None, :, None] * np.ones((2, 1, 2))
    assert noise_floor(slow, np.ones(slow.shape)) < 1e-4 * (slow**2).sum()
    both = slow + white(0.1)
    assert noise_floor(both, np.ones(both.shape)) == pytest.approx(0.01 * both.size, rel=0.05)


def test_rare_jumps_are_no_noise():
    error = white(0.1)
    error[:, ::200] += 2.0
    assert noise_floor(error, np.ones(error.shape)) < 1.6 * 0.01 * error.size < (error**2).sum()


def test_the_floor_is_never_above_the_error():
    error = np.tile([1.0, -1.0], 50)[None, :, None]
    assert noise_floor(error, np.ones(error.shape)) == (error**2).sum()
    assert noise_floor(np.zeros((1, 50, 1)), np.ones((1, 50, 1))) == 0.0
    assert noise_floor(white(shape=(1, 2, 1)), np.ones((1, 2, 1))) == 0.0


def test_samples_that_were_not_measured_do_not_count():
    error, weight = white(), np.ones((2, 1500, 2))
    weight[:, 700:, 1] = 0.0
    wild = np.where(weight > 0, error, 77.0)
    assert noise_floor(np.where(weight > 0, error, 0.0), weight) == pytest.approx(noise_floor(wild, weight))
    assert noise_floor(wild, weight) == pytest.approx(0.09 * (weight > 0).sum(), rel=0.05)


@pytest.mark.parametrize("pattern", [(1, 0), (1, 1, 0), (1, 0, 0, 0)])
def test_the_floor_needs_no_neighbours_that_were_measured(pattern):
    slow = np.sin(np.arange(1500) / 40)[None, :, None]
    error, weight = slow + white(), np.ones((2, 1500, 2)) * np.resize(pattern, 1500)[None, :, None]
    assert noise_floor(error, weight) == pytest.approx(0.09 * weight.sum(), rel=0.1)


@pytest.mark.parametrize("time", [100, 101])
def test_surrogates_keep_the_spectrum(time):
    error = np.cumsum(white(shape=(2, time, 3)), 1)
    found = surrogates(error, 20, np.random.default_rng(1))
    assert found.shape == (20, 2, time, 3)
    expected = np.abs(np.fft.rfft(error, axis=1))
    last = -1 if time % 2 == 0 else None  # the phase at half the sample rate cannot turn and stay real
    spectrum = np.abs(np.fft.rfft(found, axis=2))
    np.testing.assert_allclose(spectrum[:, :, :last], np.broadcast_to(expected, spectrum.shape)[:, :, :last], rtol=1e-8)
    assert not np.allclose(found[0], found[1])


def test_surrogates_keep_how_outputs_go_together():
    one = np.cumsum(white(shape=(1, 200, 1)), 1)
    found = surrogates(np.concatenate([one, -2.0 * one], -1), 5, np.random.default_rng(1))
    np.testing.assert_allclose(found[..., 1], -2.0 * found[..., 0], atol=1e-10)


def estimate(error):
    return Estimate((), np.zeros(1), np.zeros((1, 1)), error)


def test_the_law_of_white_noise_is_that_of_its_dimension():
    """An orthonormal basis of m columns takes m of n parts of white noise."""
    error = white(shape=(1, 400, 1))
    basis, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((400, 8)))
    law = null_law(estimate(error), np.ones(error.shape), [Added(basis, 1.0, 1.0)], 2000, np.random.default_rng(0))
    assert np.all(np.diff(law) >= 0)
    assert law.mean() == pytest.approx(8 / 400, rel=0.1)
    assert law[0] >= 0
    assert law[-1] < 0.2


def test_the_best_of_many_gains_more_by_luck():
    error = white(shape=(1, 300, 1))
    rng = np.random.default_rng(3)
    many = [Added(np.linalg.qr(rng.standard_normal((300, 2)))[0], 1.0, 1.0) for _ in range(12)]
    one, best = (
        null_law(estimate(error), np.ones(error.shape), added, 400, np.random.default_rng(0))
        for added in (many[:1], many)
    )
    assert np.all(best >= one)
    assert np.median(best) > 2 * np.median(one)


def test_a_candidate_that_adds_nothing_gains_nothing():
    error = white(shape=(1, 100, 1))
    law = null_law(
        estimate(error), np.ones(error.shape), [Added(np.zeros((100, 0)), 0.0, 0.0)], 50, np.random.default_rng(0)
    )
    np.testing.assert_array_equal(law, np.zeros(50))
