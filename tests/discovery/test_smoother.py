"""The correction signal of a tank into whose lower part water is poured for a while."""

import jax
import numpy as np
import pytest
from discovery.small_cases import pump, tank_record

from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.locate import clear, intervals
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.discovery.responses import path_of
from pgrssnn_jax.discovery.smoother import smoothed_correction
from pgrssnn_jax.physics.tanks import cascaded_tanks

SAMPLES, NOISE = 300, 0.005
BEGIN, END = 120, 160  # samples


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def pulsed(size: float):
    u = pump(SAMPLES, 4, low=1.5, high=3.5)
    push = np.where((np.arange(SAMPLES) >= BEGIN) & (np.arange(SAMPLES) < END), size, 0.0)
    problem = build_problem(cascaded_tanks(integrator="rk4"), [])
    record = weighted_signals(problem, tank_record(u, NOISE, push=push), folds=3, block=20)
    start = np.array([[4.0, 4.0]])
    path = path_of(problem, record, Guess((), problem.theta, start))
    error = record.weight * (record.y - path.y)
    noise = NOISE * float(record.weight.max())
    return smoothed_correction(problem, record, path, error, noise)


@pytest.mark.parametrize("size", [0.02, -0.02])
def test_a_pulse_in_one_equation_is_found_there_and_then(size):
    found = pulsed(size)
    assert found.mean.shape == found.std.shape == (2, 1, SAMPLES)
    lower = found.mean[1, 0]
    assert np.mean(lower[BEGIN + 5 : END - 5]) == pytest.approx(size, rel=0.2)
    assert np.abs(np.r_[lower[: BEGIN - 10], lower[END + 10 :]]).max() < 0.4 * abs(size)
    longest = max(intervals(clear(lower, found.std[1, 0]), 4.0), key=lambda pair: pair[1] - pair[0])
    assert longest[0] == pytest.approx(4.0 * BEGIN, abs=40.0)
    assert longest[1] == pytest.approx(4.0 * END, abs=40.0)


def test_the_equation_of_a_pulse_is_the_likeliest():
    assert np.argmax(pulsed(0.02).likelihood) == 1


def test_noise_alone_needs_no_correction():
    problem = build_problem(cascaded_tanks(integrator="rk4"), [])
    record = weighted_signals(problem, tank_record(pump(SAMPLES, 4), NOISE), folds=3, block=20)
    start = np.array([[4.0, 4.0]])
    path = path_of(problem, record, Guess((), problem.theta, start))
    noise = NOISE * float(record.weight.max())
    error = record.weight * (record.y - path.y)
    found = smoothed_correction(problem, record, path, error, noise)
    assert np.all(found.likelihood < 5.0)
    assert np.abs(found.mean[1]).max() < 1e-3
    assert clear(found.mean[1, 0], found.std[1, 0]).mean() < 0.1
