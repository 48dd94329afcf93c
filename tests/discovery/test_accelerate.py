"""Without the tricks of `pgrssnn_jax.acceleration` a discovery finds the same, to the last digits but a few."""

import jax
import numpy as np
import pytest
from discovery.small_cases import choices, fine_tanks, pump, tank_record

from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.workflow import Discovery, discover_in
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.slow
TRUE = {"k1": 0.049, "k2": 0.0003, "k3": 0.043, "k4": 0.056, "k5": 0.0039}
NAMES = ("overflow_lost", "pump_saturation")


def discovered(accelerate: bool) -> Discovery:
    physics = cascaded_tanks(integrator="rk4")
    effects = [effect for effect in catalogue(physics) if effect.name in NAMES]
    problem = build_problem(physics, effects, accelerate=accelerate)
    u, v = pump(260, 7, high=5.0), pump(160, 8, high=5.0)
    rim = float(np.quantile(fine_tanks(u, k=TRUE, sub=4)[:, 0, 0], 0.75))
    train, test = (tank_record(w, seed=i, k=TRUE, rim=rim) for i, w in enumerate((u, v)))
    settings = choices(accelerate=accelerate)
    with jax.enable_x64(True):
        return discover_in(problem, train, test, settings, lambda line: None, start=Start.SHARED)


def test_names_and_numbers_are_equal_with_and_without_acceleration():
    quick, plain = discovered(True), discovered(False)
    assert quick.problem.code.written_out is not None
    assert plain.problem.code.written_out is None
    assert quick.found.final.estimate.active == plain.found.final.estimate.active == ("overflow_lost",)
    assert quick.judged.verdict is plain.judged.verdict
    assert [c.name for c in quick.found.first.candidates] == [c.name for c in plain.found.first.candidates]
    np.testing.assert_allclose(quick.found.final.estimate.theta, plain.found.final.estimate.theta, rtol=1e-6)
    np.testing.assert_allclose(quick.found.recalibrated.cost, plain.found.recalibrated.cost, rtol=1e-6)
    np.testing.assert_allclose(quick.test.after.error, plain.test.after.error, rtol=1e-6)
