"""Numbers that are known by a prior: fits against SciPy with what was given as further residuals."""

from dataclasses import replace

import numpy as np
import pytest
from discovery.small_cases import pump, tank_record
from scipy.optimize import least_squares

from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.least_squares import Lanes, fit, simulate
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

TRUE = {"k1": 0.05, "k2": 0.0009, "k3": 0.043, "k4": 0.056, "k5": 0.0039}
NAMES = ("k1", "k2", "k3", "k4", "k5")


pytestmark = pytest.mark.usefixtures("x64")


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = cascaded_tanks(integrator="rk4")
    return build_problem(physics, [e for e in catalogue(physics) if e.name == "sensor_gain"])


@pytest.fixture(scope="module")
def record(problem: Problem) -> Signals:
    return weighted_signals(problem, tank_record(pump(240, 1), noise=0.05, k=TRUE), folds=3, block=20)


def own(problem: Problem) -> np.ndarray:
    return np.array([i for name in NAMES for i, slot in enumerate(problem.slots) if slot.label == name])


def fitted(problem: Problem, record: Signals) -> tuple[np.ndarray, np.ndarray, float]:
    lanes = Lanes(problem.theta[None], record.start[None], own(problem)[None])
    found = fit(problem, record, lanes, steps=60)
    return found.theta[0], found.x0[0], float(found.cost[0])


def noise(record: Signals) -> float:
    return float((0.05 * record.weight.max()) ** 2)


def test_scipy_finds_no_better_fit_with_what_was_given_as_further_residuals(problem, record):
    held = problem.held(0.2, noise(record))
    theta, x0, cost = fitted(held, record)
    places = own(held)
    deviation = 0.2 * np.abs(problem.theta[places])

    def residual(z):
        moved = problem.theta.copy()
        moved[places] = z[:5]
        y, _ = simulate(problem, record.u, moved[None], z[None, None, 5:])
        given = noise(record) ** 0.5 * (z[:5] - problem.theta[places]) / deviation
        return np.concatenate([(record.weight * (record.y - y[0])).ravel(), given])

    begin = np.concatenate([problem.theta[places], record.start[0]])
    other = least_squares(residual, begin, x_scale=np.abs(begin), xtol=1e-13, ftol=1e-13, gtol=1e-13)
    mine = residual(np.concatenate([theta[places], x0[0]]))
    assert mine @ mine == pytest.approx(2 * other.cost, rel=1e-6)
    assert cost == pytest.approx(mine @ mine, rel=1e-4)
    np.testing.assert_allclose(theta[places], other.x[:5], rtol=2e-3)
    assert held.penalty(theta) == pytest.approx(float((mine[-5:] ** 2).sum()), rel=1e-9)


def test_nothing_moves_without_tolerance_and_everything_with_much(problem, record):
    stiff, *_ = fitted(problem.held(1e-6, noise(record)), record)
    np.testing.assert_allclose(stiff, problem.theta, rtol=1e-4)
    loose, *_ = fitted(problem.held(1e6, noise(record)), record)
    free, *_ = fitted(problem, record)
    np.testing.assert_allclose(loose, free, rtol=1e-4)
    between, *_ = fitted(problem.held(0.5, noise(record)), record)
    k2 = own(problem)[1]
    assert problem.theta[k2] < between[k2] < max(free[k2], TRUE["k2"]) or free[k2] < between[k2] < problem.theta[k2]


def test_effects_and_zeros_are_not_held_and_a_matrix_is_by_its_largest_entry():
    physics = lgssm(A=[[0.9, 0.0], [0.1, 0.6]], B=[[1.0], [0.0]], C=[[0.0, 2.0]])
    problem = build_problem(physics, catalogue(physics)[:3]).held(0.1, 4.0)
    precision = {slot.label: p for slot, p in zip(problem.slots, problem.precision, strict=True)}
    for label in ("A[1][1]", "A[1][2]", "A[2][2]"):
        assert precision[label] == pytest.approx(4.0 / (0.1 * 0.9) ** 2)
    assert precision["C[1][1]"] == pytest.approx(4.0 / (0.1 * 2.0) ** 2)
    effects = [i for i, slot in enumerate(problem.slots) if slot.effect is not None]
    assert effects
    assert not problem.precision[effects].any()
    nothing = replace(problem, theta=np.zeros(len(problem.theta))).held(0.1, 4.0)
    assert not nothing.precision.any()
    assert not problem.with_numbers(physics.params).precision.any(), "other numbers are not known yet"


def test_what_is_fixed_stays_fixed_beside_corrections_without_a_name():
    physics = lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]])
    held, free = (Corrected().by_all(build_problem(physics, (), fixed=f, accelerate=False), []) for f in (["B"], []))
    assert {held.slots[i].path[0] for i in held.of(None)} == {"A", "C"}
    assert {free.slots[i].path[0] for i in free.of(None)} == {"A", "B", "C"}
