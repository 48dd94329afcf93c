"""Which channels of an offset of the inputs are kept: of systems in which two inputs do the same, and do not."""

import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.candidates import Model, fitted_models
from pgrssnn_jax.discovery.channels import with_fewest_channels
from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm

SAMPLES, NAME = 400, "input_offset"
CRITERIA = Criteria(block=20)
SETTINGS = Settings(spare=2, lanes=1, steps=60, tolerance=1e-12)
ALIKE = [[1.0, 2.0], [0.5, 1.0]]  # the second input is twice the first
APART = [[1.0, 0.2], [0.1, 1.0]]

pytestmark = pytest.mark.usefixtures("x64")


def built(gains: list[list[float]]) -> Problem:
    physics = lgssm(
        A=[[0.8, 0.0], [0.0, 0.5]], B=gains, C=np.eye(2).tolist(), inputs=["u1", "u2"], outputs=["y1", "y2"]
    )
    (offset,) = [effect for effect in catalogue(physics) if effect.name == NAME]
    return build_problem(physics, [offset], fixed=["A", "B", "C"])


def recorded(problem: Problem, offset: list[float]) -> Signals:
    """Simulated step by step in NumPy, with noise of size 0.1."""
    draw = np.random.default_rng(0)
    u, a, b = draw.standard_normal((SAMPLES, 2)), np.array([0.8, 0.5]), problem.params(problem.theta).own["B"]
    x, y = np.zeros(2), []
    for now in u:
        x = a * x + b @ (now + offset)
        y.append(x)
    return weighted_signals(
        problem, small_record(u, np.array(y) + 0.1 * draw.standard_normal((SAMPLES, 2))), folds=4, block=20
    )


def fewest(gains: list[list[float]], offset: list[float]) -> tuple[np.ndarray, list[int], list[Model]]:
    """The offsets found, the channels that are kept, and the models with another one."""
    problem = built(gains)
    signals = recorded(problem, offset)
    begun = Guess((NAME,), problem.put(problem.theta, NAME, {"offset": np.array([0.1, 0.1])}), signals.start)
    ((guess, _),) = fit_all(problem, signals, [begun], SETTINGS)
    (model,) = fitted_models(problem, signals, [guess], SETTINGS, CRITERIA.block)
    smaller, found, elsewhere = with_fewest_channels(problem, signals, model, SETTINGS, CRITERIA)
    places = problem.of(NAME)
    return (
        found.estimate.theta[places],
        np.flatnonzero(np.isin(places, smaller.of(NAME))).tolist(),
        elsewhere.get(NAME, []),
    )


def test_of_inputs_that_do_the_same_one_is_kept_with_what_both_do():
    offset, kept, (other,) = fewest(ALIKE, [0.3, 0.2])
    assert len(kept) == 1
    assert offset[1 - kept[0]] == 0.0
    assert offset @ [1.0, 2.0] == pytest.approx(0.7, abs=0.02)
    swapped = other.estimate.theta[built(ALIKE).of(NAME)]
    assert swapped[kept[0]] == 0.0
    assert swapped @ [1.0, 2.0] == pytest.approx(0.7, abs=0.02), "the other input would do"


def test_of_inputs_that_act_apart_those_are_kept_that_have_an_offset():
    offset, kept, elsewhere = fewest(APART, [0.3, 0.0])
    assert kept == [0]
    assert not elsewhere
    assert offset == pytest.approx([0.3, 0.0], abs=0.02)
    offset, kept, _ = fewest(APART, [0.3, -0.2])
    assert kept == [0, 1]
    assert offset == pytest.approx([0.3, -0.2], abs=0.02)


def test_one_channel_stays_even_where_none_does_anything():
    """Whether an effect is there at all was judged before."""
    _, kept, _ = fewest(APART, [0.0, 0.0])
    assert len(kept) == 1
