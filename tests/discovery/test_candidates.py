"""One screening of a small catalogue beside a linear model, with numbers that are known."""

import jax
import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.candidates import Screening, score_candidates
from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.problem import Problem, build_problem, weighted_signals
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm

SAMPLES, OFFSET, NOISE = 300, 0.1, 0.1
NAMES = ("sensor_offset", "input_gain", "input_dead_zone")


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    return build_problem(physics, [e for e in catalogue(physics) if e.name in NAMES], fixed=["C"])


def screened(problem: Problem, offset: float, seed: int = 0, without: tuple[str, ...] = ()) -> Screening:
    draw = np.random.default_rng(seed)
    u, x, y = draw.standard_normal((SAMPLES, 1)), 0.0, []
    for (v,) in u:
        x = 0.8 * x + v
        y.append([x + offset + NOISE * draw.standard_normal()])
    signals = weighted_signals(problem, small_record(u, np.array(y)), folds=3, block=20)
    start = Guess((), problem.theta, signals.start)
    settings, criteria = Settings(spare=3, lanes=3, steps=8), Criteria(draws=199, block=20)
    with jax.enable_x64(True):
        return score_candidates(problem, signals, start, settings, criteria, np.random.default_rng(1), without)


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


def test_effects_may_be_left_out_of_a_screening(problem):
    found = screened(problem, OFFSET, without=NAMES[:1])
    assert "sensor_offset" not in {candidate.name for candidate in found.candidates}


def test_beside_everything_there_is_nothing_left_to_try(problem):
    assert screened(problem, 0.0, without=NAMES).candidates == ()
