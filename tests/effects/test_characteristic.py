"""The curved sensor against SciPy's cubic Hermite spline, and what it may stand for."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from toys import toy_physics

from pgrssnn_jax.effects import add_effect
from pgrssnn_jax.effects.base import Effect, SignalRange
from pgrssnn_jax.effects.characteristic import POINTS, sensor_nonlinearity
from pgrssnn_jax.physics.base import Physics

pytestmark = pytest.mark.usefixtures("x64")
LOW, HIGH = np.array([-1.0, 2.0]), np.array([3.0, 4.0])


def two_outputs() -> Physics:
    physics = toy_physics()
    outputs = tuple(physics.outputs[0]._replace(name=name) for name in ("a", "b"))
    return physics._replace(outputs=outputs, measure=lambda p, x, u: u[0] * jnp.array([1.0, -1.0]))


def read(physics: Physics, values: np.ndarray) -> np.ndarray:
    """Readings `[time, 2]` where the first output is `values`, the second its negative."""
    x = jnp.zeros(len(physics.states))
    return np.array([physics.measure(physics.params, x, jnp.array([v])) for v in values])


def deviations(function: Callable[[np.ndarray], np.ndarray], j: int) -> np.ndarray:
    return function(np.linspace(LOW[j], HIGH[j], POINTS))


def curved(c: Any) -> Physics:
    return add_effect(two_outputs(), sensor_nonlinearity(two_outputs()), deviation=c, low=LOW, high=HIGH)


def test_the_curve_is_that_of_a_hermite_spline():
    c = np.random.default_rng(0).standard_normal((2, POINTS))
    values = np.linspace(-5.0, 5.0, 301)
    found = read(curved(c), values) - read(two_outputs(), values)
    for j, sign in enumerate((1.0, -1.0)):
        knots, step = np.linspace(LOW[j], HIGH[j], POINTS), (HIGH[j] - LOW[j]) / (POINTS - 1)
        more = np.concatenate([[3 * c[j, 0] - 3 * c[j, 1] + c[j, 2]], c[j], [3 * c[j, -1] - 3 * c[j, -2] + c[j, -3]]])
        spline = scipy.interpolate.CubicHermiteSpline(knots, c[j], (more[2:] - more[:-2]) / (2 * step))
        at, end = sign * values, np.clip(sign * values, LOW[j], HIGH[j])
        np.testing.assert_allclose(found[:, j], spline(end) + spline(end, 1) * (at - end), atol=1e-12)


def test_a_parabola_is_met_between_the_points_too():
    c = np.stack([deviations(lambda v: 0.3 - 0.2 * v + 0.05 * v**2, 0), np.zeros(POINTS)])
    values = np.linspace(LOW[0], HIGH[0], 101)
    found = read(curved(c), values)
    np.testing.assert_allclose(found[:, 0] - values, 0.3 - 0.2 * values + 0.05 * values**2, atol=1e-12)
    np.testing.assert_array_equal(found[:, 1], -values)


def test_fits_begin_bowed_over_the_range_of_every_output():
    none = np.zeros((2, 1))
    span = SignalRange(none, none, np.array([[-2.0, 5.0], [6.0, 5.0]]))  # the second does not move
    for start in sensor_nonlinearity(two_outputs()).guesses(span):
        np.testing.assert_array_equal(start["low"], [-2.0, 5.0])
        assert np.all(start["high"] > start["low"])
        assert 0.03 * 8.0 < np.abs(start["deviation"][0]).max() < 0.06 * 8.0


def believed(effect: Effect, deviation: np.ndarray) -> bool:
    none = np.zeros((2, 1))
    assert effect.credible is not None
    return effect.credible({"deviation": deviation, "low": LOW, "high": HIGH}, SignalRange(none, none, none))


def test_no_reading_is_wrong_by_more_than_its_range():
    """A point that no sample is near may lie anywhere."""
    effect, part = sensor_nonlinearity(two_outputs()), np.linspace(0.0, 1.0, POINTS)
    for share, expected in ((0.3, True), (1e6, False)):
        deviation = np.stack([4.0 * share * (HIGH[0] - LOW[0]) * part * (1.0 - part), 0.0 * part])
        assert believed(effect, deviation) is expected


def test_a_straight_line_is_an_offset_or_a_gain():
    effect, part = sensor_nonlinearity(two_outputs()), np.linspace(0.0, 1.0, POINTS)
    straight = np.stack([0.7 + 0.0 * part, 0.3 - 0.5 * part])
    assert not believed(effect, straight)
    assert not believed(effect, straight + 0.01 * (-1.0) ** np.arange(POINTS))
    assert believed(effect, straight + np.stack([0.0 * part, part * (1.0 - part)]))
