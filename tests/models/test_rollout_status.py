"""When the plant is read, and how a rollout reports what leaves the floating-point range."""

import jax.numpy as jnp
import numpy as np
import pytest
from toys import compiled_rollout, quick_jit, spec, toy_model, toy_params, toy_signals

from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.scaling import Scaling, identity

LINEAR = lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]])


def alone(physics, u, x0):
    scaling = Scaling(*(identity(len(s)) for s in (physics.inputs, physics.states, physics.outputs)))
    model = build_model(ModelSpec(networks=False), physics)
    return compiled_rollout(model)(ModelParams({}, physics.params, scaling), u, x0)


def test_a_linear_plant_at_rest_stays_there_without_input():
    assert not alone(LINEAR, jnp.zeros((1, 5, 1)), jnp.zeros((1, 2))).y.any()


def test_a_plant_read_before_the_step_is_one_sample_late():
    u, x0 = jnp.ones((2, 6, 1)), jnp.array([[1.0, 2.0], [0.0, -1.0]])
    after, before = alone(LINEAR, u, x0), alone(LINEAR._replace(output_timing="before_step"), u, x0)
    np.testing.assert_array_equal(after.x, before.x)
    np.testing.assert_array_equal(before.y[:, 1:], after.y[:, :-1])
    np.testing.assert_array_equal(before.y[:, 0], x0[:, :1])
    np.testing.assert_array_equal(alone(LINEAR._replace(output_timing="before_step"), u[:, :1], x0).y[:, 0], x0[:, :1])


@pytest.mark.parametrize("name", ["PG-RSSNN", "PG-RSSNN(fb)", "physics"])
def test_a_state_that_leaves_the_range_is_reported_and_disturbs_no_other(key, name):
    """x⁺ = 1e10 x + u from x0 = 0.01, 0, 1 with u = 0: the first is infinite after 5 steps, the last after 4."""
    physics = lgssm(A=[[1e10]], B=[[1.0]], C=[[1.0]])
    model = build_model(
        ModelSpec(networks=False) if name == "physics" else spec(name, start_from_physics=True), physics
    )
    scaling = Scaling(identity(1), identity(1), identity(1))
    params = ModelParams(model.init(key), physics.params, scaling)
    run = quick_jit(lambda x0: rollout(model, params, jnp.zeros((3, 9, 1)), x0))
    found = run(jnp.array([[1e-2], [0.0], [1.0]]))
    calm = run(jnp.zeros((3, 1)))
    # with feedback the networks overflow no earlier than the state they see
    assert found.first_bad.tolist() == [4, 9, 3]
    assert found.first_bad.dtype == jnp.int32
    assert calm.first_bad.tolist() == [9, 9, 9]
    np.testing.assert_array_equal(found.x[1], calm.x[1])
    np.testing.assert_array_equal(found.y[1], calm.y[1])
    assert np.isfinite(found.x[2, :3]).all()
    assert not np.isfinite(found.x[2, 3]).any()


def test_an_output_that_is_not_finite_counts_though_the_state_is():
    """y = 1 / u: infinite at the third sample alone; not a number at the first."""
    physics = discrete(
        "inverse",
        lambda p, x, u: x,
        lambda p, x, u: x / u,
        {},
        states=(Signal("x"),),
        inputs=(Signal("u"),),
        outputs=(Signal("y"),),
        dt=1.0,
    )
    u = jnp.array([[1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0]])[..., None]
    found = alone(physics, u, jnp.array([[1.0], [0.0], [1.0]]))
    assert found.first_bad.tolist() == [2, 0, 4]
    assert np.isfinite(found.x).all()


def test_a_bad_start_is_seen_at_once(key):
    model = toy_model(spec("PG-RSSNN"))
    u, x0 = toy_signals()
    found = compiled_rollout(model)(toy_params(model, key), u, x0.at[1].set(jnp.nan))
    assert found.first_bad.tolist() == [7, 0, 7]
