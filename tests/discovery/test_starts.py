"""How many samples of a record its start needs: what its error adds to the noise, by Monte Carlo in plain NumPy."""

import jax
import numpy as np
import pytest
from scipy.signal import lfilter
from toys import small_record

from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.starts import samples_for_start
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.record import Record

SAMPLES, LEAST = 1200, 25
INTEGRATING = np.array([[1.0, 0.1], [0.0, 1.0]])
FORGETTING = np.array([[0.8, 0.1], [0.0, 0.7]])


def built(step: np.ndarray, unit: float = 1.0) -> Problem:
    """unit: of the second state."""
    size = np.diag([1.0, unit])
    inverse = np.linalg.inv(size)
    physics = lgssm(
        A=size @ step @ inverse, B=size @ [[0.0], [0.1]], C=[[1.0, 0.0]], inputs=["force"], outputs=["place"]
    )
    return build_problem(physics, [], fixed=["A", "B", "C"])


def recorded(mask: np.ndarray | None = None) -> Record:
    draw = np.random.default_rng(3)
    u, y = draw.standard_normal((SAMPLES, 1)), draw.standard_normal((SAMPLES, 1))
    return small_record(u, y if mask is None else np.where(mask, y, np.nan), mask=mask)


def needed(step: np.ndarray, unit: float = 1.0, record: Record | None = None, memory: float = 1.0) -> int:
    problem, record = built(step, unit), recorded() if record is None else record
    x0 = np.zeros((1, 2))
    with jax.enable_x64(True):
        return samples_for_start(problem, record, Guess((), problem.theta, x0), x0, LEAST, memory)


def added(step: np.ndarray, n: int, pole: float = 0.0, draws: int = 400) -> float:
    """Mean squared error of later samples, over the variance of the noise, by starts fitted to the first n samples."""
    rows = np.stack([np.linalg.matrix_power(step, t + 1)[0] for t in range(SAMPLES)])
    white = np.random.default_rng(4).standard_normal((n + 500, draws))
    noise = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], white, axis=0)[500:]
    start = np.linalg.lstsq(rows[:n], noise, rcond=None)[0]
    return float(((rows[n:] @ start) ** 2).mean())


def test_an_integrating_plant_gets_the_samples_that_its_start_needs():
    n = needed(INTEGRATING)
    assert LEAST < n < SAMPLES / 2
    assert added(INTEGRATING, n) < 0.11
    assert added(INTEGRATING, n // 2) > 0.1


def test_noise_with_a_memory_asks_for_more():
    memory = (1.0 + 0.8) / (1.0 - 0.8)  # correlation time at a pole of 0.8
    n = needed(INTEGRATING, memory=memory)
    assert needed(INTEGRATING) < n <= SAMPLES / 2
    assert added(INTEGRATING, n // 2, pole=0.8) > 0.1


def test_a_plant_that_forgets_its_start_keeps_the_least_number():
    assert added(FORGETTING, LEAST) < 0.01
    assert needed(FORGETTING) == LEAST


def test_half_of_the_record_is_the_most():
    drifting = np.array([[1.0, 0.1], [0.0, 1.005]])  # unstable
    assert needed(drifting) == SAMPLES // 2


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_a_state_changes_nothing(unit):
    assert needed(INTEGRATING, unit) == needed(INTEGRATING)


def test_samples_that_were_not_measured_say_nothing_of_a_start():
    mask = np.ones((SAMPLES, 1), bool)
    mask[: needed(INTEGRATING)] = np.arange(needed(INTEGRATING))[:, None] % 8 == 0
    assert needed(INTEGRATING, record=recorded(mask)) > needed(INTEGRATING)
