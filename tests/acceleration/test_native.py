"""The C++ kernels against the forms of `models/`: values, gradients, failures, members, machines without them."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from toys import quick_jit

from pgrssnn_jax.acceleration.build import COMPILERS
from pgrssnn_jax.acceleration.native import gru_layer, missing_kernels, two_dense
from pgrssnn_jax.models.gru import gru_scan

needs_kernel = pytest.mark.skipif(missing_kernels() is not None, reason=f"no kernel: {missing_kernels()}")


def weights(hidden, time, sequences, *members, n_in=None, seed=0):
    draw, gates, n_in = np.random.default_rng(seed), 3 * hidden, n_in or hidden
    shapes = (n_in, gates), (gates,), (hidden, gates), (gates,), (time, sequences, n_in), (sequences, hidden)
    sizes = n_in**-0.5, 0.3, hidden**-0.5, 0.3, 1.0, 1.0
    drawn = (size * draw.normal(size=(*members, *shape)) for size, shape in zip(sizes, shapes, strict=True))
    return tuple(jnp.asarray(one, jnp.float32) for one in drawn)


def by_scan(input_kernel, input_bias, hidden_kernel, hidden_bias, phi, start):
    return gru_scan(hidden_kernel, hidden_bias, phi @ input_kernel + input_bias[None, None], start)


@quick_jit
def both_ways(arrays):
    """The states, and the gradients of a sum in which each has its own weight; by the kernel and by the scan."""

    def gradients(layer):
        return jax.grad(lambda a: jnp.sum(jnp.sin(3.0 * layer(*a)) ** 2))(arrays)

    return [(layer(*arrays), gradients(layer)) for layer in (gru_layer, by_scan)]


def agree(arrays):
    (states, gradients), (expected_states, expected_gradients) = both_ways(arrays)
    np.testing.assert_allclose(states, expected_states, rtol=0, atol=2e-6)
    for found, expected in zip(gradients, expected_gradients, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * (1 + np.abs(expected).max()))


HIDDEN, LENGTHS = (16, 64, 5, 22), ((1, 1), (130, 1), (64, 1), (9, 13), (3, 70))
#: every size and every length, each with two others at least
SIZES = [
    (length, hidden) if (i + j) % 3 == 0 else pytest.param(length, hidden, marks=pytest.mark.compiles)
    for i, length in enumerate(LENGTHS)
    for j, hidden in enumerate(HIDDEN)
]


# units: the two published sizes, one that fills no vector, one that fills some and leaves a rest; sequences: fewer and
# more than the rows of a block (up to 8) and of a chunk (64); time: a whole chunk, parts of one, a single step
@needs_kernel
@pytest.mark.parametrize(("length", "hidden"), SIZES)
def test_values_and_gradients_are_those_of_the_scan(length, hidden):
    agree(weights(hidden, *length))


@needs_kernel
def test_an_input_may_have_another_size_than_the_state():
    agree(weights(16, 40, 3, n_in=5))


@needs_kernel
def test_gradients_are_those_of_finite_differences():
    def layer(*arrays):
        return gru_layer(*map(jnp.asarray, arrays))

    check_grads(layer, weights(6, 5, 2), order=1, modes=["rev"], rtol=2e-2, atol=2e-2, eps=1e-2)


@needs_kernel
def test_gates_that_saturate_stay_finite_and_right():
    _, _, *layer, phi, start = weights(16, 20, 3, n_in=48)
    projection = jnp.eye(48), jnp.zeros(48)  # without rounding, which gates of such inputs would magnify
    (states, gradients), (expected, _) = both_ways((*projection, *layer, 200.0 * phi, start))
    np.testing.assert_allclose(states, expected, rtol=0, atol=2e-6)
    assert all(np.isfinite(g).all() for g in gradients)


@needs_kernel
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_shows_from_its_sample_on(bad):
    *layer, phi, start = weights(16, 12, 2)
    layer = [layer[0].at[3, 40].set(0.0), *layer[1:]]  # a unit that an infinite input makes NaN
    states = gru_layer(*layer, phi.at[7, 1, 3].set(bad), start)
    np.testing.assert_array_equal(np.isnan(states), np.isnan(by_scan(*layer, phi.at[7, 1, 3].set(bad), start)))
    assert np.isfinite(states[:7]).all()
    assert np.isfinite(states[:, 0]).all()
    assert not np.isfinite(states[7:, 1]).all(-1).any()


@needs_kernel
@pytest.mark.parametrize("how", ["vmap", "map"])
def test_members_are_computed_as_if_alone(how):
    arrays = weights(16, 30, 2, 3)
    mapped = jax.vmap(gru_layer) if how == "vmap" else lambda *a: jax.lax.map(lambda b: gru_layer(*b), a)
    together = jax.jit(mapped)(*arrays)
    for i in range(3):
        np.testing.assert_array_equal(together[i], gru_layer(*(a[i] for a in arrays)))


@needs_kernel
def test_members_may_share_their_weights():
    *layer, phi, start = weights(16, 30, 2)
    phi = jnp.stack([phi, -phi])
    found = jax.vmap(gru_layer, (*(None,) * len(layer), 0, None))(*layer, phi, start)
    np.testing.assert_array_equal(found[1], gru_layer(*layer, phi[1], start))


def layers(n_in, hidden, n_out, rows, *members):
    draw = np.random.default_rng(1)
    shapes = (n_in, hidden), (hidden,), (hidden, n_out), (n_out,), (rows, n_in)
    return [jnp.asarray(0.5 * draw.normal(size=(*members, *shape)), jnp.float32) for shape in shapes]


def by_hand(relu, w1, b1, w2, b2, z):
    act = jax.nn.relu if relu else jax.nn.sigmoid
    return act(z @ w1 + b1[None]) @ w2 + b2[None]


@needs_kernel
@pytest.mark.parametrize("relu", [True, False])
@pytest.mark.parametrize("shape", [(1, 16, 16, 200), (32, 16, 16, 64), (16, 16, 1, 65), (3, 7, 18, 5), (64, 64, 12, 1)])
def test_dense_layers_are_those_of_two_products(relu, shape):
    arrays = layers(*shape)

    def values_and_gradients(arrays):
        both = (two_dense, by_hand)
        return [(f(relu, *arrays), jax.grad(lambda a, f=f: jnp.sum(jnp.sin(f(relu, *a))))(arrays)) for f in both]

    (y, gradients), (expected_y, expected_gradients) = quick_jit(values_and_gradients)(arrays)
    np.testing.assert_allclose(y, expected_y, rtol=0, atol=5e-5)
    for found, expected in zip(gradients, expected_gradients, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * (1 + np.abs(expected).max()))


@needs_kernel
def test_dense_layers_of_members_are_computed_as_if_alone():
    arrays = layers(3, 16, 16, 70, 4)
    together = jax.jit(jax.vmap(lambda *a: two_dense(True, *a)))(*arrays)
    for i in range(4):
        np.testing.assert_array_equal(together[i], two_dense(True, *(a[i] for a in arrays)))


@needs_kernel
@pytest.mark.parametrize("relu", [True, False])
def test_dense_layers_pass_on_what_is_not_finite(relu):
    *weights_, z = layers(3, 16, 2, 70)
    y = two_dense(relu, *weights_, z.at[66, 1].set(jnp.nan))
    assert np.isnan(y[66]).all()
    assert np.isfinite(np.delete(y, 66, 0)).all()


@pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="no C++ compiler here")
def test_where_there_is_a_compiler_there_are_kernels():
    """All other tests of kernels are skipped where there are none: this one must not let a broken kernel pass."""
    assert missing_kernels() is None


def test_a_machine_without_a_compiler_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    assert missing_kernels.__wrapped__() == "no C++ compiler found (CXX, c++, g++, clang++)"


def test_a_compiler_that_fails_is_no_kernel(monkeypatch, tmp_path):
    compiler = tmp_path / "broken"
    compiler.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo 1.0 || { echo "kernels.cc:1: error: no such thing" >&2; exit 1; }\n'
    )
    compiler.chmod(0o755)
    monkeypatch.setenv("CXX", str(compiler))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert (
        missing_kernels.__wrapped__()
        == f"{compiler} does not compile the C++ kernels: kernels.cc:1: error: no such thing"
    )
    assert list((tmp_path / "cache/pgrssnn_jax/native").iterdir()) == []


@needs_kernel
def test_a_cache_folder_that_cannot_be_written_is_no_kernel(monkeypatch, tmp_path):
    blocked = tmp_path / "cache"
    blocked.write_text("a file, where a folder is needed")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert "cannot be compiled or loaded" in missing_kernels.__wrapped__()
