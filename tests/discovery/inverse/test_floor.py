"""What the filter of the positions takes away from the torques."""

import jax
import numpy as np
import pytest
from arm_logs import DT, KUKA, log

from pgrssnn_jax.discovery.inverse.evidence import fastest_of, samples_of, torques
from pgrssnn_jax.discovery.inverse.floor import filtered_away
from pgrssnn_jax.discovery.inverse.reading import Reading
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.physics.arms.build import arm

pytestmark = pytest.mark.usefixtures("x64")
CUTOFF, RATE = 2.0, 1.6  # Hz
PASSED = 1.0 / (1.0 + (np.tan(np.pi * RATE * DT) / np.tan(np.pi * CUTOFF * DT)) ** 8)  # forwards and backwards


@pytest.fixture(scope="module")
def model():
    with jax.enable_x64(True):
        return torques(build_problem(arm(derivatives="forward", gravity=tuple(KUKA.gravity)), (), accelerate=False))


def test_a_sine_loses_as_much_of_what_was_passed_as_it_has_lost(model):
    """F (1 - F) of a small motion, whose torques are linear in it."""
    theta, time = model.problem.theta, DT * np.arange(1, 301)[None, :, None]
    phases = np.arange(KUKA.n)
    record = log(0, torque_noise=0.0, noise=0.0)
    wave = 0.5 + 0.01 * np.sin(2.0 * np.pi * RATE * time + phases)
    record = record._replace(u=np.zeros(wave.shape), y=wave, mask=np.ones(wave.shape, bool))
    reading = Reading(DT, CUTOFF, 1.0, at_rest=False, edge=25)
    filtered, whole = (one.of(record) for one in (reading, reading._replace(cutoff=1.0 / DT)))
    first, true = (samples_of(one, fastest_of(whole)) for one in (filtered, whole))
    inside = first.moving & true.moving & (np.abs(np.arange(first.v.shape[1]) - 125) < 90)
    lost = np.where(inside, model.errors(theta, true) - model.errors(theta, first), 0.0)
    expected = PASSED * np.sqrt((lost**2).sum(1) / inside.sum(1))
    found = np.sqrt(filtered_away(model, reading, record, filtered, theta))
    np.testing.assert_allclose(found, expected, rtol=0.05)
    assert (filtered_away(model, reading._replace(cutoff=1.0 / DT), record, whole, theta) == 0.0).all()
