"""Candidates ranked by linear steps on segments: a cart that meets an unknown drag."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate
from pgrssnn_jax.discovery.linear import score_linearised, segment_model
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.stretches import stretches
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.records.record import Channel, RecordInfo, record

DT, DRAG, NOISE = 0.1, 0.6, 0.003


def cart(drag: float = 0.0):
    def step(p, x, u):
        return jnp.stack([x[0] + DT * x[1], x[1] + DT * (p["gain"] * u[0] - drag * x[1])])

    states = (Signal("position", "m", like="place"), Signal("speed", "m/s", rate_of="place"))
    return discrete("cart", step, lambda p, x, u: x[:1], {"gain": 1.0}, states=states, inputs=(Signal("push", "N"),),
                    outputs=(Signal("place", "m"),), dt=DT, output_timing="after_step")  # fmt: skip


@pytest.fixture(scope="module")
def segments():
    draw = np.random.default_rng(0)
    u = np.repeat(draw.standard_normal((6, 20)), 6, 1)[..., None]
    physics = cart(DRAG)
    x, y = np.zeros((6, 2)), np.zeros((6, 120, 1))
    for t in range(120):
        x = np.array([physics.step(physics.params, one, push) for one, push in zip(x, u[:, t], strict=True)])
        y[:, t] = x[:, :1]
    info = RecordInfo((Channel("push", "N"),), (Channel("place", "m"),), DT, "simulated")
    problem = build_problem(cart(), catalogue(cart()), fixed=["gain"])
    whole = record(u, y + NOISE * draw.standard_normal(y.shape), info)
    few, uncut = (stretches(problem, whole, length, folds=3, at_rest=True) for length in (40, 120))
    return problem, few, uncut


def scored(segments, least: float):
    problem, few, uncut = segments
    settings = Settings(spare=6, lanes=1, steps=12, tolerance=1e-3)
    criteria, rng = Criteria(), np.random.default_rng(0)
    with jax.enable_x64(True):
        return score_linearised(
            problem, few, Guess((), problem.theta, few.start), settings, criteria, rng, (), whole=uncut, least=least
        )


def test_the_effect_that_is_missing_comes_first_and_is_fitted(segments):
    screening = scored(segments, 0.02)
    best = screening.candidates[0]
    assert best.name == "viscous_friction"
    assert best.model is not None
    assert screening.p_value(best) < 0.01


def test_what_promises_too_little_is_not_fitted(segments):
    assert all(candidate.model is None for candidate in scored(segments, 0.99).candidates)


def test_a_model_of_segments_has_the_errors_of_its_run(segments):
    problem, few, uncut = segments
    guess = Guess((), problem.theta, few.start)
    with jax.enable_x64(True):
        model = segment_model(problem, few, guess, uncut)
        np.testing.assert_allclose(model.estimate.error, evaluate(problem, few, guess).error, atol=1e-9)
