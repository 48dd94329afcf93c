"""Fits to many short sequences with a start each: the same numbers as SciPy, whatever one sequence does."""

import jax
import numpy as np
import pytest
from discovery.small_cases import pump, tank_record
from scipy.optimize import least_squares

from pgrssnn_jax.discovery.least_squares import Lanes, fit, simulate
from pgrssnn_jax.discovery.problem import Signals, build_problem
from pgrssnn_jax.physics.tanks import cascaded_tanks

TRUE = {"k1": 0.05, "k2": 0.0003, "k3": 0.043, "k4": 0.056, "k5": 0.0039}
LENGTH = 40


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def pieces(noise: float) -> Signals:
    whole = tank_record(pump(5 * LENGTH, 4), noise=noise, k=TRUE)
    u, y = (np.asarray(a, np.float64).reshape(5, LENGTH, 1) for a in (whole.u, whole.y))
    start = np.stack([[y[max(s - 1, 0), -1 if s else 0, 0]] * 2 for s in range(5)])
    return Signals(u, y, np.ones_like(y), np.zeros((5, LENGTH), int), start, np.full((5, 2), 1e-2))


def test_numbers_and_starts_are_those_of_scipy():
    problem, record = build_problem(cascaded_tanks(integrator="rk4"), []), pieces(0.05)
    free = [i for i, slot in enumerate(problem.slots) if slot.label in ("k1", "k3", "k4")]
    lanes = Lanes(problem.theta[None], record.start[None], np.array([free]))
    found = fit(problem, record, lanes, steps=60)

    def residual(z):
        theta, x0 = problem.theta.copy(), z[3:].reshape(5, 2)
        theta[free] = z[:3]
        y, _ = simulate(problem, record.u, theta[None], x0[None])
        return np.concatenate([(record.y - y[0]).ravel(), 0.1 * (x0 - record.start).ravel()])

    best = least_squares(residual, np.concatenate([problem.theta[free], record.start.ravel()]), xtol=1e-12)
    np.testing.assert_allclose(found.cost[0], 2.0 * best.cost, rtol=1e-3)
    np.testing.assert_allclose(found.theta[0, free], best.x[:3], rtol=2e-2)


def test_a_sequence_that_cannot_be_fitted_does_not_hold_back_the_others():
    """One sequence's levels are those of another plant, far from where its start can bring it."""
    problem, record = build_problem(cascaded_tanks(integrator="rk4"), []), pieces(0.0)
    y, weight = record.y.copy(), record.weight.copy()
    y[2], weight[2] = 30.0 - 5.0 * y[2], 1e-3
    free = [i for i, slot in enumerate(problem.slots) if slot.label in ("k1", "k3", "k4")]
    lanes = Lanes(problem.theta[None], record.start[None], np.array([free]))
    found = fit(problem, record._replace(y=y, weight=weight), lanes, steps=60)
    alone, _ = simulate(problem, record.u, found.theta, found.x0)
    others = [0, 1, 3, 4]
    assert np.sqrt(np.mean((record.y - alone[0])[others] ** 2)) < 0.02
