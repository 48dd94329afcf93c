import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from jax.test_util import check_grads

from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.tanks import cascaded_tanks, clamped, derivative, measure, safe_sqrt
from pgrssnn_jax.records.scaling import Scaling, identity
from pgrssnn_jax.training import metrics

K = {"k1": 0.0464, "k2": 0.0003, "k3": 0.0412, "k4": 0.0586, "k5": 0.0039}


def simulate(physics, u, x0):
    """u `[time]`, x0 `[2]`, one sequence."""
    model = build_model(ModelSpec(networks=False), physics)
    params = ModelParams({}, physics.params, Scaling(identity(1), identity(2), identity(1)))
    run = jax.jit(lambda params, u, x0: rollout(model, params, u, x0))
    return run(params, jnp.asarray(u)[None, :, None], jnp.asarray(x0)[None])


def slope_by_hand(x, u):
    down = K["k1"] * np.sqrt(x[0]) - K["k2"] * x[0]
    return np.array([K["k3"] * u - down, down - K["k4"] * np.sqrt(x[1]) + K["k5"] * x[1]])


@pytest.mark.usefixtures("x64")
def test_fine_steps_equal_scipy_on_a_held_input():
    u, x = np.array([3.0, 1.0, 2.5, 4.0, 1.5]), np.array([5.0, 4.0])
    found = simulate(cascaded_tanks(integrator="rk4", sub_steps=20), u, x).x[0]
    for t, held in enumerate(u):
        solution = scipy.integrate.solve_ivp(
            lambda _, x, held=held: slope_by_hand(x, held), (0.0, 4.0), x, method="DOP853", rtol=1e-11, atol=1e-12
        )
        x = solution.y[:, -1]
        np.testing.assert_allclose(found[t], x, rtol=1e-6)


@pytest.mark.usefixtures("x64")
def test_published_step_is_forward_euler_over_four_seconds():
    physics, x, u = cascaded_tanks(), np.array([4.9, 3.2]), 2.7
    found = physics.step(physics.params, jnp.asarray(x), jnp.full(1, u))
    np.testing.assert_allclose(found, x + 4.0 * slope_by_hand(x, u), rtol=1e-14)
    np.testing.assert_array_equal(physics.measure(physics.params, found, jnp.full(1, u)), found[1:])
    assert (physics.dt, physics.params, physics.output_timing) == (4.0, K, "after_step")


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_what_leaves_the_upper_tank_reaches_the_lower(integrator):
    """Euler and RK4 keep linear invariants: without an outlet the volume changes by what is pumped in alone."""
    physics = cascaded_tanks(k4=0.0, k5=0.0, integrator=integrator, sub_steps=3)
    u, x0 = np.random.default_rng(0).uniform(0.5, 4.0, 40), np.array([3.0, 2.0])
    x = simulate(physics, u, x0).x[0]
    np.testing.assert_allclose(x.sum(-1), x0.sum() + 4.0 * K["k3"] * np.cumsum(u), rtol=1e-12)
    assert np.ptp(x[:, 0]) > 0.1


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("settings", "state"),
    [({}, [4.0, 3.0]), ({"clamp": True}, [0.5, 9.0]), ({"integrator": "rk4", "sub_steps": 2}, [0.5, 9.0])],
)
def test_derivatives_at_ordinary_levels(settings, state):
    physics = cascaded_tanks(**settings)

    @jax.jit
    def step(p, x, u):
        return physics.step(p, jnp.asarray(x), jnp.asarray(u))

    check_grads(step, (K, jnp.array(state), jnp.array([1.7])), order=1, modes=["fwd", "rev"], rtol=1e-6)


KINKS = [[0.0, 0.0], [0.0, 3.0], [3.0, 0.0], [-0.01, 2.0], [2.0, -0.01], [1e-30, 1e-30], [10.0, 10.0], [12.0, 12.0]]


@pytest.mark.parametrize("clamp", [False, True])
def test_derivatives_at_the_kinks_are_finite(clamp):
    step = cascaded_tanks(clamp=clamp).step
    jacobians = jax.jit(lambda x, u: (step(K, x, u), *(j(step, (0, 1, 2))(K, x, u) for j in (jax.jacrev, jax.jacfwd))))
    for state in KINKS:
        for pumped in (0.0, 50.0):
            found = jacobians(jnp.array(state), jnp.array([pumped]))
            assert all(np.isfinite(a).all() for a in jax.tree.leaves(found)), state


