"""Every effect of the catalogues, hidden in a record from an independent simulator, is the best of one screening."""

from functools import cache

import jax
import numpy as np
import pytest

from benchmarks.hidden import pendulum, suite
from benchmarks.hidden.suite import Plan
from pgrssnn_jax.discovery.candidates import Screening, score_candidates
from pgrssnn_jax.discovery.estimate import Settings
from pgrssnn_jax.discovery.problem import Problem, build_problem, weighted_signals
from pgrssnn_jax.discovery.recalibrate import nominal_guess, recalibrated_guess
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.effects.generic import generic_effects
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

SYSTEMS = ("tanks", "pendulum", "lgssm")
QUIET = {"tanks": 0.005, "pendulum": 0.002, "lgssm": 0.05}
PERIODIC = {"periodic_disturbance", "periodic_sensor_error"}  # hidden in other systems
EFFECTS = [(system, name) for system in SYSTEMS for name in suite.catalogue(system).acts_on]


def physics_of(case):
    if case.system == "tanks":
        return cascaded_tanks(**case.physics, integrator="rk4")
    return lgssm(**case.physics) if case.system == "lgssm" else pendulum.pendulum(**case.physics)


@cache
def shared(system: str) -> Problem:
    """One program per system: cases differ in numbers."""
    physics = physics_of(suite.build(Plan(system, 0, "none", (), (), QUIET[system])))
    return build_problem(physics, catalogue(physics), fixed=["B"] if system == "lgssm" else [])


def recorded_otherwise(case, name):
    """A record without effects as an instrument with this one would have written it."""
    train = case.train
    if name == "sensor_gain":
        return train._replace(y=1.15 * train.y)
    return train._replace(u=train.u / 1.2)


def screened(case, record) -> Screening:
    problem = shared(case.system).with_numbers(physics_of(case).params)
    settings, chosen = Settings(devices=jax.device_count()), DiscoverySettings(draws=199, starts=1)
    with jax.enable_x64(True):
        data = weighted_signals(problem, record, folds=5, block=32)
        start = recalibrated_guess(problem, data, nominal_guess(problem, data, settings), settings, chosen)
        rng = np.random.default_rng(0)
        return score_candidates(problem, data, start, settings, chosen.criteria, rng, without=())


@pytest.mark.slow
@pytest.mark.parametrize(("system", "name"), EFFECTS)
def test_no_other_effect_does_better_than_the_hidden_one(system, name):
    case = suite.build(Plan(system, 5, "single", (name,), (), QUIET[system]))
    assert_best(screened(case, case.train), case.accepted[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sensor_gain", "input_gain"])
def test_no_other_effect_does_better_than_that_of_an_instrument(name):
    case = suite.build(Plan("pendulum", 5, "none", (), (), QUIET["pendulum"]))
    assert_best(screened(case, recorded_otherwise(case, name)), (name,))


def assert_best(screening: Screening, names) -> None:
    """A parameter at its bound leaves a gain as much to do as the effect itself, and no more."""
    best, own = screening.candidates[0], next(c for c in screening.candidates if c.name in names)
    assert best.model is not None
    assert own.model is not None
    assert own.model.estimate.cost <= 1.01 * best.model.estimate.cost
    assert screening.p_value(own) <= 0.01
    assert own.model.better_than(screening.base)[0] > 0.0


def test_the_start_of_a_lag_is_found_and_that_of_a_delay_is_the_input():
    code = shared("pendulum").code
    free = {state.name: bool(f) for state, f in zip(code.full.states, code.free_start, strict=True)}
    assert {name for name, f in free.items() if f} == {
        "angle",
        "rate",
        "torque_lagged",
        "torque_behind_play",
        "rate_yielding",
        "torque_phase",
        "angle_phase",
    }
    assert any(name.startswith("torque_delayed") for name in free)


def test_no_effect_of_tanks_and_pendulums_is_left_out():
    """Linear models have no others; arms and the effects of any states are tested on their own."""
    hidden = {name for system in SYSTEMS for name in suite.catalogue(system).acts_on}
    for physics in (cascaded_tanks(), pendulum.pendulum()):
        known = {effect.name for effect in catalogue(physics)}
        known -= {effect.name for effect in generic_effects(physics)}
        assert known - hidden - PERIODIC == {"sensor_gain", "input_gain"}
