import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from toys import (
    GUIDED,
    PUBLISHED,
    TOY_SCALING,
    quick_jit,
    small_record,
    spec,
    toy_model,
    toy_params,
    toy_physics,
    toy_signals,
)

from pgrssnn_jax.models.initial_state import first_output_states
from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.scaling import fit_scaling, model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.simulate import first_output_state
from pgrssnn_jax.physics.tanks import cascaded_tanks

DRAW = np.random.default_rng(5)
TRAIN = small_record(DRAW.normal(size=(2, 12, 2)), DRAW.normal(3.0, 2.0, size=(2, 12, 2)))


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_variants_build_and_start_anywhere_but_at_zero(key, name):
    model = toy_model(spec(name))
    assert (model.spec, model.n_x) == (spec(name), 3)
    state = model.init(key)
    assert all(np.isfinite(a).all() and np.asarray(a).any() for a in jax.tree.leaves(state))
    networks = model.networks(ModelParams(state, model.physics.params, TOY_SCALING))
    assert len(networks.gru) == (0 if name.endswith(("FCSSNN", "FCSSNN-sgm")) else 1)
    assert networks.features_u.activation == ("sigmoid" if name.endswith("-sgm") else "relu")


def test_ten_variants_are_ten_different_models():
    assert len({spec(name) for name in PUBLISHED}) == 10
    assert len(GUIDED) == 5


def test_physics_alone_has_no_networks(key):
    model = build_model(ModelSpec(networks=False), cascaded_tanks())
    assert model.graph is None
    assert model.init(key) == {}
    assert model.networks(ModelParams({}, model.physics.params, TOY_SCALING)) is None
    assert model.n_x == 2


def exact_physics():
    """A linear system whose numbers are sums of few powers of two: single precision rounds nothing, so that two
    programs can differ by what the networks add alone, and not by how the compiler contracts products."""
    a, b = [[0.5, 0.25, 0.0], [-0.25, 0.5, 0.5], [0.0, -0.5, 0.25]], [[1.0, 0.0], [0.0, -1.0], [0.5, 2.0]]
    c = [[1.0, 0.0, 0.5], [0.0, 2.0, 0.0]]
    return lgssm(A=a, B=b, C=c, inputs=("f", "g"), outputs=("p", "q"))


@pytest.mark.parametrize(("name", "route"), [*((name, None) for name in GUIDED), ("PG-RSSNN", "fused")])
def test_start_from_physics_is_the_physics_to_the_last_bit(key, name, route):
    draw = np.random.default_rng(0)
    u, x0 = (jnp.asarray(draw.integers(-8, 8, shape), jnp.float32) for shape in ((3, 5, 2), (3, 3)))
    alone = build_model(ModelSpec(networks=False), exact_physics())
    guided = [build_model(spec(name, start_from_physics=zero), exact_physics()) for zero in (True, False)]

    @quick_jit
    def runs(bare, params, u, x0):
        with_networks = (rollout(m, p, u, x0, route=route) for m, p in zip(guided, params, strict=True))
        return rollout(alone, bare, u, x0), *with_networks

    expected, *both = runs(toy_params(alone, key), [toy_params(m, key) for m in guided], u, x0)
    for zero, found in zip((True, False), both, strict=True):
        # and it is the heads that do it
        assert np.array_equal(found.x, expected.x) == np.array_equal(found.y, expected.y) == zero


def test_start_from_physics_still_learns(key):
    """Zero heads must not be a saddle: the heads' last layers get a gradient at once."""
    model = toy_model(spec("PG-RSSNN", start_from_physics=True))
    u, x0 = toy_signals()
    params = toy_params(model, key)
    gradient = quick_jit(jax.grad(lambda w: jnp.sum(rollout(model, params._replace(network=w), u, x0).y ** 2)))
    slope = nnx.to_pure_dict(gradient(params.network))
    assert all(np.asarray(slope[head]["second"]["bias"]).any() for head in ("head_x", "head_y"))


