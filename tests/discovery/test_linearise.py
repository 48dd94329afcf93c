"""What of an effect the free numbers of a physics cannot take up, and free runs that leave the range."""

import jax
import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.candidates import fitted_models
from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.likelihood import Linearisation
from pgrssnn_jax.discovery.linearise import visible
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.physics.linear import lgssm


def test_an_effect_is_redundant_if_each_of_its_numbers_is():
    """Two outputs whose common gain is a number of the physics."""
    first, second = np.zeros((2, 1, 50, 2))
    first[..., 0], second[..., 1] = np.random.default_rng(0).standard_normal((2, 1, 50))
    both = (first + second)[..., None]
    zero = np.zeros(1)
    at = Linearisation(np.zeros(first.shape), both, np.ones(first.shape, bool), zero, zero)
    together, one, other = (a.reshape(-1) for a in (both, first, second))
    effects = [("common", np.stack([together, together], 1)), ("of each", np.stack([together, one, other], 1))]
    found = visible(at, effects)
    energy = (together**2).sum()
    assert found["common"] == (pytest.approx(energy), pytest.approx(0.0, abs=1e-20 * energy))
    moved, left = found["of each"]
    assert moved == pytest.approx(energy)
    shares = [(a**2).sum() / energy for a in (one, other)]
    assert left == pytest.approx(energy * (1.0 - min(shares)))  # of a gain that the common one does not contain


def test_a_run_that_leaves_the_range_predicts_worse_than_any_other():
    """Its errors counted as none, and a model that an optimiser had lost was the best one: a linear system in which an
    offset was hidden (899002) ended in an error."""
    draw = np.random.default_rng(0)
    problem = build_problem(lgssm(A=[[0.9]], B=[[0.5]], C=[[1.0]], inputs=["u0"], outputs=["y0"]), [])
    record = small_record(draw.standard_normal((120, 1)), draw.standard_normal((120, 1)))
    lost = problem.theta.copy()
    lost[next(i for i, slot in enumerate(problem.slots) if slot.label.startswith("A"))] = 1e150
    with jax.enable_x64(True):
        signals = weighted_signals(problem, record, folds=3, block=20)
        guesses = [Guess((), theta, signals.start) for theta in (problem.theta, lost)]
        near, far = fitted_models(problem, signals, guesses, Settings(), 20)
    assert np.isfinite(far.blocks).all()
    assert near.better_than(far)[0] > 1e3
