"""The second search goes on from the fits of the first: the same answers, and fewer fits."""

from typing import Any

import jax
import numpy as np
import pytest
from discovery.small_cases import choices, setup_of
from toys import small_record

from pgrssnn_jax.discovery import candidates
from pgrssnn_jax.discovery.candidates import Screening, score_candidates
from pgrssnn_jax.discovery.discover import discover_in
from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate
from pgrssnn_jax.discovery.further import Carry, further_effects, with_first_fits
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.record import Record

PLAIN, BENT = ("input_delay", "sensor_offset"), "sensor_nonlinearity"
SETTINGS, CRITERIA = Settings(steps=12), Criteria(draws=199, block=20)


def problem_of(*names: str) -> Problem:
    physics = lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    return build_problem(physics, [e for e in catalogue(physics) if e.name in names], fixed=["C"])


@pytest.fixture(scope="module")
def first() -> Problem:
    return problem_of(*PLAIN)


@pytest.fixture(scope="module")
def whole() -> Problem:
    return problem_of(*PLAIN, BENT)


def record_of(samples: int, bend: float, seed: int = 0) -> Record:
    """By a sensor that is bent."""
    draw = np.random.default_rng(seed)
    u, x, y = draw.standard_normal((samples, 1)), 0.0, []
    for (v,) in u:
        x = 0.8 * x + v
        y.append([x + bend * x**2 + 0.05 * draw.standard_normal()])
    return small_record(u, np.array(y))


def recorded(problem: Problem) -> Signals:
    return weighted_signals(problem, record_of(400, 0.05), folds=3, block=20)


def screen(problem: Problem, base: Any, **known: Any) -> Screening:
    draw = np.random.default_rng(1)
    return score_candidates(problem, recorded(problem), base, SETTINGS, CRITERIA, draw, (), **known)


def test_what_was_fitted_is_not_fitted_again_and_what_is_new_is(first, whole, monkeypatch):
    fitted: list[str] = []

    def counted(problem: Problem, signals: Signals, guesses: Any, *rest: Any, **more: Any) -> Any:
        fitted.extend(name for guess in guesses for name in guess.active)
        return fit_all(problem, signals, guesses, *rest, **more)

    fit_all = candidates.fit_all
    monkeypatch.setattr(candidates, "fit_all", counted)
    with jax.enable_x64(True):
        before = screen(first, Guess((), first.theta, recorded(first).start))
        fitted.clear()
        carry = Carry(first, whole, recorded(whole).start)
        screened = with_first_fits(lambda base, **known: screen(whole, base, **known), {(): before}, carry)
        start = Guess((), whole.theta, recorded(whole).start)
        found = screened(start)
        assert set(fitted) == {BENT}
        anew = screen(whole, start)
    assert [c.name for c in found.candidates] == [c.name for c in anew.candidates]
    assert found.candidates[0].name == BENT
    for one, other in zip(found.candidates, anew.candidates, strict=True):
        assert one.gain == pytest.approx(other.gain, rel=0.02, abs=0.1)
        assert found.p_value(one) == pytest.approx(anew.p_value(other), abs=0.02)
    assert found.noise == pytest.approx(anew.noise, rel=1e-3)


def test_a_model_simulates_alike_in_both_problems(first, whole):
    with jax.enable_x64(True):
        before = screen(first, Guess((), first.theta, recorded(first).start))
        carry = Carry(first, whole, recorded(whole).start)
        for one in (before.base, *(c.model for c in before.candidates if c.model)):
            carried = carry.model(one)
            again = evaluate(whole, recorded(whole), carried.estimate.guess)
            np.testing.assert_allclose(again.error, one.estimate.error, atol=1e-9)
            names = (None, *one.estimate.active)
            for name in names:
                np.testing.assert_array_equal(carried.deviation[whole.of(name)], one.deviation[first.of(name)])
            assert not carried.deviation[whole.of(BENT)].any()


def test_a_base_that_the_first_search_did_not_see_is_screened_anew(first, whole):
    with jax.enable_x64(True):
        made = screen(whole, Guess((), whole.theta, recorded(whole).start))
    seen = []

    def screened(base: Any, **known: Any) -> Screening:
        seen.append((base, known))
        return made

    base = Guess((BENT,), whole.theta, recorded(whole).start)
    assert with_first_fits(screened, {}, Carry(first, whole, recorded(whole).start))(base) is made
    assert seen == [(base, {})]


def test_elaborate_effects_are_for_errors_above_the_noise_or_for_what_is_known_to_be_missing(first):
    with jax.enable_x64(True):
        found, signals = screen(first, Guess((), first.theta, recorded(first).start)), recorded(first)
        effects, names = catalogue(first.physics), []
        for noise in (found.noise, found.rms() ** 2):  # errors above it, errors that are noise
            selection = Selection(found.base, found.base, {}, found, found, noise)
            for missing in (False, True):
                further = further_effects(first, signals, selection, effects, CRITERIA, missing=missing)
                names.append([effect.name for effect in further])
    assert names == [[BENT], [BENT], [], [BENT]]


@pytest.mark.slow
def test_a_correction_near_the_noise_asks_for_elaborate_effects(first):
    """Beside an offset, the sensor's curve adds 7 % to the errors: too little for a second search, until a correction
    shows it."""
    said: list[str] = []
    setup = setup_of(first, record_of(3000, 0.005), record_of(1500, 0.005, seed=1), choices(n_init=1, fixed=["C"]))
    setup = setup._replace(effects=(*first.effects, *problem_of(BENT).effects))
    found = discover_in(first, setup, said.append)
    assert [line for line in said if "looking for" in line] == [
        f"no effect explains the errors: looking for {BENT} too"
    ]
    assert found.selection.final.estimate.active == (BENT,)
    assert found.judgement.verdict is Verdict.EFFECT_FOUND
