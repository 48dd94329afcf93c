"""A curve in the equation of a linear system, which the test record has too, or has not."""

import jax
import numpy as np
import pytest
from discovery.small_cases import choices, setup_of
from toys import small_record

from pgrssnn_jax.discovery.candidates import fitted_models
from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.correction_on_test import improvement_by_correction
from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.nonparametric import Corrections, score_corrections
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.record import Record

SETTINGS = Settings(spare=10, lanes=2, steps=12)


def bent(size: float, seed: int) -> Record:
    """x' = 0.8 x + u + size sin 2x"""
    draw, x, y = np.random.default_rng(seed), 0.0, []
    u = draw.uniform(-1.0, 1.0, (200, 1))
    for (v,) in u:
        x = 0.8 * x + v + size * np.sin(2.0 * x)
        y.append([x + 0.02 * draw.standard_normal()])
    return small_record(u, np.array(y))


@pytest.mark.parametrize("there", [True, False])
def test_a_correction_helps_on_the_test_record_where_what_it_stands_for_is_there_too(there):
    physics = lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    problem, train, test = build_problem(physics, [], fixed=["B", "C"]), bent(0.1, 1), bent(0.1 * there, 2)
    setup, criteria = setup_of(problem, train, test, choices()), Criteria(draws=199, block=20)
    with jax.enable_x64(True):

        def signals(one):
            return weighted_signals(one, setup.estimation, folds=3, block=20)

        nominal = Guess((), problem.theta, signals(problem).start)
        (base,) = fitted_models(problem, signals(problem), [nominal], SETTINGS, 20)
        corrections = Corrections(problem, Corrected(), (), lambda same: same, signals, SETTINGS)
        found = score_corrections(corrections, base, criteria, 0.0, np.random.default_rng(0))
        best = found.candidates[0]
        assert best.name == "x1 by x1"
        low, high = improvement_by_correction(corrections, best, nominal, nominal, setup)
    assert low > 0.0 if there else high < 0.0
