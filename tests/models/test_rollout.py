"""Rollouts against the published equations written out in NumPy, and each route against the other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from toys import (
    PUBLISHED,
    TOY_PARAMS,
    WITHOUT_FEEDBACK,
    quick_jit,
    spec,
    toy_measure,
    toy_model,
    toy_params,
    toy_signals,
    toy_step,
)

from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.scaling import Scaling, identity

# --- the equations, sample by sample and without the package ----------------------------------------------------------


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


def compiled(model, route=None):
    return quick_jit(lambda params, u, x0: rollout(model, params, u, x0, route=route))


def routes(name):
    return ["fused", "split"] if name in WITHOUT_FEEDBACK else ["fused", None]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", PUBLISHED)
def test_rollout_equals_the_published_equations(key, name):
    model = toy_model(spec(name))
    params, (u, x0) = toy_params(model, key, jnp.float64), toy_signals(dtype=jnp.float64)
    x, y = expected_of(name, params, u, x0)
    for route in routes(name):
        found = compiled(model, route)(params, u, x0)
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
    for route in routes(name):
        found = compiled(model, route)(params, u, x0)
        np.testing.assert_allclose(found.x, x, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(found.y, y, rtol=1e-11, atol=1e-12)


# --- the two routes ---------------------------------------------------------------------------------------------------


SPECS = {
    **{name: spec(name) for name in WITHOUT_FEEDBACK},
    "two layers with biases": spec("PG-RSSNN", gru_layers=2, gru_bias=True),
    "dense": ModelSpec(
        recurrent=False, hidden=4
    ),  # guided without GRU and feedback: not published, but can be asked for
    "physics": ModelSpec(networks=False),
}


@pytest.mark.parametrize("fields", SPECS.values(), ids=SPECS)
def test_routes_agree_in_single_precision(key, fields):
    model = toy_model(fields)
    params, (u, x0) = toy_params(model, key), toy_signals()
    fused, split = (compiled(model, route)(params, u, x0) for route in ("fused", "split"))
    for a, b in zip(fused, split, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-6)


@pytest.mark.parametrize("name", ["two layers with biases", "RSSNN-sgm", "dense", "physics"])
def test_gradients_of_the_routes_agree(key, name):
    model = toy_model(SPECS[name])
    params, (u, x0) = toy_params(model, key), toy_signals()
    target = jnp.asarray(np.random.default_rng(0).normal(size=(3, 7, 2)), jnp.float32)

    def slopes(route):
        def loss(*args):
            return jnp.sum((rollout(model, *args, route=route).y - target) ** 2)

        return jax.tree.leaves(quick_jit(jax.grad(loss, (0, 1, 2)))(params, u, x0))

    for a, b in zip(slopes("fused"), slopes("split"), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-4, atol=2e-5 * max(1.0, np.abs(a).max()))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", ["PG-RSSNN", "RSSNN-sgm"])
def test_single_precision_weights_take_double_precision_signals(key, name):
    """Weights as `init` draws them, everything else double: both routes promote, to the same numbers."""
    model = toy_model(spec(name))
    u, x0 = toy_signals(dtype=jnp.float64)
    params = toy_params(model, key, jnp.float64)._replace(network=model.init(key))
    assert {a.dtype for a in jax.tree.leaves(params.network)} == {jnp.dtype(jnp.float32)}
    fused, split = (compiled(model, route)(params, u, x0) for route in ("fused", "split"))
    assert fused.y.dtype == split.y.dtype == jnp.float64
    np.testing.assert_allclose(fused.y, split.y, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(fused.x, split.x, rtol=1e-12, atol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    "route",
    [
        "fused",
        "split",
    ],
)
def test_gradients_have_the_precision_of_the_weights(key, route):
    model = toy_model(spec("PG-RSSNN"))
    u, x0 = toy_signals(dtype=jnp.float64)
    params = toy_params(model, key, jnp.float64)

    def loss(weights):
        return rollout(model, params._replace(network=weights), u, x0, route=route).y.sum()

    slopes = quick_jit(jax.grad(loss))(model.init(key))
    assert {a.dtype for a in jax.tree.leaves(slopes)} == {jnp.dtype(jnp.float32)}


@pytest.mark.parametrize("name", [n for n in PUBLISHED if n not in WITHOUT_FEEDBACK])
def test_feedback_cannot_be_split(key, name):
    model = toy_model(spec(name))
    with pytest.raises(ValueError, match="route: expected 'fused' for a model with state feedback, found 'split'"):
        rollout(model, toy_params(model, key), *toy_signals(), route="split")


def test_without_a_wish_the_route_is_split_where_it_can_be(key):
    """Seen in the program: the split route scans physics and each GRU apart, the fused one scans once."""
    scans = {}
    for name in ("PG-RSSNN", "PG-RSSNN(fb)", "RSSNN"):
        model = toy_model(spec(name))
        program = str(jax.make_jaxpr(lambda *a, m=model: rollout(m, *a))(toy_params(model, key), *toy_signals()))
        scans[name] = program.count("= scan[")
    assert scans == {"PG-RSSNN": 2, "PG-RSSNN(fb)": 1, "RSSNN": 1}


# --- shapes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["PG-RSSNN", "FCSSNN"])
@pytest.mark.parametrize(("n_seq", "n_time"), [(1, 1), (3, 1)])
def test_one_sample_and_one_sequence(key, name, n_seq, n_time):
    model = toy_model(spec(name))
    params, (u, x0) = toy_params(model, key), toy_signals(n_seq, n_time)
    x, y = expected_of(name, params, u, x0)
    for route in routes(name):
        found = compiled(model, route)(params, u, x0)
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
    run = jax.jit(lambda u, x0: rollout(model, params, u, x0))
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

    together = jax.jit(jax.vmap(run))(jax.tree.map(lambda *a: jnp.stack(a), *members))
    for i, params in enumerate(members):
        for a, b in zip(together, jax.jit(run)(params), strict=True):
            np.testing.assert_allclose(a[i], b, rtol=1e-5, atol=1e-5)


def test_numpy_signals_are_taken_as_they_are(key):
    model = toy_model(spec("PG-RSSNN"))
    params, (u, x0) = toy_params(model, key), toy_signals()
    found = rollout(model, params, np.asarray(u), np.asarray(x0))
    expected = compiled(model)(params, u, x0)
    np.testing.assert_allclose(found.y, expected.y, rtol=1e-5, atol=1e-6)


def test_zero_input_from_zero_state_is_what_the_biases_make_of_it(key):
    name = "PG-RSSNN"
    model = toy_model(spec(name))
    params = toy_params(model, key)
    u, x0 = jnp.zeros((1, 5, 2)), jnp.zeros((1, 3))
    x, y = expected_of(name, params, u, x0)
    found = compiled(model)(params, u, x0)
    np.testing.assert_allclose(found.x, x, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found.y, y, rtol=1e-5, atol=1e-5)
    still = lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]])
    assert not alone(still, jnp.zeros((1, 5, 1)), jnp.zeros((1, 2))).y.any()


# --- when the plant is read -------------------------------------------------------------------------------------------


def alone(physics, u, x0):
    scaling = Scaling(*(identity(len(s)) for s in (physics.inputs, physics.states, physics.outputs)))
    model = build_model(ModelSpec(networks=False), physics)
    return rollout(model, ModelParams({}, physics.params, scaling), u, x0)


def test_a_plant_read_before_the_step_is_one_sample_late():
    late = lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]])
    u, x0 = jnp.ones((2, 6, 1)), jnp.array([[1.0, 2.0], [0.0, -1.0]])
    after, before = alone(late, u, x0), alone(late._replace(output_timing="before_step"), u, x0)
    np.testing.assert_array_equal(after.x, before.x)
    np.testing.assert_array_equal(before.y[:, 1:], after.y[:, :-1])
    np.testing.assert_array_equal(before.y[:, 0], x0[:, :1])
    np.testing.assert_array_equal(alone(late._replace(output_timing="before_step"), u[:, :1], x0).y[:, 0], x0[:, :1])


# --- status -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["PG-RSSNN", "PG-RSSNN(fb)", "physics"])
def test_a_state_that_leaves_the_range_is_reported_and_disturbs_no_other(key, name):
    """x⁺ = 1e10 x + u from x0 = 0.01, 0, 1 with u = 0: the first is infinite after 5 steps, the last after 4."""
    physics = lgssm(A=[[1e10]], B=[[1.0]], C=[[1.0]])
    model = build_model(
        ModelSpec(networks=False) if name == "physics" else spec(name, start_from_physics=True), physics
    )
    scaling = Scaling(identity(1), identity(1), identity(1))
    params = ModelParams(model.init(key), physics.params, scaling)
    run = jax.jit(lambda x0: rollout(model, params, jnp.zeros((3, 9, 1)), x0))
    found = run(jnp.array([[1e-2], [0.0], [1.0]]))
    calm = run(jnp.zeros((3, 1)))
    # with feedback the networks overflow no later than the state they see
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
    found = compiled(model)(toy_params(model, key), u, x0.at[1].set(jnp.nan))
    assert found.first_bad.tolist() == [7, 0, 7]
