"""Corrections are found beside numbers of the physics that have bent in their place."""

import jax
import numpy as np
from discovery.test_stand_ins import NOISE, axis, pushed

from pgrssnn_jax.discovery.candidates import fitted_models
from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.nonparametric import Corrections, score_corrections
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.discovery.settings import Criteria

SETTINGS = Settings(lanes=2)
FAR = np.array([20.0, 20.0])  # mass and damping at their bounds; from here alone a curve of the force ends at 13 noises


def test_a_constant_force_is_a_curve_of_the_force_though_mass_and_damping_are_far_off():
    record = pushed(4, 0.1)
    record = record._replace(u=record.u[:, :400], y=record.y[:, :400], mask=record.mask[:, :400])
    problem, criteria = build_problem(axis(), []), Criteria(draws=199, block=20)
    with jax.enable_x64(True):

        def signals(one):
            return weighted_signals(one, record, folds=5, block=20)

        (base,) = fitted_models(problem, signals(problem), [Guess((), FAR, signals(problem).start)], SETTINGS, 20)
        corrections = Corrections(problem, Corrected(), (), lambda same: same, signals, SETTINGS)
        found = score_corrections(corrections, base, criteria, 0.0, np.random.default_rng(0))
    fitted = {one.name: found.rms(one.model) * record.y.std() for one in found.candidates if one.model}
    assert fitted["speed by force"] < 1.1 * NOISE
