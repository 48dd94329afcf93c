"""Rollouts are compiled once per shape, and their gradients are right, padded samples or not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from toys import (
    PUBLISHED,
    WITHOUT_FEEDBACK,
    in_parts,
    quick_jit,
    spec,
    toy_model,
    toy_params,
    toy_physics,
    toy_signals,
)

from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.scaling import Affine, Scaling


def test_one_compilation_per_shape(key):
    physics, traced = toy_physics(), []

    def step(p, x, u):
        traced.append(x.shape)
        return physics.step(p, x, u)

    model = build_model(spec("PG-RSSNN"), physics._replace(step=step))
    run = jax.jit(lambda params, u, x0: rollout(model, params, u, x0))
    u, x0 = toy_signals()
    run(toy_params(model, key), u, x0)
    once = len(traced)
    assert once > 0
    for i in range(3):  # other weights, physics, scaling and signals of the same shape
        params = toy_params(model, jax.random.fold_in(key, i))
        run(jax.tree.map(lambda a: 1.1 * a, params), u + i, x0)
    assert len(traced) == once
    run(toy_params(model, key), u[:, :4], x0)
    assert len(traced) > once


@pytest.mark.parametrize("name", in_parts(PUBLISHED))
def test_gradients_are_finite_and_reach_every_part(key, name):
    """Also where every input and state is zero, the kinks of relu included."""
    model = toy_model(spec(name))
    params, (u, x0) = toy_params(model, key), toy_signals(2, 5)
    gradient = quick_jit(jax.grad(lambda params, u, x0: jnp.sum(rollout(model, params, u, x0).y ** 2), (0, 2)))
    for signals in ((u, x0), (jnp.zeros_like(u), jnp.zeros_like(x0))):
        slopes = gradient(params, *signals)
        assert all(np.isfinite(a).all() for a in jax.tree.leaves(slopes))
    slopes, to_start = gradient(params, u, x0)
    for part, tree in nnx.to_pure_dict(slopes.network).items():
        assert all(np.asarray(a).any() for a in jax.tree.leaves(tree)), part
    guided, fed_back = name.startswith("PG-"), name not in WITHOUT_FEEDBACK
    assert bool(np.asarray(slopes.physics["gain"]).any()) == guided
    assert bool(np.asarray(to_start).any()) == (guided or fed_back)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", ["PG-RSSNN-sgm", "PG-FCSSNN-sgm"])
def test_gradient_to_the_physics_equals_finite_differences(key, name):
    model = toy_model(spec(name))
    params, (u, x0) = toy_params(model, key, jnp.float64), toy_signals(dtype=jnp.float64)

    def loss(gain):
        physics = {**params.physics, "gain": gain}
        return jnp.sum(rollout(model, params._replace(physics=physics), u, x0).y ** 2)

    slope, value, h = quick_jit(jax.grad(loss))(0.3), quick_jit(loss), 1e-6
    np.testing.assert_allclose(slope, (value(0.3 + h) - value(0.3 - h)) / (2 * h), rtol=1e-6)


@pytest.mark.parametrize("route", ["fused", pytest.param("split", marks=pytest.mark.compiles)])
def test_padding_holds_the_state_and_spoils_no_gradient(key, route):
    """An unstable system runs out of the floating-point range in 400 samples of padding, were it not held."""
    unstable = lgssm(A=[[1.3]], B=[[1.0]], C=[[1.0]])
    model = build_model(ModelSpec(hidden=3), unstable)
    one, zero = np.ones(1), np.zeros(1)
    scaling = Scaling(Affine(zero, one), Affine(zero, one), Affine(zero, one))
    u = jnp.ones((1, 420, 1), jnp.float32)
    real = jnp.arange(420)[None] < 20

    def loss(network, u, real):
        params = ModelParams(network, unstable.params, scaling)
        found = rollout(model, params, u, jnp.zeros((1, 1)), route=route, valid=real)
        return jnp.sum(found.y[:, :20] ** 2), found.first_bad

    gradient = quick_jit(jax.value_and_grad(loss, has_aux=True))
    weights = model.init(key)
    (padded, first_bad), padded_slope = gradient(weights, u, real)
    (alone, _), slope = gradient(weights, u[:, :20], real[:, :20])
    assert first_bad[0] == 420
    np.testing.assert_allclose(padded, alone, rtol=1e-5)
    for a, b in zip(jax.tree.leaves(padded_slope), jax.tree.leaves(slope), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3 * float(jnp.abs(b).max()))
    (_, not_held), _ = gradient(weights, u, jnp.ones_like(real))
    assert not_held[0] < 420
