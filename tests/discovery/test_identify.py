"""Final numbers, departures and combinations of x' = a x + b u, y = c x, of which data determine a and b c alone."""

import jax
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter
from toys import small_record

from pgrssnn_jax.discovery.candidates import Model, fitted_models
from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.identify import departures, most_likely, undetermined
from pgrssnn_jax.discovery.noise import longest_memory
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm

SAMPLES, TOLERANCE = 300, 0.1
SETTINGS = Settings(spare=1, lanes=1, steps=60, tolerance=1e-10)

pytestmark = pytest.mark.usefixtures("x64")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return build_problem(lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"]), ())


def outputs(u: np.ndarray, pole: float, gain: float) -> np.ndarray:
    return gain * np.asarray(lfilter([1.0], [1.0, -pole], u))


def signals_of(problem: Problem, gain: float, disturbance: float = 0.0) -> Signals:
    """disturbance: size of slow noise beside white noise of size 0.1."""
    draw = np.random.default_rng(0)
    u, slow = draw.standard_normal((2, SAMPLES))
    y = outputs(u, 0.8, gain) + 0.1 * draw.standard_normal(SAMPLES) + disturbance * outputs(slow, 0.9, 1.0)
    return weighted_signals(problem, small_record(u[:, None], y[:, None]), folds=3, block=20)


def found(problem: Problem, signals: Signals) -> tuple[Problem, Model]:
    begun = Guess((), problem.theta, signals.start)
    held, guess = most_likely(problem.held(TOLERANCE, 1e-9), signals, begun, TOLERANCE, SETTINGS)
    (model,) = fitted_models(held, signals, [guess], SETTINGS, 20)
    return held, model


@pytest.mark.parametrize("disturbance", [0.0, 1.0])
def test_the_final_numbers_are_the_likeliest_where_the_variance_is_unknown(problem, disturbance):
    """n / τ log S + P, τ: samples that say as much as one; by SciPy with the system in closed form."""
    signals = signals_of(problem, 2.0, disturbance)
    held, model = found(problem, signals)
    memory = longest_memory(model.estimate.error)
    assert memory * model.estimate.cost / SAMPLES == pytest.approx(held.noise, rel=0.1)
    assert (memory > 2.0) == (disturbance > 0.0)
    independent = model.estimate.cost / held.noise  # n / τ with the τ that the fit settled on
    given = np.array([0.8, 1.0, 1.0])

    def negative(z):
        a, b, c, x0 = z
        y = outputs(signals.u[0, :, 0], a, b * c) + c * a ** np.arange(1, SAMPLES + 1) * x0
        error = signals.weight[0, :, 0] * (signals.y[0, :, 0] - y)
        prior = ((np.array([a, b, c]) - given) / (TOLERANCE * given)) ** 2
        return independent * np.log(error @ error) + prior.sum()

    begin = np.array([*model.estimate.theta, model.estimate.x0[0, 0]])
    other = minimize(negative, begin, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000})
    np.testing.assert_allclose(model.estimate.theta, other.x[:3], rtol=5e-3)


def test_a_product_is_determined_and_its_factors_are_not(problem):
    signals = signals_of(problem, 1.0)
    held, model = found(problem, signals)
    (one,) = undetermined(held, signals, model.estimate.guess, SETTINGS)
    assert set(one.changes) == {"B[1][1]", "C[1][1]"}
    assert one.changes["B[1][1]"] * one.changes["C[1][1]"] == pytest.approx(-1.0, abs=0.1), "one up, the other down"
    assert one.left == pytest.approx(1.0, abs=0.05)
    assert model.deviation[0] < 0.01, "the pole is determined"


@pytest.mark.parametrize(("gain", "departed"), [(1.2, set()), (2.0, {"B[1][1]", "C[1][1]"})])
def test_numbers_outside_their_prior_are_departures(problem, gain, departed):
    """Either factor takes half of the gain: 1.1 is within 1 ± 0.196, 1.41 is not."""
    held, model = found(problem, signals_of(problem, gain))
    rows = departures(held, model)
    assert {held.slots[row.place].label for row in rows} == departed
    for row in rows:
        assert row.before == 1.0
        assert row.after == pytest.approx(2.0**0.5, rel=0.02)
        assert row.prior == pytest.approx((1.0 - 0.196, 1.0 + 0.196))


def test_zeros_of_a_matrix_are_held_by_its_largest_entry():
    physics = lgssm(A=[[0.8, 0.0], [0.3, 0.5]], B=[[1.0], [0.0]], C=[[1.0, 0.0]], inputs=["u0"], outputs=["y0"])
    problem = build_problem(physics, ())
    signals = signals_of(problem, 1.0)
    rows = undetermined(problem.held(TOLERANCE, 1e-4), signals, Guess((), problem.theta, signals.start), SETTINGS)
    assert any(np.isfinite(list(row.changes.values())).all() and "A[2][1]" in row.changes for row in rows)


def test_without_a_prior_nothing_departs(problem):
    signals = signals_of(problem, 2.0)
    (model,) = fitted_models(problem, signals, [Guess((), problem.theta, signals.start)], SETTINGS, 20)
    assert departures(problem, model) == []
    with jax.enable_x64(True):
        assert undetermined(problem, signals, model.estimate.guess, SETTINGS) == []


@pytest.mark.parametrize("largest", [0.5, np.inf])
def test_numbers_of_an_effect_stay_where_they_would_not_be_credible(largest):
    """A disturbance leaves the weight of the prior far from what the search took; the numbers are fitted again."""
    physics = lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    offset = next(effect for effect in catalogue(physics) if effect.name == "sensor_offset")
    rule = offset._replace(credible=lambda numbers, span: bool(np.abs(numbers["offset"]).max() <= largest))
    problem = build_problem(physics, (rule,))
    signals = signals_of(problem, 2.0, disturbance=1.0)
    signals = signals._replace(y=signals.y + 3.0)
    begun = Guess(("sensor_offset",), problem.theta, signals.start)
    _, guess = most_likely(problem.held(TOLERANCE, 1e-9), signals, begun, TOLERANCE, SETTINGS)
    moved = guess.theta[problem.of("sensor_offset")]
    assert (np.abs(moved - 3.0) < 1.0).all() if largest > 3.0 else (moved == 0.0).all()
