"""Without the tricks of `pgrssnn_jax.acceleration` a discovery finds the same, to the last digits but a few."""

import numpy as np
import pytest
from discovery.small_cases import choices, discovered, fine_tanks, pump, tank_record

from pgrssnn_jax.discovery.discover import Discovery
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.slow
TRUE = {"k1": 0.049, "k2": 0.0003, "k3": 0.043, "k4": 0.056, "k5": 0.0039}
NAMES = ("overflow_lost", "pump_saturation")


def found(accelerate: bool) -> Discovery:
    physics = cascaded_tanks(integrator="rk4")
    effects = [effect for effect in catalogue(physics) if effect.name in NAMES]
    problem = build_problem(physics, effects, accelerate=accelerate)
    u, v = pump(260, 7, high=5.0), pump(160, 8, high=5.0)
    rim = float(np.quantile(fine_tanks(u, k=TRUE, sub=4)[:, 0, 0], 0.75))
    train, test = (tank_record(w, seed=i, k=TRUE, rim=rim) for i, w in enumerate((u, v)))
    return discovered(problem, train, test, choices(accelerate=accelerate))


def test_names_and_numbers_are_equal_with_and_without_acceleration():
    quick, plain = found(True), found(False)
    assert quick.problem.code.written_out is not None
    assert plain.problem.code.written_out is None
    ours, theirs = quick.selection, plain.selection
    assert ours.final.estimate.active == theirs.final.estimate.active == ("overflow_lost",)
    assert quick.judgement.verdict is plain.judgement.verdict
    assert [c.name for c in ours.first.candidates] == [c.name for c in theirs.first.candidates]
    np.testing.assert_allclose(ours.final.estimate.theta, theirs.final.estimate.theta, rtol=1e-6)
    np.testing.assert_allclose(ours.recalibrated.estimate.cost, theirs.recalibrated.estimate.cost, rtol=1e-6)
    np.testing.assert_allclose(quick.test.after.error, plain.test.after.error, rtol=1e-6)
