"""Carriers per cubic metre or moles: the unit of a state, and of the numbers beside it, changes no answer."""

from typing import NamedTuple

import jax
import numpy as np
import pytest
from scipy.signal import lfilter
from toys import small_record

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate, fit_all
from pgrssnn_jax.discovery.finding import at_bound
from pgrssnn_jax.discovery.follows import errors_follow
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.discovery.responses import path_of
from pgrssnn_jax.discovery.smoother import smoothed_correction

DT, RATE, START, GAIN = 0.5, 0.4, 3.0, 0.8
UNITS = [1e-24, 1e24]


class Case(NamedTuple):
    problem: Problem
    signals: Signals
    guess: Guess


def case(unit: float) -> Case:
    """dx/dt = -r x + b u, y = c x from an unknown start; b is 20 % too large, and a curve of u is missing."""
    physics = pg.continuous(
        "pool",
        lambda p, x, u: -p["r"] * x + p["b"] * u,
        lambda p, x, u: p["c"] * x,
        {"r": RATE, "b": 1.2 * GAIN * unit, "c": 1.0 / unit},
        dt=DT,
        states=(pg.Signal("amount"),),
        inputs=(pg.Signal("u0"),),
        outputs=(pg.Signal("y0"),),
    )
    draw = np.random.default_rng(0)
    u, kept = draw.standard_normal(200), np.exp(-RATE * DT)
    driven = (1.0 - kept) / RATE * GAIN * (u + 0.3 * u**2)
    x = lfilter([1.0], [1.0, -kept], driven) + START * kept ** np.arange(1, 201)
    y = x + 0.02 * draw.standard_normal(200)
    problem = build_problem(physics, [], fixed=["c"])
    signals = weighted_signals(problem, small_record(u[:, None], y[:, None]), folds=3, block=20)
    return Case(problem, signals, Guess((), problem.theta, signals.start))


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def fitted(one: Case) -> Guess:
    ((found, _),) = fit_all(one.problem, one.signals, [one.guess], Settings(lanes=1))
    return found


@pytest.mark.parametrize("unit", UNITS)
def test_starts_and_numbers_are_fitted(unit):
    plain, scaled = (fitted(case(one)) for one in (1.0, unit))
    np.testing.assert_allclose(plain.x0, [[START]], atol=1.0)  # the missing curve bends it
    np.testing.assert_allclose(scaled.x0 / unit, plain.x0, rtol=1e-3)
    slots = case(unit).problem.slots
    size = [{"b": unit, "c": 1.0 / unit, "r": 1.0}[slot.label] for slot in slots]
    np.testing.assert_allclose(scaled.theta / size, plain.theta, rtol=1e-3)


@pytest.mark.parametrize("unit", UNITS)
def test_corrections_and_what_errors_follow_are_the_same(unit):
    found = []
    for one in (case(1.0), case(unit)):
        problem, signals, guess = one
        estimate = evaluate(problem, signals, guess)
        correction = smoothed_correction(problem, signals, path_of(problem, signals, guess), estimate.error, 0.02)
        found.append((correction, errors_follow(problem, signals, estimate, np.random.default_rng(1))))
    (plain, follows), (scaled, followed) = found
    np.testing.assert_allclose(scaled.mean / unit, plain.mean, rtol=1e-3, atol=1e-3 * np.abs(plain.mean).max())
    np.testing.assert_allclose(scaled.likelihood, plain.likelihood, rtol=1e-3)
    assert followed.share == pytest.approx(follows.share, rel=1e-3)
    assert followed.p_value == follows.p_value


def test_a_small_number_near_its_bound_is_not_at_it():
    assert not at_bound(np.array(1.2e-12), (5e-13, 1e-11), None)
    assert at_bound(np.array(5e-13), (5e-13, 1e-11), None)
    assert at_bound(np.array(0.0), (0.0, 1.0), None)
