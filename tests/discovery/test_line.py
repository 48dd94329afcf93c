"""A line in the errors counts where no noise of the record explains it: a resonance of the dynamics is none."""

import jax
import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate
from pgrssnn_jax.discovery.line import line_beside_noise
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.spectrum import Line, spectral_line
from pgrssnn_jax.physics.linear import lgssm

SAMPLES, NOISE = 1600, 0.05
PERIOD = 40.0
TURN = 0.998 * np.array([[np.cos(0.16), -np.sin(0.16)], [np.sin(0.16), np.cos(0.16)]])  # a period of 39 samples


def driven(seed: int, gusts: float, u: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """An oscillator that its input and gusts excite; u: random if not given."""
    draw, x, states = np.random.default_rng(seed), np.zeros(2), []
    random = draw.standard_normal(SAMPLES)
    u = random if u is None else u
    for force in u + gusts * draw.standard_normal(SAMPLES):
        x = TURN @ x + np.array([0.1, 0.0]) * force
        states.append(x[0])
    return u, np.array(states) + NOISE * draw.standard_normal(SAMPLES)


def lines(u: np.ndarray, y: np.ndarray, *, clear: bool) -> tuple[Line | None, Line | None]:
    """In the errors of the true model, before and after noise is considered."""
    physics = lgssm(A=TURN.tolist(), B=[[0.1], [0.0]], C=[[1.0, 0.0]])
    with jax.enable_x64(True):
        problem = build_problem(physics, [], accelerate=False)
        signals = weighted_signals(problem, small_record(u[:, None], y[:, None]), folds=5, block=32)
        estimate = evaluate(problem, signals, Guess((), problem.theta, np.zeros((1, 2))))
        beside = line_beside_noise(problem, signals, estimate, Settings(), Criteria(), clear=clear)
    return spectral_line(estimate.error, signals.u), beside


@pytest.mark.parametrize("seed", range(3))
def test_a_resonance_that_gusts_excite_is_no_line(seed):
    seen, beside = lines(*driven(seed, gusts=1.0), clear=True)
    assert seen is not None, "the spectrum alone has one"
    assert beside is None


@pytest.mark.parametrize(
    ("amplitude", "gusts", "clear"), [(0.05, 0.0, False), (1.0, 0.0, True), (0.1, 0.03, False), (1.0, 0.3, True)]
)
def test_a_sinusoid_is_one_near_the_noise_and_above_it(amplitude, gusts, clear):
    u, y = driven(4, gusts)
    _, beside = lines(u, y + amplitude * np.sin(2 * np.pi / 7.3 * np.arange(SAMPLES)), clear=clear)
    assert beside is not None
    assert beside.period == pytest.approx(7.3, rel=2e-3)


@pytest.mark.parametrize("clear", [False, True])
def test_harmonics_of_an_input_are_no_lines_near_the_noise(clear):
    """They are those of a curved or quantised sensor."""
    wave = 2 * np.pi / PERIOD * np.arange(SAMPLES)
    u, y = driven(5, 0.0, 3.0 * np.sin(wave))
    _, beside = lines(u, y + 0.05 * np.sin(3 * wave), clear=clear)
    assert (beside is not None) == clear
