"""Forward dynamics of an arm by Pinocchio's C++ articulated-body algorithm, called from compiled JAX programs.

A whole batch is one `jax.pure_callback`, whatever was vmapped. Pinocchio computes in float64: float32 arguments are
cast to float64 on the way in, and the result is rounded to the arguments' precision on the way out. Derivatives:

    q̄ = (∂q̈/∂q)ᵀ ā,     q̇̄ = (∂q̈/∂q̇)ᵀ ā,     τ̄ = M⁻¹ ā,         δq̈ = ∂q̈/∂q δq + ∂q̈/∂q̇ δq̇ + M⁻¹ δτ

with the matrices of `computeABADerivatives` (Carpentier and Mansard, RSS 2018), which come packed beside q̈ from one
callback and are contracted in JAX, so that no callback ever sees a tangent. Inside the callback there is NumPy and
Pinocchio only.
"""

import threading
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - its files are in a folder of their own
from jaxtyping import Float

from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.jax_dynamics import TABLES_ONLY, Derivatives, ForwardDynamics, Joints
from pgrssnn_jax.physics.arms.tables import ArmTables, pinocchio_model


def forward_dynamics(tables: ArmTables, derivatives: Derivatives = "reverse") -> ForwardDynamics:
    """q̈ = f(q, q̇, τ) in rad/s² from rad, rad/s and Nm on the link side, each `[n]`.

    Works under jit, vmap, scan and differentiation in one mode. One call uses one thread, because every device calls
    for itself. The masses are those of the tables: `ValueError` for any `extra`.
    """
    host, n = _Host(tables), tables.n

    def alone(q: Joints, v: Joints, tau: Joints) -> Joints:
        return _call(host.accelerations, (n,), q, v, tau)

    def both(q: Joints, v: Joints, tau: Joints) -> tuple[Joints, Float[jax.Array, "n _"]]:
        packed = _call(host.derivatives, (n, 1 + 3 * n), q, v, tau)
        return packed[:, 0], packed[:, 1:]

    def reverse(matrices: Float[jax.Array, "n _"], a_bar: Joints) -> tuple[Joints, ...]:
        return tuple(jnp.split(a_bar @ matrices, 3))

    def push(primals: tuple[Joints, ...], tangents: tuple[Joints, ...]) -> tuple[Joints, Joints]:
        a, matrices = both(*primals)
        return a, matrices @ jnp.concatenate(tangents)

    if derivatives == "reverse":
        differentiable = jax.custom_vjp(alone)
        differentiable.defvjp(both, reverse)
    else:
        differentiable = jax.custom_jvp(alone)
        differentiable.defjvp(push)

    def accelerations(q: Joints, v: Joints, tau: Joints, extra: Extra = TABLES_ONLY) -> Joints:
        if jax.tree.leaves(extra):
            raise ValueError("physics.backend: expected jax for effects on the moving masses, found pinocchio")
        return differentiable(q, v, tau)

    return accelerations


def _call(
    function: Callable[..., np.ndarray], shape: tuple[int, ...], q: Joints, v: Joints, tau: Joints
) -> Float[jax.Array, "..."]:
    """One callback for the whole batch. Arguments and result travel as bytes: JAX would round float64 to float32 in a
    callback that runs where 64-bit numbers are switched off, whatever the program around it says."""
    dtype = jnp.result_type(q, v, tau)
    packed = jax.lax.bitcast_convert_type(jnp.stack([a.astype(dtype) for a in (q, v, tau)]), jnp.uint8)

    def on_host(packed: Any) -> np.ndarray:
        arrays = np.ascontiguousarray(np.asarray(packed)).view(dtype)[..., 0]
        found = function(arrays.reshape(-1, *arrays.shape[-2:])).reshape(*arrays.shape[:-2], *shape)
        with np.errstate(over="ignore"):  # a state beyond float32 becomes infinite, which is for others to notice
            return np.ascontiguousarray(found.astype(dtype))[..., None].view(np.uint8)

    result = jax.ShapeDtypeStruct((*shape, dtype.itemsize), jnp.uint8)
    return jax.lax.bitcast_convert_type(jax.pure_callback(on_host, result, packed, vmap_method="broadcast_all"), dtype)


class _Host:
    """Pinocchio's model with working memory per calling thread: devices call back at the same time."""

    def __init__(self, tables: ArmTables) -> None:
        self.model, self.n = pinocchio_model(tables), tables.n
        self._own = threading.local()

    def accelerations(self, arrays: Float[np.ndarray, "batch 3 n"]) -> Float[np.ndarray, "batch n"]:
        if not hasattr(self._own, "pool"):
            self._own.pool = pin.ModelPool(self.model, 1)
        found = pin.abaInParallel(1, self._own.pool, *_columns(arrays))
        return found.reshape(self.n, -1).T  # Pinocchio drops the axis of a batch of one

    def derivatives(self, arrays: Float[np.ndarray, "batch 3 n"]) -> Float[np.ndarray, "batch n m"]:
        """q̈, ∂q̈/∂q, ∂q̈/∂q̇ and M⁻¹ side by side."""
        if not hasattr(self._own, "data"):
            self._own.data = self.model.createData()
        data, columns = self._own.data, _columns(arrays)
        packed = np.empty((len(arrays), self.n, 1 + 3 * self.n))
        for i, out in enumerate(packed):
            pin.computeABADerivatives(self.model, data, *(c[:, i] for c in columns))
            out[:, 0] = data.ddq
            for k, matrix in enumerate((data.ddq_dq, data.ddq_dv, data.Minv)):
                out[:, 1 + k * self.n : 1 + (k + 1) * self.n] = matrix
        return packed


def _columns(arrays: Float[np.ndarray, "batch 3 n"]) -> list[Float[np.ndarray, "n batch"]]:
    """q, q̇ and τ in float64 and in Pinocchio's (column-major) order."""
    return [np.ascontiguousarray(arrays[:, k], np.float64).T for k in range(3)]
