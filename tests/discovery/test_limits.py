"""Limits that the record asks for stay; those that an effect brings for other channels and sides go."""

import jax
import numpy as np
import pytest
from discovery.by_hand import screening
from toys import small_record

from pgrssnn_jax.discovery.candidates import fitted_models
from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.limits import without_idle_limits
from pgrssnn_jax.discovery.problem import Problem, build_problem, weighted_signals
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm

NAME, NOISE, INFINITE = "sensor_saturation", 0.05, np.inf


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.9, 0.0], [0.0, 0.7]], B=[[0.3], [0.6]], C=np.eye(2), inputs=["u0"], outputs=["y0", "y1"])
    effects = [one for one in catalogue(physics) if one.name == NAME]
    return build_problem(physics, effects, fixed=["A", "B", "C"], accelerate=False)


def left(
    problem: Problem, low: list[float], high: list[float], gap: float = 0.0, pulse: float = 0.0
) -> dict[str, np.ndarray]:
    """Limits that stay of four that a fit brought; low, high: those of the sensors that wrote the record; gap: of the
    physics without the effect, in noises; pulse: of the input, for ten samples within a block."""
    draw = np.random.default_rng(2)
    u, x, y = draw.standard_normal((640, 1)), np.zeros(2), []
    u[289:299] += pulse
    for (held,) in u:
        x = np.array([0.9 * x[0] + 0.3 * held, 0.7 * x[1] + 0.6 * held])
        y.append(np.clip(x, low, high) + NOISE * draw.standard_normal(2))
    record = small_record(u, np.array(y))
    with jax.enable_x64(True):
        signals, settings, criteria = weighted_signals(problem, record, folds=5, block=32), Settings(), Criteria()
        ends = {"low": record.y[0].min(0), "high": record.y[0].max(0)}
        theta = problem.put(problem.theta, NAME, ends)
        ((fitted, _),) = fit_all(problem, signals, [Guess((NAME,), theta, np.zeros((1, 2)))], settings)
        (model,) = fitted_models(problem, signals, [fitted], settings, criteria.block)
        beside = screening(model, {})._replace(size=signals.size)
        errors = model.estimate.error
        first = model._replace(estimate=model.estimate._replace(error=errors * (1.0 + gap)))
        noise = model.estimate.cost / signals.size if gap else 1e6
        before = screening(first, {})._replace(size=signals.size)
        selection = Selection(first, model, {}, before, beside, noise)
        found = without_idle_limits(problem, signals, selection, settings, criteria)
    assert found.last.base is found.final
    return problem.params(found.final.estimate.theta).effects[NAME]


def test_the_limit_of_one_output_is_all_that_stays(problem):
    found = left(problem, [-INFINITE, -INFINITE], [0.6, INFINITE])
    assert found["high"][0] == pytest.approx(0.6, abs=0.01)
    assert np.isposinf(found["high"][1])
    assert np.isneginf(found["low"]).all()


def test_limits_of_both_sides_and_outputs_stay_where_they_are(problem):
    low, high = [-0.6, -1.0], [0.5, 0.9]
    found = left(problem, low, high)
    np.testing.assert_allclose(found["low"], low, atol=0.02)
    np.testing.assert_allclose(found["high"], high, atol=0.02)


def test_the_last_limit_of_an_effect_is_not_taken_away(problem):
    """Whether it belongs there has been decided before."""
    found = left(problem, [-INFINITE, -INFINITE], [INFINITE, INFINITE])
    assert sum(np.isfinite(value).sum() for value in found.values()) == 1


@pytest.mark.parametrize(("gap", "stays"), [(3.0, True), (0.0, False)])
def test_a_limit_that_one_part_of_the_record_reaches_stays_where_it_closes_a_share_of_the_gap(problem, gap, stays):
    """Without that part nothing is known of it, so it predicts no part better."""
    found = left(problem, [-0.6, -INFINITE], [3.0, INFINITE], gap, pulse=3.0)
    assert found["low"][0] == pytest.approx(-0.6, abs=0.02)
    assert np.isfinite(found["high"][0]) == stays
