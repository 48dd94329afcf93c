"""One screening of a small catalogue beside a linear model, with numbers that are known."""

import jax
import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.candidates import (
    Candidate,
    Screening,
    fitted_models,
    moved,
    score_candidates,
    settled,
)
from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm

SAMPLES, OFFSET, NOISE = 300, 0.1, 0.1
NAMES = ("sensor_offset", "input_gain", "input_dead_zone")


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    return build_problem(physics, [e for e in catalogue(physics) if e.name in NAMES], fixed=["C"])


SETTINGS, CRITERIA = Settings(spare=3, lanes=3, steps=8), Criteria(draws=199, block=20)


def recorded(problem: Problem, offset: float, seed: int = 0, swing: float = 0.0) -> Signals:
    """swing: of a slow disturbance of the sensor."""
    draw = np.random.default_rng(seed)
    u, x, y = draw.standard_normal((SAMPLES, 1)), 0.0, []
    for (v,) in u:
        x = 0.8 * x + v
        y.append([x + offset + swing * np.sin(0.05 * len(y)) + NOISE * draw.standard_normal()])
    return weighted_signals(problem, small_record(u, np.array(y)), folds=3, block=20)


def screened(
    problem: Problem, offset: float, seed: int = 0, without: tuple[str, ...] = (), swing: float = 0.0
) -> Screening:
    signals = recorded(problem, offset, seed, swing)
    start = Guess((), problem.theta, signals.start)
    with jax.enable_x64(True):
        return score_candidates(problem, signals, start, SETTINGS, CRITERIA, np.random.default_rng(1), without)


def test_the_hidden_effect_is_the_best_and_its_number_within_its_interval(problem):
    found = screened(problem, OFFSET)
    assert {candidate.name for candidate in found.candidates} == set(NAMES)
    best = found.candidates[0]
    assert best.name == "sensor_offset"
    assert found.p_value(best) <= 0.01
    assert best.model is not None
    better, error = best.model.better_than(found.base)
    assert better > 5.0 * error
    (place,) = problem.of("sensor_offset")
    deviation = best.model.deviation[place]
    assert deviation == pytest.approx(NOISE / np.sqrt(SAMPLES), rel=0.2)
    assert abs(best.model.estimate.theta[place] - OFFSET) < 3.0 * deviation
    fall = best.model.estimate.cost / found.base.estimate.cost
    assert best.gain == pytest.approx(-0.5 * SAMPLES * np.log(fall), rel=1e-3)
    assert found.rms(best.model) == pytest.approx(found.noise**0.5, rel=0.1)


def test_nothing_beats_luck_in_noise_and_what_a_matrix_does_is_redundant(problem):
    found = screened(problem, 0.0)
    assert min(found.p_value(candidate) for candidate in found.candidates) > 0.01
    assert not any(candidate.model for candidate in found.candidates), "none is worth a fit to its end"
    assert found.redundant("input_gain")
    assert not found.redundant("sensor_offset")


def test_where_errors_are_clear_effects_are_fitted_to_their_end_whatever_a_few_steps_promise(problem):
    """Beside slow errors, what a few steps gain may look like luck, and the optimum not: a saturation in a disturbed
    servo axis gains 786 nats by a few steps and 2975 in the end."""
    found = screened(problem, 0.0, swing=2.0)
    assert found.rms() > CRITERIA.clear * found.noise**0.5
    assert min(found.p_value(candidate) for candidate in found.candidates) > CRITERIA.hopeless
    assert all(candidate.model for candidate in found.candidates)


def test_effects_may_be_left_out_of_a_screening(problem):
    found = screened(problem, OFFSET, without=NAMES[:1])
    assert "sensor_offset" not in {candidate.name for candidate in found.candidates}


def test_beside_everything_there_is_nothing_left_to_try(problem):
    assert screened(problem, 0.0, without=NAMES).candidates == ()


def test_finalists_that_were_left_on_their_way_come_to_their_optimum(problem):
    whole, signals = screened(problem, OFFSET), recorded(problem, OFFSET)

    def on_its_way(candidate: Candidate) -> Candidate:
        guess, places = candidate.guess, problem.of(candidate.name)
        half = guess._replace(theta=moved(guess.theta, places, 0.5 * (guess.theta[places] + problem.theta[places])))
        (model,) = fitted_models(problem, signals, [half], SETTINGS, CRITERIA.block)
        return Candidate(candidate.name, -np.inf, half, model)

    with jax.enable_x64(True):
        begun = whole._replace(candidates=tuple(map(on_its_way, whole.candidates)))
        done = settled(problem, signals, begun, SETTINGS, CRITERIA)
    for after, expected in zip(done.candidates, whole.candidates, strict=True):
        assert after.name == expected.name
        assert after.gain == pytest.approx(expected.gain, rel=0.01, abs=1e-3)
        assert after.score == pytest.approx(expected.score, abs=0.01)
