"""The routes of a rollout give the same numbers, gradients and precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import (
    PUBLISHED,
    WITHOUT_FEEDBACK,
    compiled_rollout,
    quick_jit,
    spec,
    toy_model,
    toy_params,
    toy_signals,
)  # fmt: skip

from pgrssnn_jax.acceleration.native import missing_kernels
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.spec import ModelSpec

SPECS = {
    **{name: spec(name) for name in WITHOUT_FEEDBACK},
    "two layers with biases": spec("PG-RSSNN", gru_layers=2, gru_bias=True),
    "dense": ModelSpec(recurrent=False, hidden=4),  # neither GRU nor feedback: not published, but can be asked for
    "physics": ModelSpec(networks=False),
}


#: the first one is compared with all others
ROUTES = ("fused", "split", *(["native"] if missing_kernels() is None else []))


def one_of_a_kind(*names: str):
    """The others run the same lines again, here and in tests of the rollout."""
    return [name if name in names else pytest.param(name, marks=pytest.mark.compiles) for name in SPECS]


@pytest.mark.parametrize("name", one_of_a_kind("PG-RSSNN", "RSSNN-sgm", "two layers with biases", "dense", "physics"))
def test_routes_agree_in_single_precision(key, name):
    model = toy_model(SPECS[name])
    params, (u, x0) = toy_params(model, key), toy_signals()
    fused, *others = (compiled_rollout(model, route)(params, u, x0) for route in ROUTES)
    for other in others:
        for a, b in zip(fused, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-6)


# 7 samples: one by one, with a rest, and in more than there are
@pytest.mark.parametrize(("name", "output_timing", "chunk"), [
    pytest.param("two layers with biases", "after_step", 3, marks=pytest.mark.compiles),
    pytest.param("two layers with biases", "before_step", 1, marks=pytest.mark.compiles),
    ("PG-RSSNN(fb)", "before_step", 3), ("RSSNN-sgm", "after_step", 3),
    pytest.param("dense", "before_step", 50, marks=pytest.mark.compiles),
    pytest.param("physics", "before_step", 3, marks=pytest.mark.compiles), ("PG-RSSNN", "after_step", "auto"),
])  # fmt: skip
def test_chunks_and_devices_change_nothing(key, name, chunk, output_timing):
    model = toy_model(SPECS.get(name) or spec(name))
    model = model._replace(physics=model.physics._replace(output_timing=output_timing))
    params, (u, x0) = toy_params(model, key), toy_signals()
    valid = jnp.arange(7)[None] < jnp.array([[7], [4], [1]])

    routes = ROUTES[:1] if model.spec.feedback else ROUTES
    ways = [{"route": route, "chunk": chunk, "devices": devices} for route in routes for devices in (1, 2)]

    def runs(*args):  # three sequences: one device has a copy of the last to compute
        return [rollout(model, *args, valid=valid, **how) for how in ({}, *ways)]

    # a black box's state is not held by every route
    whole, *others = ((run.y[valid], run.x[valid], run.first_bad) for run in quick_jit(runs)(params, u, x0))
    for other in others:
        for a, b in zip(whole, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-6)


@pytest.mark.compiles
def test_gradients_pass_from_chunk_to_chunk(key):
    model = toy_model(SPECS["two layers with biases"])
    params, (u, x0) = toy_params(model, key), toy_signals()

    def slopes(chunk, *args):
        return jax.grad(lambda *a: jnp.sum(rollout(model, *a, chunk=chunk).y ** 2), (0, 1, 2))(*args)

    both = quick_jit(lambda *args: [jax.tree.leaves(slopes(chunk, *args)) for chunk in (None, 3)])(params, u, x0)
    for a, b in zip(*both, strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-4, atol=2e-5 * max(1.0, np.abs(a).max()))


def test_a_chunk_may_be_one_sample(key):
    model = toy_model(SPECS["physics"])
    params, signals = toy_params(model, key), toy_signals()
    np.testing.assert_allclose(
        rollout(model, params, *signals, chunk=1).y, rollout(model, params, *signals).y, rtol=1e-5
    )


@pytest.mark.parametrize(("how", "said"), [
    ({"chunk": 0}, "rollout: chunk: expected at least 1 sample, 'auto' or None, found 0"),
    ({"devices": 9}, "rollout: devices: expected 1 to 2, found 9"),
])  # fmt: skip
def test_chunks_and_devices_that_cannot_be_are_refused(key, how, said):
    model = toy_model(spec("PG-RSSNN"))
    with pytest.raises(ValueError, match=said):
        rollout(model, toy_params(model, key), *toy_signals(), **how)


def test_without_kernels_the_native_route_alone_is_refused(key, monkeypatch):
    monkeypatch.setattr("pgrssnn_jax.models.rollout.missing_kernels", lambda: "no compiler")
    model = toy_model(SPECS["physics"])
    params, signals = toy_params(model, key), toy_signals()
    with pytest.raises(ValueError, match="expected 'split' or None here, found 'native': no compiler"):
        rollout(model, params, *signals, route="native")
    assert np.isfinite(rollout(model, params, *signals, route="split").y).all()


@pytest.mark.parametrize("name", [
    "two layers with biases", *(pytest.param(n, marks=pytest.mark.compiles) for n in ("RSSNN-sgm", "dense")), "physics",
])  # fmt: skip
def test_gradients_of_the_routes_agree(key, name):
    model = toy_model(SPECS[name])
    params, (u, x0) = toy_params(model, key), toy_signals()
    target = jnp.asarray(np.random.default_rng(0).normal(size=(3, 7, 2)), jnp.float32)

    def slopes(route):
        def loss(*args):
            return jnp.sum((rollout(model, *args, route=route).y - target) ** 2)

        return jax.tree.leaves(quick_jit(jax.grad(loss, (0, 1, 2)))(params, u, x0))

    fused, *others = map(slopes, ROUTES)
    for other in others:
        for a, b in zip(fused, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-4, atol=2e-5 * max(1.0, np.abs(a).max()))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", ["PG-RSSNN", "RSSNN-sgm"])
def test_single_precision_weights_take_double_precision_signals(key, name):
    """Weights as `init` draws them, everything else double: both routes promote, to the same numbers."""
    model = toy_model(spec(name))
    u, x0 = toy_signals(dtype=jnp.float64)
    params = toy_params(model, key, jnp.float64)._replace(network=model.init(key))
    assert {a.dtype for a in jax.tree.leaves(params.network)} == {jnp.dtype(jnp.float32)}
    fused, split = (compiled_rollout(model, route)(params, u, x0) for route in ("fused", "split"))
    assert fused.y.dtype == split.y.dtype == jnp.float64
    np.testing.assert_allclose(fused.y, split.y, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(fused.x, split.x, rtol=1e-12, atol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("route", ["fused", "split"])
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
