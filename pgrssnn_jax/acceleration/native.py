"""GRU layers, dense layers and the dynamics of arms as C++ kernels, compiled once on the machine that runs them.

XLA runs a scan over small matrices step by step through its runtime: for 16 units a step takes ten times longer than
its arithmetic. The kernels (`kernels/*.cc`) take a whole sequence at once, and keep no intermediate results for the
gradient. They agree with `models/gru.py`, `models/networks.py` and `physics/arms/chain.py` to the rounding of single
precision (sigmoid and tanh to an absolute 1e-7).
"""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.acceleration import build

_SOURCES = ("arm.cc", "gru.cc", "two_dense.cc")
_TARGETS = ("gru_forward", "gru_backward", "two_dense_forward", "two_dense_backward", "arm", "arm_factors")
MOST_JOINTS = 32  # of the kernel of arms


@cache
def missing_kernels() -> str | None:
    """Compiles and registers the kernels. Returns None, or the reason why they are not available: one phrase."""
    sources = {name: (build.KERNELS / name).read_text() for name in _SOURCES}
    return build.missing_library("kernels", sources, ("-O3",), partial(build.register, targets=_TARGETS))


def _call(target: str, like: Any, *arrays: Any, **attributes: Any) -> Any:
    """The kernel's results, of the shapes of `like`; it maps over any leading axes itself."""
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, jnp.float32), like)
    call = jax.ffi.ffi_call(f"pgrssnn_{target}", shapes, vmap_method="broadcast_all")
    return call(*arrays, **attributes)


@jax.custom_vjp
def gru_layer(
    input_kernel: Float[jax.Array, "n_in gates"],
    input_bias: Float[jax.Array, " gates"],
    hidden_kernel: Float[jax.Array, "hidden gates"],
    hidden_bias: Float[jax.Array, " gates"],
    phi: Float[jax.Array, "time seq n_in"],
    start: Float[jax.Array, "seq hidden"],
) -> Float[jax.Array, "time seq hidden"]:
    """`models.gru.GRU.scan`, float32 and reverse mode only. Call it where `missing_kernels()` is None."""
    states = jax.ShapeDtypeStruct((*phi.shape[:2], start.shape[1]), jnp.float32)
    return _call("gru_forward", states, input_kernel, input_bias, hidden_kernel, hidden_bias, phi, start)


def _gru_forward(*arrays: Any) -> tuple[jax.Array, tuple[Any, ...]]:
    states = gru_layer(*arrays)
    return states, (*arrays, states)


def _gru_backward(residuals: tuple[Any, ...], cotangent: Any) -> tuple[jax.Array, ...]:
    return tuple(_call("gru_backward", residuals[:-1], *residuals, cotangent))


gru_layer.defvjp(_gru_forward, _gru_backward)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def two_dense(
    relu: bool,
    first: Float[jax.Array, "n_in hidden"],
    first_bias: Float[jax.Array, " hidden"],
    second: Float[jax.Array, "hidden n_out"],
    second_bias: Float[jax.Array, " n_out"],
    z: Float[jax.Array, "rows n_in"],
) -> Float[jax.Array, "rows n_out"]:
    """`models.networks.TwoDense`, float32 and reverse mode only; relu False: the logistic function."""
    y = jax.ShapeDtypeStruct((z.shape[0], second.shape[1]), jnp.float32)
    return _call("two_dense_forward", y, first, first_bias, second, second_bias, z, relu=relu)


def _two_dense_forward(relu: bool, *arrays: Any) -> tuple[jax.Array, tuple[Any, ...]]:
    return two_dense(relu, *arrays), arrays


def _two_dense_backward(relu: bool, arrays: tuple[Any, ...], cotangent: Any) -> tuple[jax.Array, ...]:
    first, first_bias, second, _, z = arrays
    return tuple(_call("two_dense_backward", arrays, first, first_bias, second, z, cotangent, relu=relu))


two_dense.defvjp(_two_dense_forward, _two_dense_backward)


class ArmConstants(NamedTuple):
    """Of an arm, as `kernels/arm.cc` reads them: 23 numbers per joint in a row, parents, gravity in m/s²."""

    tables: np.ndarray
    parents: np.ndarray
    gravity: np.ndarray


Batch = Float[jax.Array, "n batch"]


def arm_accelerations(arm: ArmConstants, q: Batch, v: Batch, tau: Batch) -> Batch:
    """q̈ of `physics.arms.chain.accelerations`, float32, without a derivative."""
    return _call("arm", q, q, v, tau, **arm._asdict())


def arm_factors(arm: ArmConstants, pairs: int, q: Batch, v: Batch, tau: Batch) -> tuple[Batch, jax.Array, jax.Array]:
    """q̈, the factors `[pairs + n, batch]` of M and the packed world `[15, n, batch]`; pairs: of a joint and another one
    between it and the base."""
    n, batch = q.shape
    like = (q, jax.ShapeDtypeStruct((pairs + n, batch), q.dtype), jax.ShapeDtypeStruct((15, n, batch), q.dtype))
    return tuple(_call("arm_factors", like, q, v, tau, **arm._asdict()))
