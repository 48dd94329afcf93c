"""A hidden periodic disturbance is a line in the spectrum of the errors that the input does not have."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.problem import Signals
from pgrssnn_jax.discovery.unknown import Line, spectral_line

TIME, DT, SIGMA = 800, 4.0, 0.1


def signals(u: np.ndarray, weight: float = 1.0, outputs: int = 1) -> Signals:
    shape = (len(u), TIME, outputs)
    return Signals(
        u,
        np.zeros(shape),
        np.full(shape, weight),
        np.zeros(shape[:2], int),
        np.zeros((len(u), 2)),
        np.zeros((len(u), 2)),
    )


def sine(period_s: float) -> np.ndarray:
    return np.sin(2 * np.pi * DT / period_s * np.arange(TIME) + 0.4)[None, :, None]


def noise(seed: int, sequences: int = 1, outputs: int = 1) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal((sequences, TIME, outputs))


def line(error: np.ndarray, u: np.ndarray | None = None, weight: float = 1.0) -> Line | None:
    u = noise(99, len(error)) if u is None else u
    return spectral_line(signals(u, weight, error.shape[2]), weight * error, DT)


@pytest.mark.parametrize("period", [24.0, 97.0, 180.0])
@pytest.mark.parametrize("weight", [1.0, 0.4])
def test_period_and_amplitude_are_those_of_the_disturbance(period, weight):
    found = line(0.3 * sine(period) + noise(1), weight=weight)
    assert found is not None
    resolution = period**2 / (TIME * DT)  # of a spectrum of this record, in s at this period
    assert found.period_s == pytest.approx(period, abs=resolution)
    assert found.amplitude == pytest.approx(0.3, rel=0.15)


def test_the_output_that_has_the_line_is_told():
    error = noise(2, outputs=3)
    error[..., 2:] += 0.3 * sine(60.0)
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
    error = 0.3 * sine(60.0) + noise(3)
    assert line(error, u=2.0 * sine(60.0) + noise(4)) is None


def test_a_record_too_short_for_a_neighbourhood_has_none():
    short = spectral_line(Signals(*(a[:, :80] if a.ndim > 2 else a for a in signals(noise(5)))), noise(6)[:, :80], DT)
    assert short is None
