"""The test record: intervals of the improvement that contain it, and the starts from which it is simulated."""

import jax
import numpy as np
import pytest
from discovery.small_cases import choices, setup_of
from scipy.signal import lfilter
from toys import small_record

from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.validate import Metric, _interval, _resampled, validations_on_test, white_noise
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.record import Record

RMSE, SAMPLES = Metric("RMSE", "V", 0), 600
WAVE = np.sin(np.arange(SAMPLES) / 7)[None, :, None]


def improvement(pole: float, seed: int, missing: float) -> tuple[tuple[float, float], float]:
    """Interval of the improvement by a model that lacks nothing, beside one that lacks a wave; and what it is."""
    noise = lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], np.random.default_rng(seed).standard_normal(SAMPLES))
    y = np.ones((1, SAMPLES, 1)) + noise[None, :, None]
    record = small_record(np.zeros((SAMPLES, 1)), y[0])
    before, after = _resampled(record, [1.0 - missing * WAVE, np.ones_like(y)], RMSE)
    return _interval(before - after), float(np.sqrt(1.0 + missing**2 / 2) - 1.0)


@pytest.mark.parametrize(("pole", "covered"), [(0.0, 0.88), (0.9, 0.8)])
def test_the_interval_contains_the_improvement_and_excludes_none_where_it_is_large(pole, covered):
    found = [improvement(pole, seed, missing=1.0) for seed in range(60)]
    assert np.mean([low <= true <= high for (low, high), true in found]) >= covered
    assert np.mean([low > 0.0 for (low, _), _ in found]) >= 0.9


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_an_improvement_that_is_none_is_seldom_confirmed(pole):
    """A model that takes a small wave away which is not there."""
    lows = []
    for seed in range(60):
        noise = lfilter([1.0], [1.0, -pole], np.random.default_rng(seed).standard_normal(SAMPLES))[None, :, None]
        record = small_record(np.zeros((SAMPLES, 1)), noise[0])
        before, after = _resampled(record, [np.zeros_like(noise), 0.1 * noise.std() * WAVE], RMSE)
        lows.append(_interval(before - after)[0])
    assert np.mean(np.array(lows) > 0.0) <= 0.05


