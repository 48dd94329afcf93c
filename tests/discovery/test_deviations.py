"""Standard deviations of fitted numbers where a disturbance of the dynamics moves a linear system."""

import jax
import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.deviations import Deviations, deviations
from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.problem import Problem, build_problem, weighted_signals
from pgrssnn_jax.physics.linear import lgssm

SAMPLES, NOISE = 300, 0.5
SETTINGS = Settings(spare=3, lanes=3, steps=8)


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.99]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    return build_problem(physics, [], fixed=["A", "C"])


def fitted(problem: Problem, disturbed: float, seed: int) -> tuple[np.ndarray, Deviations]:
    """θ of x' = 0.99 x + B u + w, of which B is free, and its deviation."""
    draw, x, y = np.random.default_rng(seed), 0.0, []
    u = np.sign(np.sin(0.05 * np.arange(SAMPLES)))[:, None]
    for (v,) in u:
        x = 0.99 * x + v + disturbed * draw.standard_normal()
        y.append([x + NOISE * draw.standard_normal()])
    with jax.enable_x64(True):
        signals = weighted_signals(problem, small_record(u, np.array(y)), folds=3, block=20)
        ((guess, _),) = fit_all(problem, signals, [Guess((), problem.theta, signals.start)], SETTINGS)
        return guess.theta, deviations(problem, signals, guess, SETTINGS)


def test_in_white_noise_the_widest_is_hardly_wider(problem):
    _, found = fitted(problem, 0.0, 0)
    assert len(found.free) == len(found.widest) == 1
    assert 1.0 <= found.widest[0] / found.coloured[0] < 1.6


def test_the_interval_holds_the_true_number_in_95_of_100_disturbed_records(problem):
    held = []
    for seed in range(60):
        theta, found = fitted(problem, 0.1, seed)
        held.append(abs(theta[found.free[0]] - 1.0) <= 1.97 * found.widest[0])
        assert found.widest[0] >= found.coloured[0]
    assert np.mean(held) >= 0.9


def test_of_a_long_record_no_disturbance_is_tried(problem, monkeypatch):
    usual = [fitted(problem, 0.1, seed)[1] for seed in range(10)]
    monkeypatch.setattr("pgrssnn_jax.discovery.process_noise._MOST", 1000)
    found = [fitted(problem, 0.1, seed)[1] for seed in range(10)]
    narrower = [one.widest[0] < other.widest[0] for one, other in zip(found, usual, strict=True)]
    assert any(narrower)
    for one, other in zip(found, usual, strict=True):
        np.testing.assert_array_equal(one.coloured, other.coloured)
