"""Effects that were hidden in simulated records are named, and nothing is named where nothing is missing."""

from functools import partial

import jax
import numpy as np
import pytest
from discovery.small_cases import choices, fine_tanks, pump, tank_record

from pgrssnn_jax.discovery.estimate import Settings, fit_all
from pgrssnn_jax.discovery.look import look_at
from pgrssnn_jax.discovery.problem import build_problem, weighted_signals
from pgrssnn_jax.discovery.prove import fitted_nominal
from pgrssnn_jax.discovery.search import search
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.discovery.workflow import discover_in
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import linear
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record

TRUE = {"k1": 0.049, "k2": 0.0003, "k3": 0.043, "k4": 0.056, "k5": 0.0039}


def test_hidden_effects_of_tanks_are_named_and_nothing_else():
    """One program serves all three records."""
    settings, rules = Settings(lanes=16, steps=15), choices().rules
    physics = cascaded_tanks(integrator="rk4")
    names = ("overflow_1to2", "overflow_lost", "pump_saturation")
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name in names])
    u = pump(400, 7, high=5.0)
    rim = float(np.quantile(fine_tanks(u, k=TRUE, sub=4)[:, 0, 0], 0.75))
    cases = (
        ({"rim": rim, "share": 0.8}, "overflow_1to2", {"level": rim}),
        ({"most": 3.5}, "pump_saturation", {"voltage": 3.5}),
        ({}, None, {}),
    )
    for hidden, name, numbers in cases:
        with jax.enable_x64(True):
            data = weighted_signals(problem, tank_record(u, k=TRUE, **hidden), folds=3, block=20)
            start = fitted_nominal(problem, data, settings)
            examine = partial(
                look_at, problem, data, settings=settings, rules=rules, rng=np.random.default_rng(0), without=()
            )
            found = search(problem, start, rules, lambda line: None, examine)
        assert found.final.estimate.active == (() if name is None else (name,))
        if name is None:
            assert found.recalibrated.cost < 1.5 * found.floor
            with jax.enable_x64(True):
                assert_a_look_comes_back_from_a_stray_start(problem, data, start, settings, examine)
            continue
        assert found.first.candidates[0].name == name
        assert found.final.cost < 0.05 * found.recalibrated.cost
        assert found.final.cost < 1.5 * found.floor
        params = problem.params(found.final.estimate.theta)
        for key, value in numbers.items():
            assert float(params.effects[name][key]) == pytest.approx(value, rel=0.03)
        assert float(params.own["k1"]) == pytest.approx(TRUE["k1"], rel=0.05)


def assert_a_look_comes_back_from_a_stray_start(problem, data, start, settings, examine):
    """A start or a parameter far off, as an effect that is taken out again may leave them."""
    slow = start.theta.copy()
    slow[problem.of(None)[0]] *= 0.1
    level = found_by(problem, data, start, settings)
    for astray in (start._replace(x0=start.x0 + np.array([[200.0, 0.0]])), start._replace(theta=slow)):
        assert found_by(problem, data, astray, settings) > 10.0 * level
        assert examine(astray).base.estimate.cost < 1.1 * level


def found_by(problem, data, guess, settings):
    ((_, cost),) = fit_all(problem, data, [guess], settings)
    return cost


A, B, C = np.array([[0.6, 0.7], [-0.1, 0.0]]), np.array([-1.1, 0.0]), np.array([0.9, -0.1])
LGSSM = RecordInfo((Channel("u"),), (Channel("y"),), 1.0, "simulated")


def linear_record(samples: int, seed: int, damping: float = 0.0) -> Record:
    draw = np.random.default_rng(seed)
    u, x, y = 2.0 * draw.standard_normal((samples, 1)), np.zeros(2), []
    for (v,) in u:
        x = A @ x + B * v - damping * np.abs(x) * x
        y.append([C @ x + 0.02 * draw.standard_normal()])
    return record(u, np.array(y), LGSSM)


def test_what_the_catalogue_lacks_is_not_called_nothing():
    """Quadratic damping hidden: named with it; without it in the catalogue still no `no_discrepancy`."""
    physics = linear(A=A, B=B[:, None], C=C[None])
    names = ("quadratic_damping", "sensor_offset")
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name in names])

    def verdict(damping, **changes):
        train, test = (linear_record(n, seed, damping) for n, seed in ((320, 1), (160, 2)))
        with jax.enable_x64(True):
            return discover_in(problem, train, test, choices(**changes), lambda line: None, start=Start.SHARED)

    nothing = verdict(0.0)
    assert nothing.judged.verdict is Verdict.NO_DISCREPANCY
    assert nothing.found.final.estimate.active == ()
    named = verdict(0.06)
    assert named.judged.verdict is Verdict.EFFECT_FOUND
    assert named.found.final.estimate.active == ("quadratic_damping",)
    assert named.test.after.error < 0.3 * named.test.recalibrated.error
    assert named.test.after.error < named.without["quadratic_damping"].error
    removed = verdict(0.06, without=["quadratic_damping"])
    assert removed.judged.verdict is Verdict.UNKNOWN_EFFECT
    assert "quadratic_damping" not in {c.name for c in removed.found.first.candidates}
    assert removed.formula is not None
    assert removed.formula.target.startswith("x")