def test_one_key_is_one_set_of_weights(key):
    model = toy_model(spec("PG-RSSNN"))
    again, other = toy_model(spec("PG-RSSNN")).init(key), model.init(jax.random.fold_in(key, 1))
    for a, b, c in zip(*(jax.tree.leaves(w) for w in (model.init(key), again, other)), strict=True):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)


def test_init_is_the_same_compiled_and_over_members(key):
    model, keys = toy_model(spec("FCSSNN")), jax.random.split(key, 2)
    together = quick_jit(jax.vmap(model.init))(keys)
    for i in range(2):
        for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(model.init(keys[i])), strict=True):
            np.testing.assert_allclose(a[i], b, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", ["PG-RSSNN", "FCSSNN-sgm"])
def test_networks_are_put_together_from_their_weights(key, name):
    model = toy_model(spec(name, gru_layers=2))
    state = model.init(key)
    networks = model.networks(ModelParams(state, model.physics.params, TOY_SCALING))
    graph, again = nnx.split(networks)
    assert graph == model.graph
    assert jax.tree.structure(again) == jax.tree.structure(state)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(state), strict=True):
        np.testing.assert_array_equal(a, b)


def test_nothing_but_init_draws_a_number(key):
    """A rollout has no key to draw with, and gives the same numbers each time."""
    model = toy_model(spec("PG-RSSNN"))
    kinds = {type(v) for _, v in nnx.to_flat_state(nnx.state(model.networks(toy_params(model, key))))}
    assert kinds == {nnx.Param}
    u, x0 = toy_signals()
    run = jax.jit(lambda params: rollout(model, params, u, x0).y)
    first, second = (run(toy_params(model, key)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("fields", [{}, {"networks": False}, {"feedback": True}])
def test_a_model_needs_physics_or_networks(fields):
    if fields.get("networks", True):
        build_model(ModelSpec(guided=False, **fields), toy_physics())
        return
    with pytest.raises(ValueError, match="guided and networks: expected at least one .*found both false"):
        build_model(ModelSpec(guided=False, **fields), toy_physics())


@pytest.mark.parametrize(("fields", "found"), [({"hidden": 0}, "0 and 1"), ({"gru_layers": 0}, "16 and 0")])
def test_sizes_are_named(fields, found):
    with pytest.raises(ValueError, match=f"hidden and gru_layers: expected at least 1, found {found}"):
        build_model(ModelSpec(**fields), toy_physics())


def test_scaling_of_a_guided_model_is_that_of_its_physics():
    model = toy_model(spec("PG-RSSNN"))
    expected = fit_scaling(TRAIN, model.physics)
    for a, b in zip(*(jax.tree.leaves(s) for s in (model_scaling(model, TRAIN), expected)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_scaling_of_a_black_box_leaves_its_states_alone():
    scaling = model_scaling(toy_model(spec("RSSNN")), TRAIN)
    np.testing.assert_array_equal(scaling.x.offset, np.zeros(3))
    np.testing.assert_array_equal(scaling.x.scale, np.ones(3))
    np.testing.assert_allclose(scaling.y.offset, TRAIN.y.mean((0, 1)), rtol=1e-12)


def test_states_like_an_output_start_at_its_first_value():
    one = small_record(np.array([[2.5, -1.0]]), np.array([[2.5, -1.0]]))
    guided, black_box = (toy_model(spec(name)) for name in ("PG-RSSNN", "RSSNN"))
    np.testing.assert_array_equal(first_output_states(guided, one), [[2.5, 0.0, 0.0]])
    np.testing.assert_array_equal(first_output_states(black_box, one), [[0.0, 0.0, 0.0]])
    y = np.array([[2.5]])
    np.testing.assert_array_equal(first_output_state(cascaded_tanks(), y, y), [[2.5, 2.5]])
    np.testing.assert_array_equal(first_output_state(cascaded_tanks(), jnp.asarray(y), jnp.asarray(y)), [[2.5, 2.5]])
