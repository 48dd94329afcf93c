"""Gated recurrent unit whose input projection is made apart, and its recurrence with a batched gradient.

    r = σ(p_r + W_hr h + b_hr)        z = σ(p_z + W_hz h + b_hz)
    n = tanh(p_n + r (W_hn h + b_hn)) h⁺ = (1 - z) n + z h              p = W_i φ + b_i

Gates in the order r, z, n and biases on both sides: torch's convention, so that weights can be exchanged. By default
there are no biases, as published.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Float

from pgrssnn_jax.acceleration import native as kernels


def gru_step(
    kernel: Float[jax.Array, "hidden gates"],
    bias: Float[jax.Array, " gates"] | None,
    h: Float[jax.Array, "seq hidden"],
    projected: Float[jax.Array, "seq gates"],
) -> tuple[Float[jax.Array, "seq hidden"], tuple[jax.Array, ...]]:
    """h⁺ and what its derivative needs: the gates (r, z), n, and W_hn h + b_hn."""
    hidden = h.shape[-1]
    recurrent = h @ kernel
    if bias is not None:
        recurrent = recurrent + bias[None]
    gates = jax.nn.sigmoid(projected[:, : 2 * hidden] + recurrent[:, : 2 * hidden])
    recurrent_n = recurrent[:, 2 * hidden :]
    n = jnp.tanh(projected[:, 2 * hidden :] + gates[:, :hidden] * recurrent_n)
    return n + gates[:, hidden:] * (h - n), (gates, n, recurrent_n)


@jax.custom_vjp
def gru_scan(
    kernel: Float[jax.Array, "hidden gates"],
    bias: Float[jax.Array, " gates"] | None,
    projected: Float[jax.Array, "time seq gates"],
    start: Float[jax.Array, "seq hidden"],
) -> Float[jax.Array, "time seq hidden"]:
    """h_1 .. h_T from h_0 = start.

    The derivative rule keeps one small product per step in the backward scan and forms the kernel's gradient as
    one product over all samples afterwards, where plain reverse mode adds an outer product per step: half the time.
    Reverse mode only.
    """
    return _scan(kernel, bias, projected, start)[0]


def _scan(
    kernel: jax.Array, bias: jax.Array | None, projected: jax.Array, start: jax.Array
) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    def body(h: jax.Array, p: jax.Array) -> tuple[jax.Array, tuple[jax.Array, tuple[jax.Array, ...]]]:
        h, saved = gru_step(kernel, bias, h, p)
        return h, (h, saved)

    return jax.lax.scan(body, start, projected)[1]


def _forward(
    kernel: jax.Array, bias: jax.Array | None, projected: jax.Array, start: jax.Array
) -> tuple[jax.Array, tuple[Any, ...]]:
    states, saved = _scan(kernel, bias, projected, start)
    return states, (kernel, bias, start, states, saved)


def _backward(
    residuals: tuple[Any, ...], cotangent: jax.Array
) -> tuple[jax.Array, jax.Array | None, jax.Array, jax.Array]:
    kernel, bias, start, states, (gates, n, recurrent_n) = residuals
    before = delayed(states, start)
    hidden = before.shape[-1]
    to_rz, to_n = jnp.split(kernel.T, [2 * hidden])

    def body(d_next: jax.Array, step: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        outer, gates_t, n_t, recurrent_n_t, h = step
        r, z = jnp.split(gates_t, 2, axis=-1)
        d = d_next + outer
        d_n = d * (1.0 - z) * (1.0 - n_t * n_t)
        d_z = d * (h - n_t) * z * (1.0 - z)
        d_r = d_n * recurrent_n_t * r * (1.0 - r)
        # the barrier keeps the compiler from computing them again inside the products
        d_projected, d_recurrent_n = jax.lax.optimization_barrier((jnp.concatenate([d_r, d_z, d_n], -1), d_n * r))
        back = d_projected[:, : 2 * hidden] @ to_rz + d_recurrent_n @ to_n
        return back + z * d, (d_projected, d_recurrent_n)

    steps = (cotangent, gates, n, recurrent_n, before)
    d_start, (d_projected, d_recurrent_n) = jax.lax.scan(body, jnp.zeros_like(start), steps, reverse=True)
    d_recurrent = [_rows(d_projected)[:, : 2 * hidden], _rows(d_recurrent_n)]
    d_kernel = jnp.concatenate([_rows(before).T @ d for d in d_recurrent], -1)
    d_bias = None if bias is None else jnp.concatenate([d.sum(0) for d in d_recurrent]).astype(bias.dtype)
    return d_kernel.astype(kernel.dtype), d_bias, d_projected, d_start


def _rows(signal: jax.Array) -> Float[jax.Array, "samples c"]:
    """All samples below each other: one plain product with them is several times faster than one over two axes."""
    return signal.reshape(-1, signal.shape[-1])


gru_scan.defvjp(_forward, _backward)


def delayed(states: Float[jax.Array, "time seq c"], start: Float[jax.Array, "seq c"]) -> Float[jax.Array, "time seq c"]:
    """h_0 .. h_{T-1} with h_0 = start, from h_1 .. h_T."""
    return jnp.concatenate([start[None], states[:-1]])


class GRU(nnx.Module):
    """Weights of one layer, uniform in ±1/√hidden at the start."""

    def __init__(self, n_in: int, hidden: int, *, bias: bool, rngs: nnx.Rngs) -> None:
        def draw(*shape: int) -> nnx.Param[Any]:
            bound = hidden**-0.5
            return nnx.Param(jax.random.uniform(rngs.params(), shape, jnp.float32, -bound, bound))

        self.input_kernel = draw(n_in, 3 * hidden)
        self.hidden_kernel = draw(hidden, 3 * hidden)
        self.input_bias = draw(3 * hidden) if bias else None
        self.hidden_bias = draw(3 * hidden) if bias else None

    def project(self, phi: Float[jax.Array, "*batch n_in"]) -> Float[jax.Array, "*batch gates"]:
        """p = W_i φ + b_i, for any number of samples at once."""
        projected = (_rows(phi) @ self.input_kernel[...]).reshape(*phi.shape[:-1], -1)
        if self.input_bias is None:
            return projected
        return projected + self.input_bias[...].reshape((1,) * (projected.ndim - 1) + (-1,))

    def step(self, h: Float[jax.Array, "seq hidden"], projected: Float[jax.Array, "seq gates"]) -> jax.Array:
        return gru_step(*self._recurrent(), h, projected)[0]

    def scan(
        self,
        phi: Float[jax.Array, "time seq n_in"],
        start: Float[jax.Array, "seq hidden"],
        *,
        native: bool = False,
    ) -> Float[jax.Array, "time seq hidden"]:
        """h_1 .. h_T from h_0 = start. native: by the C++ kernel, in float32; other precisions take XLA."""
        kernel, bias = self._recurrent()
        if not native or not phi.dtype == kernel.dtype == jnp.float32:
            return gru_scan(kernel, bias, self.project(phi), start)
        none = jnp.zeros_like(kernel[0])
        input_bias = none if self.input_bias is None else self.input_bias[...]
        return kernels.gru_layer(self.input_kernel[...], input_bias, kernel, none if bias is None else bias, phi, start)

    def _recurrent(self) -> tuple[jax.Array, jax.Array | None]:
        return self.hidden_kernel[...], None if self.hidden_bias is None else self.hidden_bias[...]
