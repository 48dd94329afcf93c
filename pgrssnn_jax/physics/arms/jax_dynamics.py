"""Forward dynamics of an arm in JAX, from the same tables as Pinocchio's: functions of one sample, `vmap`ped over more.

M(q) q̈ + h(q, q̇) = τ          equations in `chain.py`, their derivatives in `derivatives.py`
"""

from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Float

from pgrssnn_jax.physics.arms import chain as many
from pgrssnn_jax.physics.arms.batching import batch_last
from pgrssnn_jax.physics.arms.chain import Batch, Chain, Extra, unpacked, world_at
from pgrssnn_jax.physics.arms.derivatives import jacobian, pull_back
from pgrssnn_jax.physics.arms.tables import ArmTables

Joints = Float[jax.Array, " n"]
Derivatives = Literal["reverse", "forward"]
_TABLES_ONLY = Extra()


# (q, q̇, τ) or (q, q̇, τ, extra), each of the first three [n], to [n]
ForwardDynamics = Callable[..., Joints]


def forward_dynamics(tables: ArmTables, derivatives: Derivatives = "reverse") -> ForwardDynamics:
    """q̈ = f(q, q̇, τ) in rad/s² from rad, rad/s and Nm on the link side, each `[n]`; f(q, q̇, τ, extra) where the arm has
    more than its tables say. Maps by `vmap` over any number of axes; the precision is that of the arguments.

    Differentiable in one mode, also with respect to `extra`. reverse: for training; forward: for Jacobians, whose many
    tangents share one matrix; map over tangents outside and over samples inside.
    """
    build = {"reverse": _reverse, "forward": _forward}[derivatives]
    return build(Chain(tables))


def _flat(extra: Extra) -> tuple[tuple[jax.Array, ...], Callable[[tuple[jax.Array, ...]], Extra]]:
    leaves, structure = jax.tree.flatten(extra)
    return tuple(leaves), lambda arrays: jax.tree.unflatten(structure, arrays)


def _reverse(chain: Chain) -> ForwardDynamics:
    def solve(extra: Extra) -> Callable[..., tuple[jax.Array, ...]]:
        _, whole = _flat(extra)

        def alone(q: Batch, v: Batch, tau: Batch, *beta: jax.Array) -> tuple[jax.Array, ...]:
            return (many.accelerations(chain, q, v, tau, whole(beta))[0],)

        return batch_last(alone)

    def solve_and_keep(extra: Extra) -> Callable[..., tuple[jax.Array, ...]]:
        _, whole = _flat(extra)

        def kept(q: Batch, v: Batch, tau: Batch, *beta: jax.Array) -> tuple[jax.Array, ...]:
            a, factor, world = many.accelerations(chain, q, v, tau, whole(beta))
            return (a, factor, *world.packed())

        return batch_last(kept)

    def pull(extra: Extra) -> Callable[..., tuple[jax.Array, ...]]:
        leaves, whole = _flat(extra)

        def back(v: Batch, a: Batch, factor: jax.Array, a_bar: Batch, *rest: jax.Array) -> tuple[jax.Array, ...]:
            beta, world = rest[: len(leaves)], unpacked(chain, rest[len(leaves) :])
            *bars, extra_bar = pull_back(chain, v, a, factor, world, whole(beta), a_bar)
            return (*bars, *jax.tree.leaves(extra_bar))

        return batch_last(back)

    @jax.custom_vjp
    def accelerations(q: Joints, v: Joints, tau: Joints, extra: Extra) -> Joints:
        return solve(extra)(q, v, tau, *_flat(extra)[0])[0]

    def forward(
        q: Joints, v: Joints, tau: Joints, extra: Extra
    ) -> tuple[Joints, tuple[tuple[jax.Array, ...], Extra, tuple[jax.Array, ...]]]:
        a, factor, *world = solve_and_keep(extra)(q, v, tau, *_flat(extra)[0])
        return a, ((v, a, factor), extra, tuple(world))

    def reverse(
        residuals: tuple[tuple[jax.Array, ...], Extra, tuple[jax.Array, ...]], a_bar: Joints
    ) -> tuple[Joints, Joints, Joints, Extra]:
        known, extra, world = residuals
        leaves, whole = _flat(extra)
        q_bar, v_bar, tau_bar, *beta_bar = pull(extra)(*known, a_bar, *leaves, *world)
        return q_bar, v_bar, tau_bar, whole(tuple(beta_bar))

    accelerations.defvjp(forward, reverse)
    return lambda q, v, tau, extra=_TABLES_ONLY: accelerations(q, v, tau, extra)


