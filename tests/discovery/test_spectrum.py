"""A hidden periodic disturbance is a line in the spectrum of the errors that the input does not have."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.spectrum import Line, spectral_line, without_line

TIME, SIGMA = 800, 0.1


def sine(period: float, phase: float = 0.4) -> np.ndarray:
    return np.sin(2 * np.pi / period * np.arange(TIME) + phase)[None, :, None]


def noise(seed: int, sequences: int = 1, outputs: int = 1) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal((sequences, TIME, outputs))


def line(error: np.ndarray, u: np.ndarray | None = None) -> Line | None:
    return spectral_line(error, noise(99, len(error)) if u is None else u)


@pytest.mark.parametrize("period", [4.7, 6.0, 24.3, 45.0])
@pytest.mark.parametrize("seed", range(3))
def test_period_and_amplitude_are_those_of_the_disturbance(period, seed):
    found = line(0.3 * sine(period) + noise(seed))
    assert found is not None
    bin_width = period**2 / TIME  # in samples of period
    assert found.period == pytest.approx(period, abs=0.1 * bin_width)
    assert found.amplitude == pytest.approx(0.3, rel=0.15)


def test_the_output_that_has_the_line_is_told():
    error = noise(2, outputs=3)
    error[..., 2:] += 0.3 * sine(15.0)
    found = line(error)
    assert found is not None
    assert found.output == 2


@pytest.mark.parametrize("seed", range(20))
def test_noise_has_no_line_whatever_its_colour(seed):
    white = noise(seed)
    assert line(white) is None
    coloured = np.apply_along_axis(lambda e: np.convolve(e, 0.95 ** np.arange(60), "same"), 1, white)
    assert line(coloured) is None


def test_a_line_that_the_input_has_too_is_the_models_affair():
    error = 0.3 * sine(15.0) + noise(3)
    assert line(error) is not None
    assert line(error, u=2.0 * sine(15.0) + noise(4)) is None


def test_a_line_of_a_small_input_counts_beside_a_large_one():
    u = np.concatenate([1e-6 * (2.0 * sine(15.0) + noise(4)), 1e6 * noise(6)], axis=-1)
    assert line(0.3 * sine(15.0) + noise(3), u=u) is None


def test_a_record_too_short_for_a_neighbourhood_has_none():
    error = 0.3 * sine(5.0) + noise(3)
    assert line(error[:, :100], noise(99)[:, :100]) is not None
    assert line(error[:, :99], noise(99)[:, :99]) is None


def test_errors_without_a_line_stay_as_they_are():
    error = noise(1)[..., 0]
    assert without_line(error, np.ones(error.shape, bool)) is error


@pytest.mark.parametrize("period", [4.7, 24.3])
def test_every_sequence_loses_its_own_sinusoid(period):
    white = noise(5, sequences=2)
    error = white + np.concatenate([0.3 * sine(period), 0.8 * sine(period, phase=2.0)])
    measured = np.random.default_rng(0).uniform(size=error.shape[:2]) < 0.9
    left = without_line(error[..., 0], measured)
    assert np.array_equal(left[~measured], error[..., 0][~measured])
    assert (left[measured] ** 2).mean() == pytest.approx((white[..., 0][measured] ** 2).mean(), rel=0.05)