def test_models_that_are_equal_improve_nothing_and_what_was_not_measured_does_not_count():
    y, mask = np.random.default_rng(0).standard_normal((SAMPLES, 1)), np.ones((SAMPLES, 1), bool)
    mask[::3] = False
    record = small_record(np.zeros((SAMPLES, 1)), np.where(mask, y, np.nan), mask=mask)
    one, other = _resampled(record, [np.zeros((1, SAMPLES, 1)), np.where(mask, 0.0, 9.0)[None]], RMSE)
    np.testing.assert_array_equal(one, other)
    assert one.mean() == pytest.approx(np.sqrt((y[mask] ** 2).mean()), rel=0.02)


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = lgssm(A=[[0.9]], B=[[0.5]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    return build_problem(physics, [e for e in catalogue(physics) if e.name == "sensor_offset"])


def plant(start: float, offset: float) -> Record:
    draw = np.random.default_rng(5)
    u, x, y = draw.standard_normal((200, 1)), start, []
    for (v,) in u:
        x = 0.9 * x + 0.5 * v
        y.append([x + offset + 0.1 * draw.standard_normal()])
    return small_record(u, np.array(y))


@pytest.mark.parametrize(("start", "begins"), [(Start.SHARED, 3.0), (Start.AT_REST, 0.0), (Start.UNKNOWN, -8.0)])
def test_the_test_record_is_simulated_from_what_is_known_of_its_start(problem, start, begins):
    guess = Guess((), problem.theta, np.full((1, 1), 3.0))
    found = Guess(("sensor_offset",), problem.put(problem.theta, "sensor_offset", {"offset": [0.8]}), guess.x0)
    record = plant(begins, 0.8)
    setup = setup_of(problem, record, record, choices(n_init=30), start)
    with jax.enable_x64(True):
        said = validations_on_test(
            problem, setup, (guess, guess, found), {"sensor_offset": guess}, Settings(steps=10), 1.0
        )
    assert said.metric.n_init == (30 if start is Start.UNKNOWN else 0)
    assert said.after.error == pytest.approx(0.1, rel=0.2)
    assert said.recalibrated.error == pytest.approx(0.8, rel=0.15)
    assert said.without == {"sensor_offset": said.recalibrated.error}
    assert said.relative == pytest.approx(said.after.error / record.y[0, said.metric.n_init :].std(), rel=1e-6)
    low, high = said.improvement
    assert 0.5 < low < said.recalibrated.error - said.after.error < high < 0.9
    assert said.after.interval[0] < said.after.error < said.after.interval[1]


def test_what_predicts_no_better_than_the_nominal_physics_is_no_improvement(problem):
    """A recalibration may do harm on another record, and an effect may only undo that."""
    right = Guess((), problem.theta, np.zeros((1, 1)))
    wrong = Guess(("sensor_offset",), problem.put(problem.theta, "sensor_offset", {"offset": [0.8]}), right.x0)
    record = plant(0.0, 0.0)
    setup = setup_of(problem, record, record, choices(n_init=30), Start.AT_REST)
    with jax.enable_x64(True):
        said = validations_on_test(problem, setup, (right, wrong, right), {}, Settings(steps=10), 1.0)
    assert said.recalibrated.error > 0.7
    assert said.improvement == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize(
    ("lost", "expected"),
    [
        ("recalibrated", (0.9, 0.9)),  # beside the nominal physics, which is the better one
        ("both", (np.inf, np.inf)),
        ("after", (-np.inf, -np.inf)),
    ],
)
def test_a_run_that_leaves_the_range_is_infinitely_wrong(problem, lost, expected):
    """A model with names ended far outside, and its errors were no number: a correction that was right in its place
    was refuted."""
    still = small_record(np.zeros((200, 1)), np.zeros((200, 1)))
    unstable = problem.theta.copy()
    unstable[[i for i, slot in enumerate(problem.slots) if slot.label.startswith("A")]] = 1e9

    def model(name: str, offset: float) -> Guess:
        gone = lost == name or (lost == "both" and name != "after")
        theta = problem.put(unstable if gone else problem.theta, "sensor_offset", {"offset": [offset]})
        return Guess((), theta, np.ones((1, 1)) if gone else np.zeros((1, 1)))

    models = [model("nominal", 1.0), model("recalibrated", 2.0), model("after", 0.1)]
    setup = setup_of(problem, still, still, choices(), Start.SHARED)
    with jax.enable_x64(True):
        said = validations_on_test(problem, setup, models, {}, Settings(steps=10), 1.0)
    assert said.improvement == pytest.approx(expected)
    assert said.after.error == (np.inf if lost == "after" else pytest.approx(0.1))


@pytest.mark.parametrize("start", list(Start))
@pytest.mark.parametrize("phase", [0.3, pytest.param(2.5, marks=pytest.mark.slow), 4.4])
def test_no_record_shares_its_phase_with_another(start, phase):
    physics = lgssm(A=[[0.9]], B=[[0.5]], C=[[1.0]], inputs=["u0"], outputs=["y0"])
    name, numbers = "periodic_sensor_error", {"amplitude": [0.6], "frequency": 0.11}
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name == name])
    guess = Guess((), problem.theta, np.array([[0.0, 0.0]]))
    found = Guess((name,), problem.put(problem.theta, name, numbers), np.array([[0.0, 1.1]]))
    record = plant(0.0, 0.0)
    hum = 0.6 * np.sin(2 * np.pi * 0.11 * physics.dt * np.arange(1, 201) + phase)
    record = record._replace(y=record.y + hum[None, :, None].astype(record.y.dtype))
    setup = setup_of(problem, record, record, choices(n_init=30), start)
    with jax.enable_x64(True):
        said = validations_on_test(problem, setup, (guess, guess, found), {}, Settings(steps=10), 1.0)
    assert said.metric.n_init == 30, "the samples that its phase was fitted to do not count"
    assert said.after.error == pytest.approx(0.1, rel=0.25)
    assert said.recalibrated.error > 0.4
    if start is not Start.UNKNOWN:
        assert said.after.x[0, 0, 0] == said.recalibrated.x[0, 0, 0], "the state begins where it is known to"


def test_the_noise_is_that_of_the_estimation_record_over_the_spread_of_the_test_record():
    """Of each output; samples at which a run has left the range of numbers tell nothing."""
    sizes, scale = np.array([0.1, 0.4]), np.array([2.0, 4.0])
    y = sizes * np.random.default_rng(0).standard_normal((4000, 2))
    run = np.zeros((1, 4000, 2))
    assert white_noise(small_record(np.zeros((4000, 1)), y), run, scale) == pytest.approx(0.075, rel=0.03)
    run[0, 2000:] = np.nan
    assert 0.0 < white_noise(small_record(np.zeros((4000, 1)), y), run, scale) < 0.08


def test_what_an_error_is_divided_by_is_the_spread_of_the_samples_that_count():
    y = np.concatenate([np.full(100, 50.0), np.tile([1.0, -1.0], 200)])
    record = small_record(np.zeros((500, 1)), y[:, None])
    assert Metric("NRMSE", "", 100).scale(record) == pytest.approx([1.0])
    assert Metric("RMSE", "V", 100).scale(record) == pytest.approx([1.0])
    assert Metric("NRMSE", "", 0).scale(record) > 10.0
