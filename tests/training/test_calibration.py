"""Intervals of a physics that discovery has fitted to the record."""

import numpy as np
import pytest
from discovery.small_cases import pump, tank_record

import pgrssnn_jax as pg
from pgrssnn_jax.physics.tanks import cascaded_tanks


@pytest.mark.compiles
def test_they_are_as_much_wider_as_the_physics_over_fits_its_record():
    record = tank_record(pump(200, 1))
    width = {}
    for optimism in (1.0, 3.0):
        physics = cascaded_tanks(integrator="rk4")._replace(discovered=True, optimism=optimism)
        ensemble = pg.fit("physics_only", physics, record, recipe="default", initial_state="first_output", quiet=True)
        found = ensemble.simulate(record.u, np.array([4.0, 4.0]), interval=0.9)
        width[optimism] = np.asarray(found.high) - np.asarray(found.low)
    np.testing.assert_allclose(width[3.0], 3.0 * width[1.0], rtol=1e-5)
