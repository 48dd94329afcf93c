"""The correction signal of a tank into whose lower part water is poured for a while."""

import jax
import numpy as np
import pytest
from discovery.small_cases import pump, tank_record

from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.locate import clear, intervals
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.discovery.responses import path_of
from pgrssnn_jax.discovery.smoother import _smooth, smoothed_correction
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


def in_one_piece(a, c, error, noise, equation, rate, *, after_step):
    """The same as one Gaussian: unknowns z_0 and w_1..w_T at once, by least squares with their priors. Mean and
    deviation of the d that acts in each step, and the log-likelihood of the errors but for a constant."""
    time, n = len(a), a.shape[-1]
    z = np.zeros((n + 1, n + 1 + time))  # the present state by all unknowns
    z[:, : n + 1] = np.eye(n + 1)
    rows, before = [], []
    for t in range(time):
        f = np.zeros((n + 1, n + 1))
        f[:n, :n], f[n, n], f[equation, n] = a[t], 1.0, 1.0
        before.append(z[n])
        seen = z
        z = f @ z
        z[n, n + 1 + t] += rate
        rows.append(c[t] @ (z if after_step else seen)[:n])
    seen, drift = np.concatenate(rows), np.array(before)
    prior = np.r_[np.full(n + 1, 1e3 * noise**2), np.ones(time)]
    inverse = np.linalg.inv(np.diag(1.0 / prior) + seen.T @ seen / noise**2)
    mean = inverse @ seen.T @ error.ravel() / noise**2
    spread = seen * prior @ seen.T + noise**2 * np.eye(error.size)
    likelihood = -0.5 * (error.ravel() @ np.linalg.solve(spread, error.ravel()) + np.linalg.slogdet(spread)[1])
    return drift @ mean, np.sqrt(np.einsum("ti,ij,tj->t", drift, inverse, drift)), likelihood


@pytest.mark.parametrize("timing", ["after_step", "before_step"])
def test_the_smoother_is_that_of_one_gaussian(timing):
    rng = np.random.default_rng(0)
    a = 0.8 * np.eye(2) + 0.1 * rng.standard_normal((60, 2, 2))
    c, noise = rng.standard_normal((60, 1, 2)), 0.1
    error = 0.3 * np.cumsum(rng.standard_normal((60, 1)), 0)
    shown = np.ones((1, 60, 1), bool)
    mean, std, gain = _smooth(a[None], c[None], error[None], shown, noise, timing)
    rates = 10.0 ** np.arange(-6.0, 0.1, 1.0) * error.std()
    found = [[in_one_piece(a, c, error, noise, i, r, after_step=timing == "after_step") for r in rates] for i in (0, 1)]
    likelihood = np.array([[one[2] for one in row] for row in found])
    np.testing.assert_allclose(gain, likelihood.max(1) - likelihood[:, 0].max(), rtol=1e-6)
    for i, best in enumerate(likelihood.argmax(1)):
        np.testing.assert_allclose(mean[i, 0], found[i][best][0], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(std[i, 0], found[i][best][1], rtol=1e-5)
