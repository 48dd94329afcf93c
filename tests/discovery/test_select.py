"""Which effects are taken, dropped and exchanged, and which beginnings are followed: screenings made by hand."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from discovery.by_hand import LIKELY, NOISE, SAMPLES, model, neutral, screening

from pgrssnn_jax.discovery.candidates import Screening
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.select import (
    Judge,
    _with_fewest_effects,
    _with_known,
    preferred_model,
    remembered,
    select,
)
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

A, B, C = "input_offset", "sensor_offset", "quadratic_damping"
RICH, LEAN = "pump_nonlinearity", "outlet_exponent"  # two numbers, and one that pump_nonlinearity does not contain


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]])
    return build_problem(physics, [e for e in catalogue(physics) if e.name in (A, B, C)], accelerate=False)


@pytest.fixture(scope="module")
def tanks() -> Problem:
    physics = cascaded_tanks()
    return build_problem(physics, [e for e in catalogue(physics) if e.name in (RICH, LEAN)], accelerate=False)


def found(problem: Problem, energies: Mapping[str, float], p_value: Mapping[str, float] | None = None, **seen) -> str:
    """energies: of the errors with the effects in "A B", in units of the noise's; a set that is not given does as well
    as the best within it. p_value: of "A beside B C". Names are the letters above."""
    letters = {"A": A, "B": B, "C": C}
    given = {frozenset(letters[k] for k in names.split()): energy for names, energy in energies.items()}

    def energy(active) -> float:
        return min(e for names, e in given.items() if names <= set(active))

    def screen(base) -> Screening:
        active = base.active if isinstance(base, Guess) else base.estimate.active
        own = model(problem, energy(active), active)
        others = [name for name in (A, B, C) if name not in active]
        beside = " ".join(k for k, name in letters.items() if name in active)
        chances = {letters[k.split()[0]]: p for k, p in (p_value or {}).items() if k[2:] == f"beside {beside}".strip()}
        models = {name: model(problem, energy((*active, name)), (*active, name)) for name in others}
        return screening(own, models, {k: p for k, p in chances.items() if k in models}, **seen)

    screened = remembered(screen, {}, lambda line: None)
    selection = select(problem, neutral(problem), Criteria(), screened)
    assert set(selection.screenings) == set(selection.final.estimate.active)
    assert selection._replace(noise=0.04).floor == pytest.approx(0.2)  # a deviation of a variance
    return " ".join(k for k, name in letters.items() if name in selection.final.estimate.active)


def test_nothing_is_found_in_noise(problem):
    assert found(problem, {"": 1.0}) == ""


def test_a_pair_is_found(problem):
    assert found(problem, {"": 400.0, "A": 100.0, "B": 200.0, "A B": 1.0}) == "A B"


def test_a_pair_of_which_neither_does_best_alone_is_found(problem):
    """Alone, an offset at the input is one at the output; beside what bends it is not."""
    assert found(problem, {"": 400.0, "A": 3.0, "B": 4.0, "B C": 1.0}) == "B C"


def test_a_pair_of_which_neither_is_certain_alone_is_found_where_each_is_beside_the_other(problem):
    """What one of them leaves looks like noise with a memory, until the other is there."""
    alone = {"A beside": 0.3, "B beside": 0.4, "C beside": 0.9}
    assert found(problem, {"": 400.0, "A": 100.0, "B": 200.0, "A B": 1.0}, alone) == "A B"
    assert found(problem, {"": 400.0, "A": 100.0, "B": 200.0, "A B": 1.0}, alone | {"B beside A": 0.1}) == ""
    assert found(problem, {"": 400.0, "A": 100.0, "B": 200.0, "A B": 1.0}, alone | {"A beside B": 0.1}) == ""
    assert found(problem, {"": 3.9, "A": 2.0, "B": 2.0, "A B": 1.0}, alone) == "", "errors below twice the noise"


@pytest.mark.parametrize(("energy", "names"), [(1.0, (C,)), (1.2, (A, B))])
def test_one_effect_is_taken_in_the_place_of_two_that_predict_no_better(problem, energy, names):
    """A linear leak and an offset have the place of a power law, because the leak alone comes near to it."""
    first = screening(model(problem, 400.0), {A: model(problem, 1.4, (A,)), C: model(problem, energy, (C,))})
    judge = Judge(problem, Criteria(), gap=19.0, noise=1.0)
    assert _with_fewest_effects(judge, first, model(problem, 1.0, (A, B))).estimate.active == names


@pytest.mark.parametrize(
    ("names", "others", "gain", "expected"),
    [
        ((A, B), (A,), 0.5, False),
        ((A, B), (A,), 2.0, True),
        ((A,), (A, B), -0.5, True),
        ((A,), (A, B), -2.0, False),
        ((A,), (B,), 0.5, True),
        ((A,), (B,), 0.01, False),
    ],
)
def test_more_effects_must_make_the_record_likelier(problem, names, others, gain, expected):
    """gain: nats. Two effects that say the same as a third fit a trifle better."""
    one, other = model(problem, np.exp(-2.0 * gain / SAMPLES), names), model(problem, 1.0, others)
    assert preferred_model(one, other, alike=1.0) is expected


def test_an_effect_that_brings_little_is_not_taken(problem):
    assert found(problem, {"": 400.0, "A": 100.0, "A B": 98.0}) == "A"


def test_what_came_in_first_leaves_when_it_brings_nothing_any_more(problem):
    assert found(problem, {"": 400.0, "A": 50.0, "B": 60.0, "C": 70.0, "B C": 1.0}) == "B C"


@pytest.mark.parametrize(("p_value", "expected"), [(1e-4, "B"), (LIKELY, "")])
def test_an_effect_alone_must_be_certain_wherever_the_search_began(problem, p_value, expected):
    assert found(problem, {"": 400.0, "B": 100.0}, {"B beside": p_value}) == expected


def test_a_survivor_that_came_in_as_a_partner_is_judged_alone_again(problem):
    """B was enough beside A; A is not needed beside B, and B alone is not certain, A is."""
    energies = {"": 400.0, "A": 100.0, "B": 20.0}
    assert found(problem, energies, {"B beside": LIKELY, "B beside A": LIKELY}) == "A"
    assert found(problem, energies) == "B"


def test_a_partner_of_an_effect_that_is_certain_needs_less(problem):
    energies = {"": 400.0, "A": 100.0, "A B": 20.0}
    assert found(problem, energies, {"B beside A": LIKELY}) == "A B"
    assert found(problem, energies, {"B beside A": 0.1}) == "A"


def test_every_further_effect_is_paid_for(problem):
    """The probabilities of luck add up: two that are likely enough alone are too much together."""
    energies = {"": 400.0, "A": 100.0, "A B": 20.0, "A B C": 5.0}
    assert found(problem, energies, {"B beside A": LIKELY}) == "A B C"
    assert found(problem, energies, {"B beside A": LIKELY, "C beside A B": LIKELY}) == "A B"


@pytest.mark.parametrize(("error", "enters"), [(NOISE, True), (NOISE[:, ::-1], False)])
def test_an_effect_that_closes_the_rest_must_predict_better_with_certainty(tanks, error, enters):
    """From 1.1 to 1.0 times the noise, where the physics alone has 20 times; errors in another order say less."""
    base = model(tanks, 1.21, (LEAN,))
    candidates = screening(base, {RICH: model(tanks, 1.0, (LEAN, RICH), error)})
    assert (Judge(tanks, Criteria(), gap=19.0, noise=1.0).best(candidates, {}) is not None) == enters


@pytest.mark.parametrize(("gap", "enters"), [(19.0, True), (100.0, False)])
def test_what_the_law_of_another_effect_may_have_missed_gets_no_name(tanks, gap, enters):
    """Laws are sampled: an error of a thousandth of what they close is theirs."""
    candidates = screening(model(tanks, 1.21, (LEAN,)), {RICH: model(tanks, 1.0, (LEAN, RICH), NOISE)})
    assert (Judge(tanks, Criteria(), gap=gap, noise=1.0).best(candidates, {}) is not None) == enters


@pytest.mark.parametrize(
    ("after", "enters"), [([0.2, 0.4, 0.3, 0.5], True), ([0.02, 0.9, 1.3, 1.1], False), ([1.2, 1.1, 1.3, 1.4], False)]
)
def test_an_effect_of_segments_must_bring_whole_sequences_nearer(tanks, after, enters):
    """On nearly all of them: one sequence that comes much nearer, among others that do not, may be luck."""
    base = model(tanks, 4.0)._replace(free_run=np.ones(4))
    with_effect = model(tanks, 1.0, (LEAN,))._replace(free_run=np.array(after))
    candidates = screening(base, {LEAN: with_effect})
    assert (Judge(tanks, Criteria(), gap=1.0, noise=float("inf")).best(candidates, {}) is not None) == enters


def test_what_the_parameters_can_do_exactly_is_no_effect(problem):
    energies = {"": 400.0, "A": 1.0, "C": 2.0}
    assert found(problem, energies, visible={A: (100.0, 50.0)}) == "A"
    assert found(problem, energies, visible={A: (100.0, 1e-25)}) == "C"


def chosen(tanks: Problem, rich: np.ndarray, lean: np.ndarray) -> str:
    """Which of two enters, from its errors; the physics alone has ten times the noise."""
    base = model(tanks, 100.0)
    models = {name: model(tanks, 1.0, (name,), error) for name, error in ((RICH, rich), (LEAN, lean))}
    best = Judge(tanks, Criteria(), gap=9.0, noise=1.0).best(screening(base, models), {})
    assert best is not None
    return best.name


def test_of_two_that_predict_as_well_the_one_with_fewer_numbers_enters(tanks):
    other = NOISE + 0.05 * np.random.default_rng(1).standard_normal(NOISE.shape)
    assert chosen(tanks, rich=NOISE, lean=other) == LEAN


def test_the_better_one_enters_whichever_has_fewer_numbers(tanks):
    assert chosen(tanks, rich=NOISE, lean=1.2 * NOISE) == RICH
    assert chosen(tanks, rich=1.2 * NOISE, lean=NOISE) == LEAN


@pytest.mark.parametrize(("error", "expected"), [(1.01, LEAN), (1.1, RICH)])
def test_a_special_case_is_preferred_where_the_other_closes_hardly_more(tanks, error, expected):
    effects = tuple(e._replace(simpler=(LEAN,)) if e.name == RICH else e for e in tanks.effects)
    assert chosen(replace(tanks, effects=effects), rich=NOISE, lean=error * NOISE) == expected


def test_one_to_which_the_better_one_is_preferred_does_not_take_its_place_by_fewer_numbers(tanks):
    """The hum of one output beside disturbances of several inputs."""
    effects = tuple(e._replace(simpler=(RICH,)) if e.name == LEAN else e for e in tanks.effects)
    assert chosen(tanks, rich=NOISE, lean=NOISE * (1.0 + 1e-12)) == LEAN
    assert chosen(replace(tanks, effects=effects), rich=NOISE, lean=NOISE * (1.0 + 1e-12)) == RICH


@pytest.mark.parametrize("others", [{A: 3.0, B: 2.0}, {B: 2.0}])
def test_a_worse_fit_of_what_was_taken_out_does_not_let_an_imitator_in(problem, others):
    """Nor does none at all: the model that had it is known."""
    models = {name: model(problem, energy, (name,)) for name, energy in others.items()}
    known = _with_known(screening(model(problem, 9.0), models), screening(model(problem, 1.0, (A,)), {}))
    assert [candidate.name for candidate in known.candidates] == [A, B]
    assert known.candidates[0].gain == pytest.approx(0.5 * NOISE.size * np.log(9.0))


def test_a_better_fit_stands(problem):
    smaller = screening(model(problem, 9.0), {A: model(problem, 0.5, (A,)), B: model(problem, 2.0, (B,))})
    assert _with_known(smaller, screening(model(problem, 1.0, (A,)), {})) is smaller
