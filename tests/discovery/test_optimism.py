"""Errors without a quarter over those of the fit, for x' = 0.8 x + b u, y = x from x_0 = 0, in which b is free: by the
formula of least squares with one number."""

import numpy as np
import pytest
from scipy.signal import lfilter
from toys import small_record

from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.optimism import optimism
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.physics.linear import lgssm

SETTINGS = Settings(spare=1, lanes=1, steps=60, tolerance=1e-12)

pytestmark = pytest.mark.usefixtures("x64")


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    return build_problem(physics, (), fixed=["A", "C"])


def response(u: np.ndarray) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -0.8], u, axis=-1))


def recorded(problem: Problem, n_seq: int, gain_at: list[float]) -> tuple[Signals, np.ndarray]:
    """The response to an input of unit gain, too; gain_at: one gain per quarter of a sequence, or of all sequences."""
    draw = np.random.default_rng(0)
    u, noise = draw.standard_normal((2, n_seq, 400))
    gain = np.repeat(gain_at, n_seq // 4)[:, None] if n_seq >= 4 else np.repeat(gain_at, 100)
    y = gain * response(u) + 0.1 * noise
    return weighted_signals(problem, small_record(u[..., None], y[..., None]), folds=2, block=20), response(u)


def with_gain(problem: Problem, gain: float, n_seq: int) -> Guess:
    theta = problem.theta.copy()
    theta[[slot.label for slot in problem.slots].index("B[1][1]")] = gain
    return Guess((), theta, np.zeros((n_seq, 1)))


@pytest.mark.parametrize("n_seq", [1, 2, 8])
@pytest.mark.parametrize("gain_at", [[1.2] * 4, [1.2, 1.2, 1.2, 0.8]], ids=["right", "changing"])
def test_as_least_squares_without_each_quarter(problem, n_seq, gain_at):
    signals, r = recorded(problem, n_seq, gain_at)
    y = signals.y[..., 0]
    # with few sequences a quarter is one of the record put end to end, sequence after sequence
    quarter = np.repeat(np.arange(4), n_seq * 400 // 4).reshape(n_seq, 400)

    def gain(keep: np.ndarray) -> float:
        return (r * y)[keep].sum() / (r**2)[keep].sum()

    whole = gain(np.ones_like(quarter, bool))
    left = sum((((y - gain(quarter != q) * r) ** 2)[quarter == q]).sum() for q in range(4))
    expected = np.sqrt(left / ((y - whole * r) ** 2).sum())
    found = optimism(problem, signals, with_gain(problem, whole, n_seq), SETTINGS)
    assert found == pytest.approx(expected, rel=1e-6)
    assert (found > 1.05) == (gain_at[-1] != 1.2)  # with one number of 400 it is hardly above 1


def test_nothing_is_said_where_the_fit_has_no_errors(problem):
    signals, _ = recorded(problem, 1, [1.2] * 4)
    exact = signals._replace(
        weight=np.ones_like(signals.weight), y=np.zeros_like(signals.y), u=np.zeros_like(signals.u)
    )
    assert optimism(problem, exact, with_gain(problem, 1.2, 1), SETTINGS) is None
