"""The size of the noise, its colour, and errors that look like it but mean nothing."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pgrssnn_jax.discovery.noise import (
    above_white_noise,
    autoregression,
    correlation_time,
    noise_floor,
    recoloured,
    surrogates,
    surrogates_of,
)


def white(sigma=0.3, shape=(2, 1500, 2), seed=0):
    return sigma * np.random.default_rng(seed).standard_normal(shape)


def coloured(poles, shape=(2, 4000, 1), seed=0):
    return lfilter([1.0], np.poly(poles), white(1.0, shape, seed), axis=1)


def test_the_floor_of_white_noise_is_its_energy():
    error = white()
    assert noise_floor(error, np.ones(error.shape)) == pytest.approx(0.09 * error.size, rel=0.05)


def test_what_varies_slowly_is_no_noise():
    slow = np.sin(np.arange(1500) / 40)[None, :, None] * np.ones((2, 1, 2))
    assert noise_floor(slow, np.ones(slow.shape)) < 1e-4 * (slow**2).sum()
    both = slow + white(0.1)
    assert noise_floor(both, np.ones(both.shape)) == pytest.approx(0.01 * both.size, rel=0.05)


@pytest.mark.parametrize("period", [5.0, 7.3, 30.0])
def test_a_hum_is_no_noise(period):
    hum = 2.0 * np.sin(2 * np.pi * np.arange(1500) / period)[None, :, None] * np.ones((2, 1, 2))
    assert noise_floor(hum + white(0.1), np.ones(hum.shape)) == pytest.approx(0.01 * hum.size, rel=0.1)


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


def test_the_autoregression_is_the_one_that_made_the_errors():
    poles = [0.9, 0.6 + 0.3j, 0.6 - 0.3j]
    found = autoregression(coloured(poles)[..., 0])
    np.testing.assert_allclose(found, np.append(np.poly(poles), 0.0), atol=0.05)


def test_the_autoregression_needs_no_sample_that_was_not_measured():
    error, measured = coloured([0.9])[..., 0], np.ones((2, 4000), bool)
    measured[:, ::10] = False
    found = autoregression(np.where(measured, error, 99.0), measured)
    np.testing.assert_allclose(found, [1.0, -0.9, 0.0, 0.0, 0.0], atol=0.06)


def test_an_autoregression_never_runs_away():
    explosive = autoregression(1.1 ** np.arange(100.0)[None])
    assert np.abs(np.roots(explosive)).max() < 1.0


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.95])
def test_the_correlation_time_of_a_first_order_process_is_known(pole):
    assert correlation_time(np.array([1.0, -pole])) == pytest.approx((1.0 + pole) / (1.0 - pole), rel=1e-6)
    assert correlation_time(np.array([1.0, 0.5])) == 1.0, "samples that alternate tell no less than independent ones"


def test_surrogates_keep_the_colour_and_when_noise_is_large():
    loud = np.where(np.arange(4000) % 400 < 100, 5.0, 1.0)[None, :, None]
    error = lfilter([1.0], [1.0, -0.9], loud * white(1.0, (1, 4000, 1)), axis=1)
    found = surrogates(error, 50, np.random.default_rng(1))
    assert found.shape == (50, *error.shape)
    lagged = [(one[0, 1:, 0] @ one[0, :-1, 0]) / (one**2).sum() for one in (*found, error)]
    assert np.mean(lagged[:-1]) == pytest.approx(lagged[-1], abs=0.02)
    quiet = loud[0, :, 0] < 2.0
    for part in (quiet, ~quiet):
        assert (found[:, 0, part] ** 2).mean() == pytest.approx((error[0, part] ** 2).mean(), rel=0.15)
    together = np.corrcoef(found[..., 0].reshape(50, -1))[0, 1:]
    assert np.abs(together).mean() < 0.15, "they have nothing in common"


def test_innovations_keep_their_size_at_every_sample():
    filters, innovations = np.array([[1.0, -0.8], [1.0, 0.3]]), white(shape=(2, 100, 2))
    found = recoloured(innovations, filters, 5, np.random.default_rng(1))
    for j, own in enumerate(filters):
        again = lfilter(own, [1.0], found[..., j], axis=-1)
        np.testing.assert_allclose(np.abs(again), np.abs(np.broadcast_to(innovations[..., j], again.shape)), rtol=1e-9)


def test_surrogates_keep_how_outputs_go_together():
    one = np.cumsum(white(shape=(1, 200, 1)), 1)
    found = surrogates(np.concatenate([one, -2.0 * one], -1), 5, np.random.default_rng(1))
    np.testing.assert_allclose(found[..., 1], -2.0 * found[..., 0], rtol=1e-6, atol=1e-9)


def test_energy_and_pull_of_surrogates_are_those_of_the_draws():
    error = np.concatenate([coloured([0.9], (3, 80, 1)), white(0.5, (3, 80, 1), 1)], -1)
    columns = white(1.0, (3, 80 * 2, 5), 2).reshape(3, 80, 2, 5)
    drawn = surrogates(error, 20, np.random.default_rng(3))
    kept = surrogates_of(error, 20, np.random.default_rng(3))
    np.testing.assert_allclose(kept.energy(), (drawn**2).sum((1, 2, 3)), rtol=1e-10)
    np.testing.assert_allclose(kept.pull(columns), np.einsum("dsty,styk->dk", drawn, columns), rtol=1e-8, atol=1e-8)


def test_errors_that_vary_slowly_are_above_their_white_noise():
    error = white()
    assert not above_white_noise(error, np.ones(error.shape), 1.1)
    slow = np.sin(np.arange(1500) / 40)[None, :, None] + error  # RMS 0.77 over noise of 0.3
    assert above_white_noise(slow, np.ones(slow.shape), 2.0)
    assert not above_white_noise(slow, np.ones(slow.shape), 3.0)