@pytest.mark.parametrize(
    ("level", "expected"), [(-1.0, 0.0), (-0.0, 0.0), (0.0, 0.0), (4.0, 0.25), (0.25, 1.0), (np.inf, 0.0)]
)
def test_root_of_a_level_and_its_slope(level, expected):
    value, slope = jax.value_and_grad(safe_sqrt)(jnp.float32(level))
    assert value == np.sqrt(max(level, 0.0))
    assert slope == expected


def test_a_level_that_is_not_a_number_is_not_hidden():
    x = cascaded_tanks().step(K, jnp.array([np.nan, 1.0]), jnp.array([1.0]))
    assert np.isnan(x[0])


def test_clamps_hold_both_levels_in_the_sensors_range_after_each_step():
    held, free = cascaded_tanks(clamp=True).step, cascaded_tanks().step
    for state, u, expected in [
        ([10.0, 10.0], 100.0, [10.0, None]),
        ([50.0, 50.0], 0.0, [10.0, 10.0]),
        ([0.001, 0.001], 0.0, [0.0, 0.0]),
        ([5.0, 5.0], 2.0, [None, None]),
    ]:
        x, loose = (np.asarray(step(K, jnp.array(state), jnp.array([u]))) for step in (held, free))
        for i, limit in enumerate(expected):
            assert x[i] == (loose[i] if limit is None else limit)
            assert limit is None or loose[i] != limit  # there was something to hold


def test_clamp_limits_pass_gradient_inside_and_none_outside():
    def upper(u, x):
        return cascaded_tanks(clamp=True).step(K, x, u[None])[0]

    slope = jax.jit(jax.grad(upper))
    assert slope(jnp.float32(100.0), jnp.array([9.9, 5.0])) == 0.0
    np.testing.assert_allclose(slope(jnp.float32(1.0), jnp.array([5.0, 5.0])), 4.0 * K["k3"], rtol=1e-5)


def test_clamped_keeps_everything_but_the_step():
    free = cascaded_tanks()
    held = clamped(free)
    assert held._replace(step=free.step) == free


def test_an_empty_tank_fills_by_the_pump_alone():
    slope = derivative(K, jnp.zeros(2), jnp.array([2.0]))
    np.testing.assert_allclose(slope, [2.0 * K["k3"], 0.0], rtol=1e-6)
    assert measure(K, jnp.array([1.0, 2.0]), jnp.zeros(1)).tolist() == [2.0]


def test_an_empty_tank_lets_nothing_out():
    slope = derivative(K, jnp.array([-0.5, -0.5]), jnp.array([0.0]))
    np.testing.assert_array_equal(slope, [0.0, 0.0])


def test_draining_overshoots_zero_by_one_euler_step_at_most():
    """The lowest level one Euler step can reach is min(x - dt k √x) = -(dt k)²/4; from there nothing flows out."""
    x = np.asarray(simulate(cascaded_tanks(), np.zeros(1500, np.float32), np.array([5.0, 5.0], np.float32)).x[0])
    assert np.isfinite(x).all()
    assert x[:, 0].min() >= -((4.0 * K["k1"]) ** 2) / 4
    assert x[:, 1].min() >= -((4.0 * K["k4"]) ** 2) / 4
    assert x[-1].max() < 0.01


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"integrator": "rk2"}, "integrator: expected one of"),
        ({"sub_steps": 0}, "sub_steps: expected at least 1"),
        ({"dt": 0.0}, "dt: expected a positive"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        cascaded_tanks(**settings)


@pytest.mark.data
@pytest.mark.parametrize(
    ("clamp", "start", "expected"),
    [(False, 0.0, "1.042"), (False, 5.205, "0.763"), (True, 0.0, "1.110"), (True, 5.205, "0.852")],
)
def test_physics_alone_scores_what_was_measured(data, clamp, start, expected):
    with (data / "cascaded_tanks" / "dataBenchmark.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["uVal"]]
    u, y = (np.array([float(row[name]) for row in rows], np.float32) for name in ("uVal", "yVal"))
    assert len(u) == 1024
    assert float(rows[0]["yEst"]) == 5.205
    found = simulate(cascaded_tanks(clamp=clamp), u, np.full(2, start, np.float32))
    error = metrics.rmse(measured=y[None, :, None], predicted=np.asarray(found.y), n_init=0)
    assert f"{error[0]:.3f}" == expected
    assert found.first_bad[0] == 1024
