"""When a correction without a name outweighs the names: errors made by hand, in units of the noise."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.beyond import Beyond
from pgrssnn_jax.discovery.estimate import Estimate, Guess, Validated
from pgrssnn_jax.discovery.follows import Follows
from pgrssnn_jax.discovery.look import Candidate, Rules, Stage
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.search import Found
from pgrssnn_jax.discovery.verdict import Verdict, judge
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.tanks import cascaded_tanks

SAMPLES, NAME = 640, "bypass"
NOISE = np.random.default_rng(0).standard_normal((1, SAMPLES, 1))
NOISE /= np.sqrt((NOISE**2).mean())


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = cascaded_tanks()
    return build_problem(physics, [e for e in catalogue(physics) if e.name == NAME])


def model(problem: Problem, energy: float, active: tuple[str, ...] = ()) -> Validated:
    """A model whose errors are the noise but for their size; energy: in units of the noise's."""
    error = np.sqrt(energy) * NOISE
    return Validated(Estimate(active, problem.theta, np.zeros((1, 2)), error), error, problem.theta[None])


def verdict(
    problem: Problem,
    recalibrated: float,
    named: float,
    corrected: float,
    by_luck: float = 0.0,
    instead: bool = False,
    name: tuple[str, ...] = (NAME,),
    spread: float = 0.0,
    luckiest: float = 0.0,
) -> Verdict:
    """Energies of the recalibrated physics, with the named effect, and with a correction beside it or instead; by_luck:
    part of the draws of the null that gain as much, luckiest: what the others gain; spread: of the correction's errors
    from block to block."""
    base, final, better = (
        model(problem, energy, active) for energy, active in ((recalibrated, ()), (named, name), (corrected, name))
    )
    uneven = 1.0 + spread * np.where(np.arange(SAMPLES) // 32 % 2, 1.0, -1.0)
    better = better._replace(held_out=better.held_out * np.sqrt(uneven)[None, :, None])
    guess = Guess((NAME,), problem.theta, np.zeros((1, 2)))
    correction = Candidate("lower_level by upper_level", 1.0 - corrected / named, better, guess)
    null = np.where(np.arange(400) < 400 * by_luck, 1.0, luckiest)
    beside = Stage(final, (correction,), null, {}, SAMPLES, 1.0)
    nothing = Stage(base, (), null, {}, SAMPLES, 1.0)
    found = Found(base, final, dict.fromkeys(name, nothing), nothing, beside, 1.0)
    beyond = Beyond(None, beside, None) if instead else Beyond(beside, None, None)
    return judge(problem, found, beyond, recalibrated * SAMPLES, Rules(), 0).verdict


def test_a_correction_that_takes_away_most_of_what_names_leave_makes_them_stand_ins(problem):
    assert verdict(problem, recalibrated=1e4, named=1.4, corrected=1.05) is Verdict.UNKNOWN_EFFECT


@pytest.mark.parametrize(("instead", "expected"), [(True, Verdict.UNKNOWN_EFFECT), (False, Verdict.EFFECT_FOUND)])
def test_less_is_enough_for_a_correction_in_the_place_of_the_names(problem, instead, expected):
    """What is truly there is not beaten by a curve with many numbers; beside it one may find a little more."""
    assert verdict(problem, recalibrated=1e4, named=1.08, corrected=1.01, instead=instead) is expected


def test_names_that_leave_nothing_but_noise_stand(problem):
    assert verdict(problem, recalibrated=1e4, named=1.1, corrected=1.0) is Verdict.EFFECT_FOUND
    assert verdict(problem, recalibrated=1e4, named=0.98, corrected=0.80) is Verdict.EFFECT_FOUND


def test_names_stand_where_a_correction_takes_away_little_of_what_they_leave(problem):
    """As on a measured rig, whose errors are never noise alone."""
    assert verdict(problem, recalibrated=1e4, named=3.0, corrected=2.4) is Verdict.EFFECT_FOUND


def test_a_large_part_of_the_gap_is_enough(problem):
    assert verdict(problem, recalibrated=25.0, named=9.0, corrected=5.0) is Verdict.UNKNOWN_EFFECT


def test_a_gain_that_luck_brings_too_changes_nothing(problem):
    assert verdict(problem, recalibrated=1e4, named=1.4, corrected=1.05, by_luck=0.1) is Verdict.EFFECT_FOUND


def test_where_no_name_helps_and_errors_are_far_above_the_noise_a_likely_correction_is_enough(problem):
    far, near = ({"recalibrated": e, "named": e, "corrected": 0.9 * e, "spread": 0.5} for e in (400.0, 1.5))
    assert verdict(problem, **far, name=()) is Verdict.UNKNOWN_EFFECT
    assert verdict(problem, **far, name=(), by_luck=0.02) is Verdict.NO_DISCREPANCY
    assert verdict(problem, **near, name=()) is Verdict.NO_DISCREPANCY
    assert verdict(problem, **(far | {"recalibrated": 3600.0})) is Verdict.EFFECT_FOUND


@pytest.mark.parametrize(
    ("recalibrated", "expected"), [(900.0, Verdict.UNKNOWN_EFFECT), (3600.0, Verdict.EFFECT_FOUND)]
)
def test_names_that_close_less_than_half_of_the_gap_explain_little(problem, recalibrated, expected):
    energies = {"recalibrated": recalibrated, "named": 400.0, "corrected": 320.0, "spread": 0.5}
    assert verdict(problem, **energies) is expected


@pytest.mark.parametrize(("luckiest", "expected"), [(0.03, Verdict.UNKNOWN_EFFECT), (0.08, Verdict.EFFECT_FOUND)])
def test_what_names_leave_near_the_noise_is_judged_by_what_luck_brings_at_most(problem, luckiest, expected):
    """Names that bend the physics to reach the noise; a likely correction gains 9 % of the error energy."""
    energies = {"recalibrated": 1.5, "named": 1.1, "corrected": 1.0, "spread": 0.5}
    assert verdict(problem, **energies, luckiest=luckiest) is expected
    assert verdict(problem, **(energies | {"recalibrated": 1e4}), luckiest=luckiest) is Verdict.EFFECT_FOUND


@pytest.mark.parametrize(("corrected", "expected"), [(5.0, Verdict.UNKNOWN_EFFECT), (7.0, Verdict.EFFECT_FOUND)])
def test_where_most_of_the_error_energy_goes_near_certainty_is_enough(problem, corrected, expected):
    energies = {"recalibrated": 25.0, "named": 9.0, "corrected": corrected, "spread": 0.72}
    assert verdict(problem, **energies) is expected


@pytest.mark.parametrize(
    ("named", "follows", "expected"),
    [
        (100.0, Follows(0.6, 0.0025), Verdict.UNKNOWN_EFFECT),
        (100.0, Follows(0.6, 0.05), Verdict.MISCALIBRATED),  # noise of the same spectrum seems to as well
        (100.0, Follows(0.05, 0.0025), Verdict.MISCALIBRATED),  # nearly all of it is noise in the system
        (4.0, Follows(0.6, 0.0025), Verdict.EFFECT_FOUND),
    ],
)
def test_errors_far_above_the_noise_that_follow_the_signals_are_no_matter_of_numbers(problem, named, follows, expected):
    active = (NAME,) if named < 100.0 else ()
    base, final = model(problem, 100.0), model(problem, named, active)
    nothing = Stage(base, (), np.zeros(400), {}, SAMPLES, 1.0)
    found = Found(base, final, dict.fromkeys(active, nothing), nothing, nothing._replace(base=final), 1.0)
    beyond = Beyond(None, None, None, follows)
    assert judge(problem, found, beyond, 1e4 * SAMPLES, Rules(), 0).verdict is expected


@pytest.mark.parametrize(
    ("named", "corrected", "run", "by_luck", "expected"),
    [
        (4.0, 3.0, 0.8, 0.0, Verdict.UNKNOWN_EFFECT),
        (1.5, 1.0, 0.8, 0.0, Verdict.EFFECT_FOUND),  # near the noise
        (4.0, 3.9, 0.8, 0.0, Verdict.EFFECT_FOUND),  # hardly a fall
        (4.0, 3.0, 1.0, 0.0, Verdict.EFFECT_FOUND),  # of no use in the free run
        (4.0, 3.0, 0.8, 0.1, Verdict.EFFECT_FOUND),  # luck does as well
    ],
)
def test_in_stretches_a_correction_must_help_the_free_run_too(problem, named, corrected, run, by_luck, expected):
    """Energies in units of the noise's; run: error of the free run with the correction, 1 without it."""
    final, better = (model(problem, energy, (NAME,)) for energy in (named, corrected))
    correction = Candidate("boom by boom", 1.0 - corrected / named, better, better.guess, run)
    null = np.where(np.arange(400) < 400 * by_luck, 1.0, 0.0)
    beside = Stage(final, (correction,), null, {}, SAMPLES, 1.0, 1.0)
    first = Stage(model(problem, 100.0), (), null, {}, SAMPLES, 1.0, 5.0)
    found = Found(first.base, final, {NAME: first}, first, beside, 1.0)
    assert judge(problem, found, Beyond(beside, None, None), 1e5, Rules(), 0).verdict is expected
