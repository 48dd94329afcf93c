"""Which beginnings a search follows, and which effects are none: looks at the catalogue made by hand."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.estimate import Estimate, Guess, Validated
from pgrssnn_jax.discovery.look import Candidate, Rules, Stage
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.search import search
from pgrssnn_jax.discovery.unknown import flexible_problem
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm

SAMPLES = 640
NOISE = np.random.default_rng(0).standard_normal((1, SAMPLES, 1))
INPUT, OUTPUT, DAMPING, GAIN = "input_offset", "sensor_offset", "quadratic_damping", "input_gain"


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]])
    return build_problem(physics, [e for e in catalogue(physics) if e.name in (INPUT, OUTPUT, DAMPING, GAIN)])


def found(problem: Problem, energies: dict[frozenset[str], float], visible=None, unfinished=None) -> set[str]:
    """energies: of the errors with these effects, in units of the noise's; of others, that of nothing; unfinished: the
    same for candidates whose fit has not come to its end."""

    def model(active: tuple[str, ...], those: dict[frozenset[str], float]) -> Validated:
        error = NOISE * those.get(frozenset(active), energies[frozenset()]) ** 0.5
        return Validated(Estimate(active, problem.theta, np.zeros((1, 2)), error), error, problem.theta[None])

    def examine(guess: Guess) -> Stage:
        base = model(guess.active, energies)
        candidates = []
        for effect in problem.effects:
            if effect.name not in guess.active:
                more = model((*guess.active, effect.name), energies | (unfinished or {}))
                candidates.append(Candidate(effect.name, 1.0 - more.cost / base.cost, more, more.guess))
        candidates.sort(key=lambda c: c.cost)
        return Stage(base, tuple(candidates), np.zeros(400), visible or {}, SAMPLES, float((NOISE**2).mean()))

    start = Guess((), problem.theta, np.zeros((1, 2)))
    return set(search(problem, start, Rules(), lambda line: None, examine).final.estimate.active)


TIED = {frozenset(): 400.0, frozenset({INPUT}): 1.2, frozenset({OUTPUT}): 1.2, frozenset({OUTPUT, DAMPING}): 1.0}


def test_what_did_as_well_as_the_first_is_followed_too(problem):
    """Alone, an offset at the input is one at the output; beside what bends it is not."""
    assert found(problem, TIED) == {OUTPUT, DAMPING}


def test_a_single_hypothesis_may_be_right():
    physics = lgssm(A=[[0.7]], B=[[1.0]], C=[[1.0]])
    alone = build_problem(physics, [e for e in catalogue(physics) if e.name == DAMPING])
    assert found(alone, {frozenset(): 400.0, frozenset({DAMPING}): 1.0}) == {DAMPING}


def test_what_did_worse_at_the_beginning_is_left_once_the_gap_is_closed(problem):
    worse = TIED | {frozenset({OUTPUT}): 4.0}
    assert found(problem, worse) == {INPUT}
    assert found(problem, worse | {frozenset({INPUT}): 3.9}) == {OUTPUT, DAMPING}, "the gap is open"


def test_what_did_worse_only_because_its_fit_had_not_ended_is_taken_up(problem):
    energies = {frozenset(): 400.0, frozenset({INPUT}): 1.5, frozenset({OUTPUT}): 1.0}
    assert found(problem, energies, unfinished={frozenset({OUTPUT}): 2.0}) == {OUTPUT}
    assert found(problem, energies | {frozenset({OUTPUT}): 1.48}, unfinished={frozenset({OUTPUT}): 2.0}) == {INPUT}


def test_three_effects_are_not_believed_before_fewer_were_tried(problem):
    three = {frozenset({INPUT}): 50.0, frozenset({INPUT, GAIN}): 9.0, frozenset({INPUT, GAIN, DAMPING}): 1.1}
    two = {frozenset({OUTPUT}): 70.0, frozenset({OUTPUT, GAIN}): 1.0}
    assert found(problem, {frozenset(): 400.0} | three) == {INPUT, GAIN, DAMPING}
    assert found(problem, {frozenset(): 400.0} | three | two) == {OUTPUT, GAIN}


def test_what_the_parameters_can_do_exactly_is_no_effect(problem):
    energies = {frozenset(): 4.0, frozenset({GAIN}): 1.0, frozenset({DAMPING}): 1.5}
    visible = dict.fromkeys((INPUT, OUTPUT, DAMPING), (100.0, 50.0))
    assert found(problem, energies, visible | {GAIN: (100.0, 50.0)}) == {GAIN}
    assert found(problem, energies, visible | {GAIN: (100.0, 1e-25)}) == {DAMPING}


def test_what_is_fixed_stays_fixed_beside_corrections_without_a_name(problem):
    held = build_problem(problem.physics, problem.effects, fixed=["B"])
    wide = flexible_problem(held)
    assert {wide.slots[i].path[0] for i in wide.of(None)} == {"A", "C"}
    assert {wide.slots[i].path[0] for i in flexible_problem(problem).of(None)} == {"A", "B", "C"}
