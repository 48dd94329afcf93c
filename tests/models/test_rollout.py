"""Rollouts against the published equations written out in NumPy, for any number of samples, sequences and members."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from toys import (
    PUBLISHED,
    TOY_PARAMS,
    WITHOUT_FEEDBACK,
    compiled_rollout,
    in_parts,
    quick_jit,
    spec,
    toy_measure,
    toy_model,
    toy_params,
    toy_signals,
    toy_step,
)

from pgrssnn_jax.models.rollout import rollout


def by_hand(name, weights, scaling, u, x0, output_timing="after_step"):
    """x_t = f_phy(x_{t-1}, u_t) + s_x f_nn(u_t; h_{t-1}), y_t = g_phy(x_t, u_t) + s_y g_nn(x_t, u_t) for one sequence.

    `name` alone says what the variant is: PG- guided, FC without GRU and fed back, (fb) fed back, -sgm sigmoid.
    """
    guided, recurrent = name.startswith("PG-"), "FC" not in name
    fed_back = "(fb)" in name or "FC" in name

    def act(a):
        return 1 / (1 + np.exp(-a)) if name.endswith("-sgm") else np.maximum(a, 0)

    def dense(part, z):
        first, second = weights[part]["first"], weights[part]["second"]
        return act(z @ first["kernel"] + first["bias"]) @ second["kernel"] + second["bias"]

    def scaled(affine, a):
        return (a - affine.offset) / affine.scale

    layers = [weights["gru"][i] for i in sorted(weights["gru"])] if recurrent else []
    hidden = len(weights["mixer"]["first"]["bias"])
    h = [np.zeros(hidden) for _ in layers]
    x, xs, ys = x0, [], []
    for u_t in u:
        before, seen = x, scaled(scaling.u, u_t)
        if fed_back:
            seen = np.concatenate([seen, scaled(scaling.x, before)])
        phi = dense("features_u", seen)
        f_nn = dense("head_x", dense("mixer", np.concatenate([h[-1], phi]) if recurrent else phi))
        x = (toy_step(TOY_PARAMS, before, u_t) if guided else 0) + scaling.x.scale * f_nn
        below = phi
        for i, layer in enumerate(layers):
            (i_r, i_z, i_n), (h_r, h_z, h_n) = (
                np.split(a @ layer[f"{side}_kernel"] + layer.get(f"{side}_bias", 0.0), 3)
                for a, side in ((below, "input"), (h[i], "hidden"))
            )
            r, z = 1 / (1 + np.exp(-(i_r + h_r))), 1 / (1 + np.exp(-(i_z + h_z)))
            h[i] = (1 - z) * np.tanh(i_n + r * h_n) + z * h[i]
            below = h[i]
        read = x if output_timing == "after_step" else before
        g_nn = dense("head_y", dense("features_x", np.concatenate([scaled(scaling.u, u_t), scaled(scaling.x, read)])))
        y = toy_measure(TOY_PARAMS, read, u_t) if guided else scaling.y.offset
        xs.append(x)
        ys.append(y + scaling.y.scale * g_nn)
    return np.array(xs), np.array(ys)


def expected_of(name, params, u, x0, output_timing="after_step"):
    params = jax.tree.map(lambda a: np.asarray(a, np.float64), params)
    weights = nnx.to_pure_dict(params.network)
    both = [
        by_hand(name, weights, params.scaling, *seq, output_timing)
        for seq in zip(np.asarray(u), np.asarray(x0), strict=True)
    ]
    return tuple(np.stack(a) for a in zip(*both, strict=True))


def by_routes(name, model, params, u, x0):
    """Of every route that the model can go, by one program."""
    routes = ["fused", "split"] if name in WITHOUT_FEEDBACK else ["fused", None]
    return quick_jit(lambda *args: [rollout(model, *args, route=route) for route in routes])(params, u, x0)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", in_parts(PUBLISHED))
def test_rollout_equals_the_published_equations(key, name):
    model = toy_model(spec(name))
    params, (u, x0) = toy_params(model, key, jnp.float64), toy_signals(dtype=jnp.float64)
    x, y = expected_of(name, params, u, x0)
    for found in by_routes(name, model, params, u, x0):
        np.testing.assert_allclose(found.x, x, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(found.y, y, rtol=1e-11, atol=1e-12)
        assert found.first_bad.tolist() == [7, 7, 7]
        assert found.y.dtype == jnp.float64


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", ["PG-RSSNN", "RSSNN(fb)"])
def test_stacked_grus_with_biases_and_early_reading_equal_the_equations(key, name):
    model = toy_model(spec(name, gru_layers=3, gru_bias=True), output_timing="before_step")
    params, (u, x0) = toy_params(model, key, jnp.float64), toy_signals(2, 5, jnp.float64)
    x, y = expected_of(name, params, u, x0, "before_step")
    for found in by_routes(name, model, params, u, x0):
        np.testing.assert_allclose(found.x, x, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(found.y, y, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("name", ["PG-RSSNN", "FCSSNN"])
@pytest.mark.parametrize(("n_seq", "n_time"), [(1, 1), (3, 1)])
def test_one_sample_and_one_sequence(key, name, n_seq, n_time):
    model = toy_model(spec(name))
    params, (u, x0) = toy_params(model, key), toy_signals(n_seq, n_time)
    x, y = expected_of(name, params, u, x0)
    for found in by_routes(name, model, params, u, x0):
        assert (found.y.shape, found.x.shape, found.first_bad.shape) == (
            (n_seq, n_time, 2),
            (n_seq, n_time, 3),
            (n_seq,),
        )
        np.testing.assert_allclose(found.x, x, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(found.y, y, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["PG-RSSNN", "PG-FCSSNN", "RSSNN-sgm"])
def test_sequences_do_not_see_each_other_nor_the_future(key, name):
    model = toy_model(spec(name))
    params, (u, x0) = toy_params(model, key), toy_signals()
    run = quick_jit(lambda u, x0: rollout(model, params, u, x0))
    found = run(u, x0)
    other = run(u.at[1].multiply(-3.0), x0.at[1].add(1.0))
    late = run(u.at[:, 4:].add(1.0), x0)
    for a, b, c in zip(found[:2], other[:2], late[:2], strict=True):
        np.testing.assert_array_equal(a[::2], b[::2])
        assert not np.allclose(a[1], b[1])
        np.testing.assert_array_equal(a[:, :4], c[:, :4])
        assert (np.abs(a[:, 4] - c[:, 4]) > 1e-6).any(-1).all()


@pytest.mark.parametrize("name", ["PG-RSSNN", "PG-FCSSNN"])
def test_members_under_vmap_are_single_runs(key, name):
    model, (u, x0) = toy_model(spec(name)), toy_signals()
    members = [toy_params(model, k) for k in jax.random.split(key, 3)]

    def run(params):
        return rollout(model, params, u, x0)

    together, single = quick_jit(jax.vmap(run))(jax.tree.map(lambda *a: jnp.stack(a), *members)), quick_jit(run)
    for i, params in enumerate(members):
        for a, b in zip(together, single(params), strict=True):
            np.testing.assert_allclose(a[i], b, rtol=1e-5, atol=1e-5)


def test_numpy_signals_are_taken_as_they_are(key):
    model = toy_model(spec("PG-RSSNN"))
    params, (u, x0) = toy_params(model, key), toy_signals()
    found = quick_jit(lambda params: rollout(model, params, np.asarray(u), np.asarray(x0)))(params)
    expected = compiled_rollout(model)(params, u, x0)
    np.testing.assert_allclose(found.y, expected.y, rtol=1e-5, atol=1e-6)


def test_zero_input_from_zero_state_is_what_the_biases_make_of_it(key):
    name = "PG-RSSNN"
    model = toy_model(spec(name))
    params = toy_params(model, key)
    u, x0 = jnp.zeros((1, 5, 2)), jnp.zeros((1, 3))
    x, y = expected_of(name, params, u, x0)
    found = compiled_rollout(model)(params, u, x0)
    np.testing.assert_allclose(found.x, x, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found.y, y, rtol=1e-5, atol=1e-5)
