"""Linear least squares within bounds, against scipy."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from pgrssnn_jax.discovery.bounded import scaled_steps, step_within


@pytest.mark.parametrize("seed", range(8))
def test_a_step_within_bounds_is_that_of_scipy(seed):
    draw = np.random.default_rng(seed)
    columns, error = draw.standard_normal((40, 5)), draw.standard_normal(40)
    low, high = -draw.uniform(0.0, 0.1, 5), draw.uniform(0.0, 0.1, 5)
    low[0], high[1] = -np.inf, np.inf
    found = step_within(columns.T @ columns, columns.T @ error, low, high)
    best = lsq_linear(columns, error, (low - 1e-12, high + 1e-12)).x
    assert np.all((found >= low - 1e-12) & (found <= high + 1e-12))

    def cost(step: np.ndarray) -> float:
        return float(((error - columns @ step) ** 2).sum())

    # numbers that were put at their bounds stay there, so the optimum may be missed, but not by much
    assert cost(found) <= cost(best) * 1.02
    assert cost(found) <= cost(np.zeros(5))


def test_without_bounds_it_is_least_squares():
    draw = np.random.default_rng(0)
    columns, error = draw.standard_normal((30, 4)), draw.standard_normal(30)
    found = step_within(columns.T @ columns, columns.T @ error, np.full(4, -np.inf), np.full(4, np.inf))
    np.testing.assert_allclose(found, np.linalg.lstsq(columns, error, rcond=None)[0], rtol=1e-6)


def test_a_column_of_nothing_moves_nothing():
    normal, pull = np.diag([2.0, 0.0]), np.array([1.0, 0.0])
    np.testing.assert_allclose(
        step_within(normal, pull, np.full(2, -np.inf), np.full(2, np.inf)), [0.5, 0.0], atol=1e-6
    )


def test_many_steps_without_bounds_are_those_of_each():
    draw = np.random.default_rng(1)
    columns = draw.standard_normal((30, 4)) * [1e-6, 1.0, 1e3, 1e6]
    normal, pull = columns.T @ columns, draw.standard_normal((7, 30)) @ columns
    np.testing.assert_allclose(scaled_steps(normal, pull) @ normal, pull, rtol=1e-6)
