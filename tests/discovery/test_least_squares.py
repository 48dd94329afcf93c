"""Fits of many lanes at once, against SciPy, finite differences and numbers that are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discovery.small_cases import PUBLISHED, pump, tank_record
from scipy.optimize import least_squares

from pgrssnn_jax.discovery.least_squares import Lanes, fit, sensitivity, simulate
from pgrssnn_jax.discovery.problem import HELD, Problem, Signals, build_problem, weighted_signals
from pgrssnn_jax.discovery.solve import solve
from pgrssnn_jax.effects.systems import add_effect, catalogue
from pgrssnn_jax.physics.base import Parameter
from pgrssnn_jax.physics.tanks import cascaded_tanks

TRUE = {"k1": 0.05, "k2": 0.0003, "k3": 0.043, "k4": 0.056, "k5": 0.0039}
OWN = ["k1", "k3", "k4"]


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def problem() -> Problem:
    physics = cascaded_tanks(integrator="rk4")
    return build_problem(physics, [e for e in catalogue(physics) if e.name in ("leak_tank1", "sensor_offset")])


@pytest.fixture(scope="module")
def record() -> Signals:
    whole = tank_record(pump(240, 1), noise=0.0, k=TRUE)
    physics = cascaded_tanks(integrator="rk4")
    return weighted_signals(build_problem(physics, []), whole, folds=3, block=20)


def at(problem: Problem, *labels: str) -> list[int]:
    return [i for label in labels for i, slot in enumerate(problem.slots) if slot.label == label]


def lanes(problem: Problem, record: Signals, free, theta=None) -> Lanes:
    """Three lanes; every test has these, so that one program serves all."""
    theta = np.tile(problem.theta, (3, 1)) if theta is None else theta
    places = np.array([list(f) + [-1] * (6 - len(f)) for f in free])
    x0 = np.tile(record.start, (3, 1, 1)) + 0.0
    return Lanes(theta, x0, places)


def test_simulation_repeats_the_plant_in_numpy(problem, record):
    theta = problem.theta.copy()
    theta[at(problem, *TRUE)] = list(TRUE.values())
    y, x = simulate(problem, record.u, theta[None], np.array([[[4.0, 4.0]]]))
    np.testing.assert_allclose(y[0], record.y, atol=1e-3)
    np.testing.assert_array_equal(x[0][..., 1:], y[0])


def test_known_parameters_are_found_again(problem, record):
    free = at(problem, *OWN)
    start = np.tile(problem.theta, (3, 1))
    start[1:, free] *= [[0.8], [1.25]]
    found = fit(problem, record, lanes(problem, record, [free] * 3, start), steps=40)
    for theta, x0 in zip(found.theta, found.x0, strict=True):
        np.testing.assert_allclose(theta[free], [TRUE[name] for name in OWN], rtol=1e-3)
        np.testing.assert_allclose(x0, [[4.0, 4.0]], atol=5e-3)
        others = np.setdiff1d(np.arange(len(theta)), free)
        np.testing.assert_array_equal(theta[others], problem.theta[others])


def noisy(record: Signals) -> Signals:
    return record._replace(y=record.y + 0.05 * np.random.default_rng(3).standard_normal(record.y.shape))


def test_a_coarse_tolerance_ends_sooner(problem, record):
    free, start = at(problem, *OWN), np.tile(problem.theta, (3, 1))
    given = lanes(problem, record, [free] * 3, start)
    fine, coarse, one = (
        fit(problem, record, given, steps=steps, tolerance=tolerance).cost.max()
        for steps, tolerance in ((40, 1e-6), (40, 0.9999), (1, 1e-6))
    )
    assert fine < coarse
    assert coarse <= one


def test_scipy_finds_no_better_fit(problem, record):
    record, free = noisy(record), at(problem, *OWN)
    found = fit(problem, record, lanes(problem, record, [free] * 3), steps=60)

    def residual(z):
        theta = problem.theta.copy()
        theta[free] = z[:3]
        y, _ = simulate(problem, record.u, theta[None], z[None, None, 3:])
        return (record.weight * (record.y - y[0])).ravel()

    begin = np.concatenate([problem.theta[free], record.start[0]])
    other = least_squares(residual, begin, x_scale=np.abs(begin), xtol=1e-13, ftol=1e-13, gtol=1e-13)
    mine = residual(np.concatenate([found.theta[0, free], found.x0[0, 0]]))
    assert mine @ mine == pytest.approx(2 * other.cost, rel=1e-6)
    assert found.cost[0] == pytest.approx(mine @ mine, rel=1e-4)  # with the prior
    np.testing.assert_allclose(found.theta[0, free], other.x[:3], rtol=1e-3)


def test_sensitivities_are_those_of_finite_differences(problem, record):
    free, h = at(problem, "k1", "k5", "leak_tank1.rate", "sensor_offset.offset[1]"), 1e-6
    theta = problem.theta.copy()
    theta[at(problem, "leak_tank1.rate")] = 0.002
    start = np.array([[3.5, 4.2]])
    chosen = Lanes(theta[None], start[None], np.array([[*free, -1]]))
    y, dy = sensitivity(problem, record, chosen)
    np.testing.assert_allclose(y, simulate(problem, record.u, theta[None], start[None])[0], rtol=1e-12)
    assert not dy[..., 4].any(), "a place that is not used"
    moves = [(h * np.eye(len(theta))[i], np.zeros(2)) for i in free]
    moves += [(np.zeros(len(theta)), h * e) for e in np.eye(2)]
    thetas = np.array([theta + s * d for d, _ in moves for s in (1, -1)])
    starts = np.array([start + s * d for _, d in moves for s in (1, -1)])
    both, _ = simulate(problem, record.u, thetas, starts)
    expected = np.moveaxis((both[::2] - both[1::2]) / (2 * h), 0, -1)
    np.testing.assert_allclose(dy[0][..., [0, 1, 2, 3, 5, 6]], expected, rtol=1e-4, atol=1e-5)


def test_devices_that_share_the_sequences_of_one_fit_change_nothing(problem, record):
    """Nine sequences on two devices: one is added without weight."""
    free = at(problem, *OWN)
    noise = 0.02 * np.random.default_rng(5).standard_normal((9, *record.y.shape[1:]))
    many = Signals(*(np.repeat(a, 9, 0) for a in record))._replace(y=record.y + noise)
    one = Lanes(problem.theta[None], many.start[None], np.array([free]))
    alone, shared = (fit(problem, many, one, steps=20, devices=devices) for devices in (1, 2))
    np.testing.assert_allclose(shared.cost, alone.cost, rtol=1e-9)
    np.testing.assert_allclose(shared.theta, alone.theta, rtol=1e-6)
    np.testing.assert_allclose(shared.x0, alone.x0, rtol=1e-6)
    for mine, other in zip(sensitivity(problem, many, one), sensitivity(problem, many, one, 2), strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-12)


def test_bounds_hold(problem, record):
    """Water comes in rather than out, so that a leak would have to be negative."""
    free = at(problem, "leak_tank1.rate")
    less = record._replace(y=record.y + np.linspace(0.2, 1.0, 240)[None, :, None])
    theta = np.tile(problem.theta, (3, 1))
    theta[:, free[0]] = [0.0, 0.003, 0.1]
    found = fit(problem, less, lanes(problem, less, [free] * 3, theta), steps=20)
    assert np.all((found.theta >= problem.low) & (found.theta <= problem.high))
    np.testing.assert_allclose(found.theta[:, free[0]], 0.0, atol=1e-6)


def test_a_prior_takes_a_number_from_its_bound_where_the_data_hardly_pull(problem, record):
    """Data that pull outwards, of next to no weight."""
    free = at(problem, "k4")
    inwards = problem.held(0.5, 1.0)
    theta = np.tile(problem.theta, (3, 1))
    theta[:, free[0]] = [problem.low[free[0]], problem.theta[free[0]], problem.low[free[0]]]
    less = record._replace(y=record.y + 1e3, weight=1e-6 * record.weight, precision=np.full((1, 2), HELD))
    found = fit(inwards, less, lanes(problem, less, [free] * 3, theta), steps=40)
    np.testing.assert_allclose(found.theta[:, free[0]], problem.theta[free[0]], rtol=1e-3)


def test_a_lane_that_is_not_finite_leaves_the_others_alone(problem, record):
    free = at(problem, *OWN)
    theta = np.tile(problem.theta, (3, 1))
    good = fit(problem, record, lanes(problem, record, [free] * 3, theta), steps=10)
    broken = theta.copy()
    broken[1, at(problem, "k5")] = np.nan
    found = fit(problem, record, lanes(problem, record, [free] * 3, broken), steps=10)
    assert found.cost[1] == np.inf
    np.testing.assert_array_equal(found.theta[1], broken[1])
    for i in (0, 2):
        np.testing.assert_array_equal(found.theta[i], good.theta[i])
        assert found.cost[i] == good.cost[i]


def test_samples_that_were_not_measured_say_nothing(problem, record):
    free, gap = at(problem, *OWN), np.arange(240)[None, :, None] % 7 == 3
    holes = record._replace(weight=np.where(gap, 0.0, record.weight))
    other = holes._replace(y=np.where(gap, np.nan, record.y))
    found, again = (fit(problem, r, lanes(problem, record, [free] * 3), steps=10) for r in (holes, other))
    np.testing.assert_array_equal(found.theta, again.theta)
    assert np.isfinite(again.cost).all()


def test_no_step_is_taken_where_none_is_allowed(problem, record):
    given = lanes(problem, record, [at(problem, *OWN)] * 3)
    found = fit(problem, record, given, steps=0)
    np.testing.assert_array_equal(found.theta, given.theta)
    np.testing.assert_array_equal(found.x0, given.x0)


@pytest.mark.parametrize("n", [1, 2, 7])
def test_solve_is_that_of_lapack(n):
    draw = np.random.default_rng(n)
    half = draw.normal(size=(5, 3, n, 2 * n))
    a = half @ np.swapaxes(half, -1, -2) * (scale := 10.0 ** draw.uniform(-4, 4, n)) * scale[:, None]
    b = draw.normal(size=(5, 3, n, 4)) * scale[:, None]
    np.testing.assert_allclose(jax.jit(solve)(jnp.asarray(a), jnp.asarray(b)), np.linalg.solve(a, b), rtol=1e-6)


def test_problem_places_every_number(problem):
    assert {s.label for s in problem.slots if s.effect is None} == set(PUBLISHED)
    theta = problem.put(problem.theta, "sensor_offset", {"offset": np.array([0.25])})
    assert problem.params(theta).effects["sensor_offset"]["offset"] == [0.25]
    assert float(problem.params(theta).own["k1"]) == pytest.approx(PUBLISHED["k1"])
    assert [problem.slots[i].label for i in problem.of("leak_tank1")] == ["leak_tank1.rate"]


def test_effects_that_the_physics_has_are_its_own_numbers():
    """They are recalibrated like k1; what is looked for keeps apart, also from an own number of the same name."""
    physics = add_effect(cascaded_tanks(integrator="rk4"), "leak_tank1", rate=0.002)
    params = {**physics.params.own, "sensor_offset": 0.5}
    meanings = {**physics.parameters.own, "sensor_offset": Parameter("own")}
    physics = physics._replace(
        params=physics.params._replace(own=params), parameters=physics.parameters._replace(own=meanings)
    )
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name == "sensor_offset"], fixed=["k2"])
    assert {s.label for s in problem.slots if s.effect is None} == {*PUBLISHED, "leak_tank1.rate", "sensor_offset"}
    assert [problem.slots[i].label for i in problem.of("sensor_offset")] == ["sensor_offset.offset[1]"]
    assert "k2" not in [problem.slots[i].label for i in problem.of(None)]
    known = problem.known(problem.theta)
    assert jax.tree.structure(known) == jax.tree.structure(jax.tree.map(float, physics.params))
    assert known.effects["leak_tank1"]["rate"] == 0.002
    other = physics.params._replace(effects={"leak_tank1": {"rate": 0.005}})
    moved = problem.with_numbers(other)
    assert moved.known(moved.theta).effects["leak_tank1"]["rate"] == 0.005
    assert moved.params(moved.theta).own["sensor_offset"] == 0.5