def _forward(chain: Chain) -> ForwardDynamics:
    def solve_and_differentiate(extra: Extra) -> Callable[..., tuple[jax.Array, ...]]:
        _, whole = _flat(extra)

        def both(q: Batch, v: Batch, tau: Batch, *beta: jax.Array) -> tuple[jax.Array, ...]:
            known = whole(beta)
            a, factor, world = many.accelerations(chain, q, v, tau, known)
            return a, jacobian(chain, v, a, factor, world, known)

        return batch_last(both)

    def contract(matrix: Float[jax.Array, "n columns batch"], z: Float[jax.Array, "columns batch"]) -> tuple[Batch]:
        terms = [matrix[:, k] * z[k : k + 1] for k in range(matrix.shape[1])]
        return (sum(terms[1:], terms[0]),)

    move = batch_last(contract)

    @jax.custom_jvp
    def accelerations(q: Joints, v: Joints, tau: Joints, extra: Extra) -> Joints:
        leaves, whole = _flat(extra)

        def alone(q: Batch, v: Batch, tau: Batch, *beta: jax.Array) -> tuple[jax.Array, ...]:
            return (many.accelerations(chain, q, v, tau, whole(beta))[0],)

        return batch_last(alone)(q, v, tau, *leaves)[0]

    @accelerations.defjvp
    def push(
        primals: tuple[Joints, Joints, Joints, Extra], tangents: tuple[Joints, Joints, Joints, Extra]
    ) -> tuple[Joints, Joints]:
        *state, extra = primals
        a, matrix = solve_and_differentiate(extra)(*state, *_flat(extra)[0])
        return a, move(matrix, jnp.concatenate(jax.tree.leaves(tangents)))[0]

    return lambda q, v, tau, extra=_TABLES_ONLY: accelerations(q, v, tau, extra)


def inverse_dynamics(tables: ArmTables) -> ForwardDynamics:
    """τ = M(q) q̈ + h(q, q̇) in Nm on the link side, from q, q̇, q̈, each `[n]`."""
    chain = Chain(tables)

    def torque(q: Joints, v: Joints, a: Joints, extra: Extra = _TABLES_ONLY) -> Joints:
        leaves, whole = _flat(extra)

        def all_of(q: Batch, v: Batch, a: Batch, *beta: jax.Array) -> tuple[jax.Array]:
            known = whole(beta)
            links = many.newton_euler(chain, world_at(chain, q, known), v, a, known)
            return (links + many.armature(chain, a, known) * a,)

        return batch_last(all_of)(q, v, a, *leaves)[0]

    return torque


def mass_matrix(tables: ArmTables) -> Callable[[Joints], Float[jax.Array, "n n"]]:
    """M(q) in kg m², with the armature on its diagonal, from q `[n]`."""
    chain = Chain(tables)

    def matrix(q: Batch) -> tuple[jax.Array]:
        upper = many.mass(chain, world_at(chain, q, _TABLES_ONLY), _TABLES_ONLY)
        rows = [[upper[min(j, k)][max(j, k)] for k in range(chain.n)] for j in range(chain.n)]
        return (jnp.stack([jnp.stack([jnp.broadcast_to(m, q[0].shape) for m in row]) for row in rows]),)

    mapped = batch_last(matrix)
    return lambda q: mapped(q)[0]
