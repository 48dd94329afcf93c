"""A disturbance of an axis under white noise of its position: what it is told from, and what it does to a fit."""

import numpy as np
import pytest
from discovery.test_null import linearised

from pgrssnn_jax.discovery.kalman import Models
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.process_noise import ProcessNoise, disturbances, process_noise, with_disturbances

SAMPLES = 400
A = np.array([[1.0, 0.1], [0.0, 0.98]])
RAMP = np.column_stack([np.ones(SAMPLES), np.linspace(-1.0, 1.0, SAMPLES)])  # of another start


def axis(samples: int = SAMPLES) -> Models:
    """Position and speed, of which the position is read; disturbances may move the one or the other."""
    c = np.tile([[1.0, 0.0]], (1, samples, 1, 1))
    places = np.broadcast_to(np.eye(2)[:, None, None], (2, 1, samples, 2))
    return with_disturbances(np.tile(A, (1, samples, 1, 1)), places, c, np.ones((1, samples, 1), bool), "after_step")


def disturbed(size: float, rng: np.random.Generator, pole: float = 0.0) -> np.ndarray:
    """Errors in the position: white ones, and those of a disturbance of the speed with a memory."""
    x, push, found = np.zeros(2), 0.0, np.zeros(SAMPLES)
    for t in range(SAMPLES):
        push = pole * push + (1.0 - pole**2) ** 0.5 * rng.standard_normal()
        x = A @ x + [0.0, size * push]
        found[t] = x[0] + rng.standard_normal()
    return found


def likeliest(where: Models, at: Linearisation) -> ProcessNoise:
    tried = disturbances(where, at)
    assert tried is not None
    return process_noise(tried, at)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("size", "pole"), [(0.1, 0.0), (0.03, 0.9)])
def test_a_disturbance_of_the_speed_is_told_from_coloured_noise(seed, size, pole):
    at = linearised(disturbed(size, np.random.default_rng(seed), pole), RAMP[:, :1])
    found = likeliest(axis(), at)
    assert found.likelihood > noise_of(at).likelihood(at.measured) + 5.0
    white = found.innovations[0, :, 0] / found.filter.variance[0, 0, :, 0] ** 0.5
    assert np.abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.12


@pytest.mark.parametrize("seed", range(4))
def test_coloured_noise_of_the_sensor_is_likelier_as_what_it_is(seed):
    rng, error = np.random.default_rng(seed), np.zeros(SAMPLES)
    for t in range(1, SAMPLES):  # which changes its sign from sample to sample: no disturbance passes an axis so
        error[t] = -0.8 * error[t - 1] + rng.standard_normal()
    at = linearised(error, RAMP[:, :1])
    assert likeliest(axis(), at).likelihood < noise_of(at).likelihood(at.measured)


def test_no_disturbance_is_found_where_none_reaches_an_output():
    at = linearised(np.random.default_rng(0).standard_normal(50), np.ones((50, 1)))
    where = axis(50)
    assert disturbances(where._replace(c=0.0 * where.c), at) is None


def test_the_sandwich_of_a_disturbance_has_the_spread_of_estimates():
    """A slope fitted to 200 records of a disturbed axis."""
    estimates, deviations = [], []
    for seed in range(200):
        error = disturbed(0.1, np.random.default_rng(seed))
        estimates.append(np.linalg.lstsq(RAMP, error, rcond=None)[0][1])
        if seed < 40:
            at = linearised(error, RAMP)
            deviations.append(likeliest(axis(), at).covariance(at, 1.0)[1, 1] ** 0.5)
    assert np.mean(np.square(deviations)) ** 0.5 == pytest.approx(np.std(estimates), rel=0.25)


def test_a_long_record_is_judged_by_its_first_part(monkeypatch):
    at = linearised(disturbed(0.1, np.random.default_rng(6)), RAMP[:, :1])
    whole = likeliest(axis(), at)
    monkeypatch.setattr("pgrssnn_jax.discovery.process_noise._ENOUGH", 300)
    part = likeliest(axis(), at)
    assert part.innovations.shape == whole.innovations.shape
    assert part.likelihood == pytest.approx(whole.likelihood, abs=3.0)
