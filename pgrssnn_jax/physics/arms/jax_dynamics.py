"""Forward dynamics of an arm in JAX, from the same tables as Pinocchio's: functions of one sample, `vmap`ped over more.

M(q) q̈ + h(q, q̇) = τ          equations in `chain.py`, their derivatives in `derivatives.py`

Natively the equations are those of a C++ kernel (`acceleration/kernels/arm.cc`); the derivatives stay in JAX.
"""

from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.acceleration import native as kernels
from pgrssnn_jax.physics.arms.batching import batch_last
from pgrssnn_jax.physics.arms.chain import Batch, Chain, accelerations, unpacked
from pgrssnn_jax.physics.arms.derivatives import Matrix, jacobian, pull_back
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.tables import ArmTables

Joints = Float[jax.Array, " n"]
Derivatives = Literal["reverse", "forward"]
TABLES_ONLY = Extra()

# (q, q̇, τ) or (q, q̇, τ, extra), each of the first three [n], to [n]
ForwardDynamics = Callable[..., Joints]


def forward_dynamics(
    tables: ArmTables, derivatives: Derivatives = "reverse", *, native: bool = False
) -> ForwardDynamics:
    """q̈ = f(q, q̇, τ) in rad/s² from rad, rad/s and Nm on the link side, each `[n]`; f(q, q̇, τ, extra) where the arm has
    more than its tables say. Maps by `vmap` over any number of axes; the precision is that of the arguments.

    Differentiable in one mode, also with respect to `extra`. reverse: for training; forward: for Jacobians, whose many
    tangents share one matrix; map over tangents outside and over samples inside. native: by the C++ kernel wherever it
    can be: in single precision, of an arm that has no more than its tables say, and where there is a compiler.
    """
    chain = Chain(tables)
    arm = _constants(chain) if native and tables.n <= kernels.MOST_JOINTS and not kernels.missing_kernels() else None

    @batch_last
    def alone(q: Batch, v: Batch, tau: Batch, extra: Extra) -> Batch:
        if arm is not None and _plain(q, v, tau, extra):
            return kernels.arm_accelerations(arm, q, v, tau)
        return accelerations(chain, q, v, tau, extra)[0]

    def solve(q: Joints, v: Joints, tau: Joints, extra: Extra) -> Joints:
        return alone(q, v, tau, extra)

    if derivatives == "reverse":
        differentiable = jax.custom_vjp(solve)
        differentiable.defvjp(*_reverse(chain, arm))
    else:
        differentiable = jax.custom_jvp(solve)
        differentiable.defjvp(_forward(chain))
    return lambda q, v, tau, extra=TABLES_ONLY: differentiable(q, v, tau, extra)


def _constants(chain: Chain) -> kernels.ArmConstants:
    """Columns: rotation 9, position 3, mass, center 3, inertia xx yy zz xy xz yz, armature."""
    t = chain.tables
    inertia = [t.inertia[:, a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    columns = (chain.rotation.reshape(t.n, 9), t.position, t.mass, t.center, *inertia, t.armature)
    table = np.column_stack(columns).astype(np.float32)
    return kernels.ArmConstants(table.ravel(), np.array(t.parents, np.int32), np.array(t.gravity, np.float32))


def _plain(q: Batch, v: Batch, tau: Batch, extra: Extra) -> bool:
    """Can the kernel take these?"""
    return all(part is None for part in extra) and q.dtype == v.dtype == tau.dtype == jnp.float32


def _reverse(chain: Chain, arm: kernels.ArmConstants | None) -> tuple[Callable[..., Any], Callable[..., Any]]:
    pairs = sum(len(chain.below(k)) for k in range(chain.n))

    @batch_last
    def solve(q: Batch, v: Batch, tau: Batch, extra: Extra) -> tuple[Batch, tuple[jax.Array, ...]]:
        if arm is not None and _plain(q, v, tau, extra):
            a, *kept = kernels.arm_factors(arm, pairs, q, v, tau)
            return a, tuple(kept)
        a, factor, world = accelerations(chain, q, v, tau, extra)
        return a, (factor, *world.packed())

    @batch_last
    def pull(v: Batch, a: Batch, extra: Extra, kept: tuple[jax.Array, ...], a_bar: Batch) -> tuple[Any, ...]:
        factor, *world = kept
        return pull_back(chain, v, a, factor, unpacked(chain, world, extra), extra, a_bar)

    def forward(q: Joints, v: Joints, tau: Joints, extra: Extra) -> tuple[Joints, tuple[Any, ...]]:
        a, kept = solve(q, v, tau, extra)
        return a, (v, a, extra, kept)

    return forward, lambda residuals, a_bar: pull(*residuals, a_bar)


def _forward(chain: Chain) -> Callable[..., tuple[Joints, Joints]]:
    @batch_last
    def differentiate(q: Batch, v: Batch, tau: Batch, extra: Extra) -> tuple[Batch, Matrix]:
        a, factor, world = accelerations(chain, q, v, tau, extra)
        return a, jacobian(chain, v, a, factor, world, extra)

    @batch_last
    def contract(matrix: Matrix, z: Float[jax.Array, "columns batch"]) -> Batch:
        terms = [matrix[:, k] * z[k : k + 1] for k in range(matrix.shape[1])]
        return sum(terms[1:], terms[0])

    def push(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Joints, Joints]:
        a, matrix = differentiate(*primals)
        return a, contract(matrix, jnp.concatenate(jax.tree.leaves(tangents)))

    return push
