"""The networks of a state-space model, in the networks' (scaled) units.

    φ_u = D(u_t) or D([u_t, x_{t-1}])     f_nn = D(D([h_{t-1}, φ_u]))      h_t = GRU(h_{t-1}, φ_u)
    φ_x = D([u_t, x_t])                   g_nn = D(φ_x)

D: two dense layers with one activation between them. Weights start as torch's do, uniform in ±1/√n_in, which the
published figures rest on. Source: Li, Seth, Kok, IFAC 2026, section 3.

With radial features instead, f_nn = W_x φ([u_t, x_{t-1}]) and g_nn = W_y φ([u_t, x_t]), φ as in `radial.py`.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Float

from pgrssnn_jax.acceleration import native as kernels
from pgrssnn_jax.models.gru import GRU
from pgrssnn_jax.models.radial import Radial
from pgrssnn_jax.models.spec import ModelSpec

ACTIVATIONS: dict[str, Callable[[jax.Array], jax.Array]] = {"relu": jax.nn.relu, "sigmoid": jax.nn.sigmoid}


def _uniform_fan_in(fan_in: int) -> nnx.Initializer:
    bound = fan_in**-0.5

    def init(key: jax.Array, shape: Sequence[int], dtype: Any = jnp.float32, **_: object) -> jax.Array:
        return jax.random.uniform(key, tuple(shape), dtype, -bound, bound)

    return init


def _zeros(key: jax.Array, shape: Sequence[int], dtype: Any = jnp.float32, **_: object) -> jax.Array:
    """Zeros that the compiler does not know to be zeros: jaxlib 0.10.2 fuses a product with a constant matrix of equal
    numbers into what stands before it, and computes it wrongly on CPUs (compare jax issue 39103)."""
    return 0.0 * jax.random.uniform(key, tuple(shape), dtype)


class TwoDense(nnx.Module):
    """D(z) = W2 act(W1 z + b1) + b2, n_in → hidden → n_out."""

    def __init__(
        self, n_in: int, hidden: int, n_out: int, activation: str, *, zero_out: bool = False, rngs: nnx.Rngs
    ) -> None:
        last = _zeros if zero_out else _uniform_fan_in(hidden)
        first = _uniform_fan_in(n_in)
        self.first = nnx.Linear(n_in, hidden, kernel_init=first, bias_init=first, rngs=rngs)
        self.second = nnx.Linear(hidden, n_out, kernel_init=last, bias_init=last, rngs=rngs)
        self.activation = activation

    def __call__(self, z: Float[jax.Array, "*batch n_in"], *, native: bool = False) -> Float[jax.Array, "*batch n_out"]:
        """native: by the C++ kernel, which computes in float32; other precisions take XLA."""
        rows = z.reshape(-1, z.shape[-1])  # the gradient of a product over one axis of samples is the faster one
        layers: Any = (self.first, self.second)
        weights = [weight[...] for layer in layers for weight in (layer.kernel, layer.bias)]
        if native and all(a.dtype == jnp.float32 for a in (rows, *weights)):
            y: Any = kernels.two_dense(self.activation == "relu", *weights, rows)
        else:
            y = self.second(ACTIVATIONS[self.activation](self.first(rows)))
        return y.reshape(*z.shape[:-1], -1)


class Networks(nnx.Module):
    """All networks of one model; call order is the rollout's matter (`rollout.py`)."""

    def __init__(self, spec: ModelSpec, *, n_u: int, n_x: int, n_y: int, rngs: nnx.Rngs) -> None:
        n_h, act, radial = spec.hidden, spec.activation, spec.features == "radial"
        zero = spec.start_from_physics and spec.guided

        def features(n_in: int) -> Any:
            return Radial(n_in, n_h, rngs=rngs) if radial else TwoDense(n_in, n_h, n_h, act, rngs=rngs)

        def head(n_out: int) -> Any:
            if not radial:
                return TwoDense(n_h, n_h, n_out, act, zero_out=zero, rngs=rngs)
            init = _zeros if zero else _uniform_fan_in(n_h)
            return nnx.Linear(n_h, n_out, use_bias=False, kernel_init=init, rngs=rngs)

        # the order of the calls is that of the random numbers
        self.correction = spec.correction if spec.guided else 1.0
        self.features_u = features(n_u + (n_x if spec.feedback else 0))
        layers = spec.gru_layers if spec.recurrent else 0
        self.gru = nnx.List([GRU(n_h, n_h, bias=spec.gru_bias, rngs=rngs) for _ in range(layers)])
        self.mixer = None if radial else TwoDense(2 * n_h if layers else n_h, n_h, n_h, act, rngs=rngs)
        self.head_x = head(n_x)
        self.features_x = features(n_u + n_x)
        self.head_y = head(n_y)

    def phi_u(self, u: Float[jax.Array, "*batch n_in"], *, native: bool = False) -> Float[jax.Array, "*batch hidden"]:
        return _apply(self.features_u, u, native)

    def f_nn(
        self,
        h: Float[jax.Array, "*batch hidden"] | None,
        phi: Float[jax.Array, "*batch hidden"],
        *,
        native: bool = False,
    ) -> jax.Array:
        """State correction from the GRU state *before* it saw u_t (None without a GRU) and φ_u."""
        mixed = phi if h is None else jnp.concatenate([h, phi], -1)
        return self.correction * _apply(
            self.head_x, mixed if self.mixer is None else _apply(self.mixer, mixed, native), native
        )

    def g_nn(
        self, x: Float[jax.Array, "*batch x"], u: Float[jax.Array, "*batch u"], *, native: bool = False
    ) -> jax.Array:
        return _apply(self.head_y, _apply(self.features_x, jnp.concatenate([u, x], -1), native), native)


def _apply(layer: Any, z: jax.Array, native: bool) -> jax.Array:
    """A layer's output; dense layers alone have a kernel."""
    return layer(z, native=native) if isinstance(layer, TwoDense) else layer(z)


def scaled_heads(network: Any, factor_x: Any, factor_y: Any) -> Any:
    """The weights of `Networks` with f_nn multiplied by factor_x and g_nn by factor_y."""

    def scaled(path: Any, weight: jax.Array) -> jax.Array:
        names = jax.tree_util.keystr(path)
        if "first" in names:
            return weight
        return weight * factor_x if "head_x" in names else weight * factor_y if "head_y" in names else weight

    return jax.tree_util.tree_map_with_path(scaled, network)
