import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from jax.test_util import check_grads
from toys import quick_jit

from benchmarks.speed.torch_names import GRU_NAMES
from pgrssnn_jax.models.gru import GRU, delayed, gru_scan, gru_step

FIXTURES = Path(__file__).parent / "fixtures"


def layers_of(arrays, dtype):
    """Our weights from torch's: kernels are transposed, gates keep their order."""

    def one(layer):
        return {ours: jnp.asarray(arrays[f"{theirs}_l{layer}"].T, dtype) for ours, theirs in GRU_NAMES.items()}

    return [one(layer) for layer in range(2)]


def run(layers, u):
    """Stacked layers over u `[time, seq, n_in]`, through the module."""
    for weights in layers:
        n_in, gates = weights["input_kernel"].shape
        gru = GRU(n_in, gates // 3, bias=True, rngs=nnx.Rngs(0))
        for name, value in weights.items():
            setattr(gru, name, nnx.Param(value))
        u = gru.scan(u, jnp.zeros((u.shape[1], gates // 3), u.dtype))
    return u


def compare_with_torch(arrays, dtype, rtol, rtol_gradient):
    layers, u = layers_of(arrays, dtype), jnp.asarray(arrays["input"], dtype)
    out = jax.jit(run)(layers, u)
    assert out.dtype == dtype
    np.testing.assert_allclose(out, arrays["out"], rtol=rtol, atol=rtol)
    to_layers, to_input = quick_jit(jax.grad(lambda w, u: jnp.sum(run(w, u) ** 2), (0, 1)))(layers, u)
    np.testing.assert_allclose(to_input, arrays["grad_input"], rtol=rtol_gradient, atol=rtol_gradient)
    for layer, gradient in enumerate(to_layers):
        for ours, theirs in GRU_NAMES.items():
            expected = arrays[f"grad_{theirs}_l{layer}"].T
            atol = rtol_gradient * np.abs(expected).max()
            np.testing.assert_allclose(gradient[ours], expected, rtol=rtol_gradient, atol=atol, err_msg=ours)


@pytest.fixture(scope="module")
def stored():
    with np.load(FIXTURES / "torch_gru.npz") as file:
        return dict(file)


def test_stored_weights_would_show_a_missing_bias(stored):
    for name in ("bias_ih_l0", "bias_hh_l0", "bias_ih_l1", "bias_hh_l1"):
        assert np.abs(stored[name]).min() > 1e-3


def test_two_layers_equal_torch(stored):
    compare_with_torch(stored, jnp.float32, 1e-6, 1e-5)


@pytest.mark.usefixtures("x64")
def test_two_layers_equal_torch_in_double_precision(stored):
    compare_with_torch(stored, jnp.float64, 1e-13, 1e-11)


def test_two_layers_equal_torch_live():
    pytest.importorskip("torch", reason="torch is not installed: extra `compare`")
    place = importlib.util.spec_from_file_location("make_torch_gru", FIXTURES / "make_torch_gru.py")
    maker = importlib.util.module_from_spec(place)
    place.loader.exec_module(maker)
    compare_with_torch(maker.torch_gru(seed=1), jnp.float32, 1e-6, 1e-5)


# --- the recurrence and its derivative rule ---------------------------------------------------------------------------


def problem(seed=0, *, bias, time=6, seq=2, hidden=3):
    draw = np.random.default_rng(seed)
    kernel, b, projected, start = (
        jnp.asarray(draw.normal(size=shape), float)
        for shape in ((hidden, 3 * hidden), (3 * hidden,), (time, seq, 3 * hidden), (seq, hidden))
    )
    return kernel, b if bias else None, projected, start


def plain_scan(kernel, bias, projected, start):
    def body(h, p):
        h, _ = gru_step(kernel, bias, h, p)
        return h, h

    return jax.lax.scan(body, start, projected)[1]


def by_hand(kernel, bias, projected, h):
    """Gate by gate in NumPy, from the published equations."""
    w_r, w_z, w_n = np.split(np.asarray(kernel), 3, axis=1)
    b_r, b_z, b_n = np.split(np.zeros(kernel.shape[1]) if bias is None else np.asarray(bias), 3)
    states, h = [], np.asarray(h)
    for p in np.asarray(projected):
        p_r, p_z, p_n = np.split(p, 3, axis=1)
        r = 1 / (1 + np.exp(-(p_r + h @ w_r + b_r)))
        z = 1 / (1 + np.exp(-(p_z + h @ w_z + b_z)))
        n = np.tanh(p_n + r * (h @ w_n + b_n))
        h = (1 - z) * n + z * h
        states.append(h)
    return np.stack(states)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize("time", [1, 6])
def test_scan_equals_a_loop_over_the_equations(bias, time):
    args = problem(bias=bias, time=time)
    np.testing.assert_allclose(gru_scan(*args), by_hand(*args), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("bias", [False, True])
def test_scan_equals_repeated_steps(bias):
    kernel, b, projected, h = problem(bias=bias)
    step = jax.jit(lambda h, p: gru_step(kernel, b, h, p)[0])
    for p, found in zip(projected, np.asarray(gru_scan(kernel, b, projected, h)), strict=True):
        h = step(h, p)
        np.testing.assert_allclose(found, h, rtol=1e-5, atol=1e-6)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("bias", [False, True])
def test_derivative_rule_equals_plain_reverse_mode(bias):
    """With a cotangent that differs at every sample, so that nothing cancels."""
    kernel, b, projected, start = problem(bias=bias)
    weight = jnp.asarray(np.random.default_rng(1).normal(size=(*projected.shape[:2], kernel.shape[0])))

    def gradient(scan):
        wanted = (0, 1, 2, 3) if bias else (0, 2, 3)
        return quick_jit(jax.grad(lambda *args: jnp.vdot(weight, scan(*args)), wanted))(kernel, b, projected, start)

    for found, expected in zip(gradient(gru_scan), gradient(plain_scan), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("bias", [False, True])
def test_derivative_rule_equals_finite_differences(bias):
    kernel, b, projected, start = problem(bias=bias, time=3)

    @jax.jit
    def scan(kernel, projected, start, *b):
        kernel, projected, start, *b = map(jnp.asarray, (kernel, projected, start, *b))
        return gru_scan(kernel, b[0] if b else None, projected, start)

    check_grads(scan, (kernel, projected, start, *([b] if bias else [])), order=1, modes=["rev"], rtol=1e-6)


def test_derivative_rule_under_vmap_is_that_of_each_member():
    members = [problem(seed, bias=True) for seed in range(3)]
    together = jax.tree.map(lambda *a: jnp.stack(a), *members)
    gradient = jax.grad(lambda args: jnp.sum(gru_scan(*args) ** 2))
    single = quick_jit(gradient)
    for i, found in enumerate(zip(*quick_jit(jax.vmap(gradient))(together), strict=True)):
        for a, b in zip(found, single(members[i]), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)


def test_a_saturated_gate_has_finite_gradients():
    kernel, b, projected, start = problem(bias=True)
    gradient = quick_jit(jax.grad(lambda *args: jnp.sum(gru_scan(*args)), (0, 1, 2, 3)))(
        kernel, b, 1e4 * projected, start
    )
    assert all(np.isfinite(g).all() for g in gradient)


def test_delayed_begins_with_the_start_and_drops_the_last():
    states, start = jnp.arange(1.0, 13.0).reshape(3, 2, 2), jnp.full((2, 2), 7.0)
    np.testing.assert_array_equal(delayed(states, start), np.concatenate([start[None], states[:2]]))
    np.testing.assert_array_equal(delayed(states[:1], start), start[None])


# --- the module -------------------------------------------------------------------------------------------------------


def test_module_has_no_biases_unless_asked(key):
    plain = nnx.state(GRU(4, 5, bias=False, rngs=nnx.Rngs(key)), nnx.Param)
    assert {tuple(a.shape) for a in jax.tree.leaves(plain)} == {(4, 15), (5, 15)}
    biased = nnx.state(GRU(4, 5, bias=True, rngs=nnx.Rngs(key)), nnx.Param)
    assert sorted(a.shape for a in jax.tree.leaves(biased)) == [(4, 15), (5, 15), (15,), (15,)]


def test_module_starts_uniform_in_one_over_root_hidden(key):
    """torch's start: ± 1/√hidden for kernels and biases alike, whatever the input's width."""
    bound = 16**-0.5
    for a in jax.tree.leaves(nnx.state(GRU(3, 16, bias=True, rngs=nnx.Rngs(key)), nnx.Param)):
        assert np.abs(a).max() <= bound
        assert np.abs(a).max() > 0.9 * bound
        assert abs(np.mean(a)) < 0.3 * bound
        np.testing.assert_allclose(np.std(a), bound / 3**0.5, rtol=0.25)


@pytest.mark.parametrize("bias", [False, True])
def test_module_step_and_scan_agree_for_any_number_of_samples(key, bias):
    gru = GRU(4, 3, bias=bias, rngs=nnx.Rngs(key))
    u = jax.random.normal(key, (5, 2, 4))
    h = jnp.zeros((2, 3))
    states = np.asarray(gru.scan(u, h))
    step = jax.jit(lambda h, u_t: gru.step(h, gru.project(u_t)))
    for u_t, found in zip(u, states, strict=True):
        h = step(h, u_t)
        np.testing.assert_allclose(found, h, rtol=1e-5, atol=1e-6)
