"""Forward dynamics of an arm in JAX, from the same tables as Pinocchio's: functions of one sample, `vmap`ped over more.

M(q) q̈ + h(q, q̇) = τ          equations in `chain.py`, their derivatives in `derivatives.py`
"""

from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Float

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


def forward_dynamics(tables: ArmTables, derivatives: Derivatives = "reverse") -> ForwardDynamics:
    """q̈ = f(q, q̇, τ) in rad/s² from rad, rad/s and Nm on the link side, each `[n]`; f(q, q̇, τ, extra) where the arm has
    more than its tables say. Maps by `vmap` over any number of axes; the precision is that of the arguments.

    Differentiable in one mode, also with respect to `extra`. reverse: for training; forward: for Jacobians, whose many
    tangents share one matrix; map over tangents outside and over samples inside.
    """
    chain = Chain(tables)
    alone = batch_last(lambda q, v, tau, extra: accelerations(chain, q, v, tau, extra)[0])

    def solve(q: Joints, v: Joints, tau: Joints, extra: Extra) -> Joints:
        return alone(q, v, tau, extra)

    if derivatives == "reverse":
        differentiable = jax.custom_vjp(solve)
        differentiable.defvjp(*_reverse(chain))
    else:
        differentiable = jax.custom_jvp(solve)
        differentiable.defjvp(_forward(chain))
    return lambda q, v, tau, extra=TABLES_ONLY: differentiable(q, v, tau, extra)


def _reverse(chain: Chain) -> tuple[Callable[..., Any], Callable[..., Any]]:
    @batch_last
    def solve(q: Batch, v: Batch, tau: Batch, extra: Extra) -> tuple[Batch, tuple[jax.Array, ...]]:
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
