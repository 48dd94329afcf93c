"""Fewer numbers are preferred where the data do not decide, and only there."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.estimate import Estimate, Guess, Validated
from pgrssnn_jax.discovery.look import Candidate, Rules, Stage, _best_of_each
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.search import _chosen, _Judge
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.tanks import cascaded_tanks

SAMPLES = 640
NOISE = np.random.default_rng(0).standard_normal((1, SAMPLES, 1))
RICH, LEAN = "pump_nonlinearity", "outlet_exponent"  # two numbers, and one that pump_nonlinearity does not contain


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = cascaded_tanks()
    return build_problem(physics, [e for e in catalogue(physics) if e.name in (RICH, LEAN, "sensor_saturation")])


def saturated(problem: Problem, **ends: float) -> Guess:
    numbers = {"low": np.array([-np.inf]), "high": np.array([np.inf])} | {k: np.array([v]) for k, v in ends.items()}
    theta = problem.put(problem.theta, "sensor_saturation", numbers)
    return Guess(("sensor_saturation",), theta, np.zeros((1, 2)))


@pytest.mark.parametrize(("with_both", "kept"), [(0.95, 1), (0.85, 2)])
def test_a_second_end_of_a_range_must_bring_a_visible_fall(problem, with_both, kept):
    fitted = [(saturated(problem, low=1.0, high=8.0), with_both), (saturated(problem, high=8.0), 1.0)]
    for order in (fitted, fitted[::-1]):
        guess, cost = _best_of_each(problem, order, Rules())["sensor_saturation"]
        assert np.isfinite(guess.theta[problem.of("sensor_saturation")]).sum() == kept
        assert cost == (1.0 if kept == 1 else with_both)


def test_the_better_of_two_starts_is_kept_and_one_that_failed_is_none(problem):
    fitted = [
        (saturated(problem, high=8.0), np.inf),
        (saturated(problem, high=7.0), 0.7),
        (saturated(problem, high=6.0), 0.6),
    ]
    assert _best_of_each(problem, fitted, Rules())["sensor_saturation"][1] == 0.6
    assert _best_of_each(problem, fitted[:1], Rules()) == {}


def candidate(problem: Problem, name: str, error: np.ndarray) -> Candidate:
    guess = Guess((name,), problem.theta, np.zeros((1, 2)))
    estimate = Estimate((name,), problem.theta, guess.x0, error)
    return Candidate(name, 0.9, Validated(estimate, error, problem.theta[None]), guess)


def chosen(problem: Problem, rich: np.ndarray, lean: np.ndarray) -> str:
    """Which of the two enters, from errors in blocks left out; the physics alone has ten times the noise."""
    base = candidate(problem, "", 10.0 * NOISE).validated
    assert base is not None
    candidates = sorted((candidate(problem, RICH, rich), candidate(problem, LEAN, lean)), key=lambda c: c.cost)
    stage = Stage(base, tuple(candidates), np.zeros(400), {}, SAMPLES, 1.0)
    judge = _Judge(problem, lambda guess: stage, lambda guess: stage, base.cost, float((NOISE**2).sum()), Rules(), None)
    found = _chosen(judge, stage)
    assert found is not None
    return found.name


def test_of_two_that_do_as_well_the_one_with_fewer_numbers_enters(problem):
    other = NOISE + 0.05 * np.random.default_rng(1).standard_normal(NOISE.shape)
    assert chosen(problem, rich=NOISE, lean=other) == LEAN


def test_the_one_with_more_numbers_enters_where_it_is_better(problem):
    assert chosen(problem, rich=NOISE, lean=1.2 * NOISE) == RICH


def test_few_wild_blocks_do_not_hide_a_large_difference(problem):
    """A difference of that size is no tie, however uncertain a few blocks make it."""
    wild = NOISE.copy()
    wild[:, :32] *= 8.0
    assert chosen(problem, rich=NOISE, lean=wild) == RICH


def test_the_better_one_enters_where_it_has_fewer_numbers(problem):
    assert chosen(problem, rich=1.2 * NOISE, lean=NOISE) == LEAN
