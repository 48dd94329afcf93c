import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from toys import PUBLISHED, spec

from pgrssnn_jax.models.networks import ACTIVATIONS, Networks, TwoDense
from pgrssnn_jax.models.spec import ModelSpec

SIZES = {"n_u": 2, "n_x": 3, "n_y": 5}


def build(fields, key):
    return Networks(fields, **SIZES, rngs=nnx.Rngs(params=key))


def weights(module):
    return jax.tree.map(np.asarray, nnx.to_pure_dict(nnx.state(module, nnx.Param)))


def two_dense(n_in, hidden, n_out):
    return (n_in + 1) * hidden + (hidden + 1) * n_out


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize(("gru_layers", "gru_bias"), [(1, False), (3, True)])
def test_number_of_weights(key, name, gru_layers, gru_bias):
    fields = spec(name, gru_layers=gru_layers, gru_bias=gru_bias)
    n_u, n_x, n_y, h = 2, 3, 5, 4
    expected = two_dense(n_u + (n_x if fields.feedback else 0), h, h)  # φ_u
    expected += two_dense(2 * h if fields.recurrent else h, h, h) + two_dense(h, h, n_x)  # f_nn
    expected += two_dense(n_u + n_x, h, h) + two_dense(h, h, n_y)  # g_nn
    if fields.recurrent:
        expected += gru_layers * (3 * h * (h + h) + (6 * h if gru_bias else 0))
    found = jax.tree.leaves(nnx.state(jax.eval_shape(lambda: build(fields, key)), nnx.Param))
    assert sum(a.size for a in found) == expected


def test_published_sizes_are_the_defaults():
    assert ModelSpec() == ModelSpec(
        guided=True,
        networks=True,
        recurrent=True,
        feedback=False,
        activation="relu",
        hidden=16,
        gru_layers=1,
        gru_bias=False,
        start_from_physics=False,
    )


@pytest.mark.parametrize(
    ("activation", "formula"), [("relu", lambda a: np.maximum(a, 0)), ("sigmoid", lambda a: 1 / (1 + np.exp(-a)))]
)
def test_two_dense_has_one_activation_between(key, activation, formula):
    dense = TwoDense(3, 6, 2, activation, rngs=nnx.Rngs(params=key))
    w = weights(dense)
    z = np.random.default_rng(0).normal(size=(4, 5, 3)).astype(np.float32)
    inner = formula(z @ w["first"]["kernel"] + w["first"]["bias"])
    expected = inner @ w["second"]["kernel"] + w["second"]["bias"]
    np.testing.assert_allclose(dense(jnp.asarray(z)), expected, rtol=1e-5, atol=1e-6)
    assert (expected < 0).any()  # the last layer is linear


def test_activations_are_the_published_two():
    assert sorted(ACTIVATIONS) == ["relu", "sigmoid"]


def test_weights_start_uniform_in_one_over_root_n_in(key):
    n_in, hidden, n_out = 25, 64, 30
    w = weights(TwoDense(n_in, hidden, n_out, "relu", rngs=nnx.Rngs(params=key)))
    for layer, fan_in in (("first", n_in), ("second", hidden)):
        bound = fan_in**-0.5
        for a in w[layer].values():
            assert np.abs(a).max() <= bound
            assert np.abs(a).max() > 0.9 * bound
            np.testing.assert_allclose(np.std(a), bound / 3**0.5, rtol=0.2)
    assert not np.array_equal(w["first"]["bias"][:30], w["second"]["bias"])


def test_every_weight_of_a_model_is_drawn_by_itself(key):
    networks = build(spec("PG-RSSNN", gru_layers=2, gru_bias=True), key)
    drawn = np.concatenate([np.ravel(a) for a in jax.tree.leaves(weights(networks))])
    assert len(np.unique(drawn)) > 0.99 * len(drawn)


def test_start_from_physics_zeroes_the_last_layers_of_the_heads_alone(key):
    free, zero = (weights(build(spec("PG-RSSNN", start_from_physics=s), key)) for s in (False, True))
    for head in ("head_x", "head_y"):
        for name in ("kernel", "bias"):
            assert not zero[head]["second"][name].any()
            assert free[head]["second"][name].all()
            assert zero[head]["first"][name].all()
    for part in ("features_u", "features_x", "mixer", "gru"):
        assert all(np.asarray(a).all() for a in jax.tree.leaves(zero[part]))


def test_f_nn_sees_the_gru_state_first_and_the_features_second(key):
    networks = build(spec("RSSNN"), key)
    h, phi = jax.random.normal(key, (2, 6, 4))
    expected = networks.head_x(networks.mixer(jnp.concatenate([h, phi], -1)))
    np.testing.assert_array_equal(networks.f_nn(h, phi), expected)
    assert networks.f_nn(h, phi).shape == (6, 3)
    assert not np.allclose(networks.f_nn(phi, h), expected)
    dense = build(spec("FCSSNN"), key)
    np.testing.assert_array_equal(dense.f_nn(None, phi), dense.head_x(dense.mixer(phi)))
    assert len(dense.gru) == 0


def test_a_correction_shrinks_f_nn_alone(key):
    full, small = (build(spec("PG-RSSNN", correction=c), key) for c in (1.0, 0.01))
    h, phi = jax.random.normal(key, (2, 6, 4))
    np.testing.assert_allclose(small.f_nn(h, phi), 0.01 * full.f_nn(h, phi), rtol=1e-6)
    x, u = jax.random.normal(key, (6, 3)), jax.random.normal(key, (6, 2))
    np.testing.assert_array_equal(small.g_nn(x, u), full.g_nn(x, u))


def test_a_black_box_takes_no_notice_of_what_belongs_to_the_physics(key):
    plain, other = (
        build(spec("RSSNN", **more), key) for more in ({}, {"correction": 0.01, "start_from_physics": True})
    )
    h, phi = jax.random.normal(key, (2, 6, 4))
    np.testing.assert_array_equal(plain.f_nn(h, phi), other.f_nn(h, phi))


def test_g_nn_sees_the_input_first_and_the_state_second(key):
    networks = build(spec("RSSNN"), key)
    x, u = jax.random.normal(key, (6, 3)), jax.random.normal(key, (6, 2))
    expected = networks.head_y(networks.features_x(jnp.concatenate([u, x], -1)))
    np.testing.assert_array_equal(networks.g_nn(x, u), expected)
    assert expected.shape == (6, 5)
