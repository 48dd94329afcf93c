"""Forward dynamics of an arm in JAX, from the same tables as Pinocchio's.

    M(q) q̈ + h(q, q̇) = τ          M from composite inertias, h by Newton-Euler, M = LᵀDL by elimination from the tips

Everything is written in world axes about the world's origin, where sums along the chain are plain sums: v_i = Σ S_j q̇_j
over the joints j between base and link i, τ_j = S_jᵀ Σ f_i over the links i that j carries. Inside, links are stacked
and the batch comes last (`[n, batch]`), which the compiler turns into long vector loops; outside, functions take one
sample and are vmapped.

Derivatives are those of the solution, not of the way it was found: with λ = M⁻¹ ā for a cotangent ā of q̈,

    τ̄ = λ,     q̄ = -∂(λᵀ τ(q, q̇, q̈))/∂q,     q̇̄ = -∂(λᵀ τ(q, q̇, q̈))/∂q̇

and the gradient of inverse dynamics in closed form (`_pull_back`). Sources: Featherstone, Rigid Body Dynamics
Algorithms, 2008, chapters 5 and 6; Carpentier and Mansard, Analytical derivatives of rigid body dynamics, RSS 2018.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.arm.spatial import (
    Inertias,
    Vector,
    cross,
    dot,
    force_cross,
    minus,
    momentum,
    motion_cross,
    plus,
    scale,
)
from pgrssnn_jax.physics.arm.tables import ArmTables, turn_z

Joints = Float[jax.Array, " n"]
Batch = Float[jax.Array, "n batch"]
ForwardDynamics = Callable[[Joints, Joints, Joints], Joints]


def forward_dynamics(tables: ArmTables) -> ForwardDynamics:
    """q̈ = f(q, q̇, τ) in rad/s² from rad, rad/s and Nm on the link side, each `[n]`.

    The precision is that of the arguments. Differentiable in reverse mode; maps by `vmap` over any number of axes.
    """
    chain = _Chain(tables)

    def solve(q: Batch, v: Batch, tau: Batch) -> tuple[Batch]:
        return (_accelerations(chain, q, v, tau)[0],)

    def solve_and_keep(q: Batch, v: Batch, tau: Batch) -> tuple[Batch, jax.Array, jax.Array]:
        return _accelerations(chain, q, v, tau)

    def pull_back(v: Batch, a: Batch, factor: jax.Array, world: jax.Array, a_bar: Batch) -> tuple[Batch, ...]:
        return _pull_back(chain, v, a, factor, world, a_bar)

    alone, kept, back = batch_last(solve), batch_last(solve_and_keep), batch_last(pull_back)

    @jax.custom_vjp
    def accelerations(q: Joints, v: Joints, tau: Joints) -> Joints:
        return alone(q, v, tau)[0]

    def forward(q: Joints, v: Joints, tau: Joints) -> tuple[Joints, tuple[jax.Array, ...]]:
        a, factor, world = kept(q, v, tau)
        return a, (v, a, factor, world)

    def reverse(residuals: tuple[jax.Array, ...], a_bar: Joints) -> tuple[jax.Array, ...]:
        return back(*residuals, a_bar)

    accelerations.defvjp(forward, reverse)
    return accelerations


def inverse_dynamics(tables: ArmTables) -> ForwardDynamics:
    """τ = M(q) q̈ + h(q, q̇) in Nm on the link side, from q, q̇, q̈, each `[n]`."""
    chain = _Chain(tables)

    def torque(q: Batch, v: Batch, a: Batch) -> tuple[Batch]:
        return (_newton_euler(chain, _world(chain, q), v, a) + chain.column(tables.armature, a) * a,)

    mapped = batch_last(torque)
    return lambda q, v, a: mapped(q, v, a)[0]


def mass_matrix(tables: ArmTables) -> Callable[[Joints], Float[jax.Array, "n n"]]:
    """M(q) in kg m², with the armature on its diagonal, from q `[n]`."""
    chain = _Chain(tables)

    def matrix(q: Batch) -> tuple[jax.Array]:
        upper = _mass(chain, _world(chain, q))
        rows = [[upper[min(j, k)][max(j, k)] for k in range(chain.n)] for j in range(chain.n)]
        return (jnp.stack([jnp.stack([jnp.broadcast_to(m, q[0].shape) for m in row]) for row in rows]),)

    mapped = batch_last(matrix)
    return lambda q: mapped(q)[0]


def batch_last(function: Callable[..., tuple[jax.Array, ...]]) -> Callable[..., tuple[jax.Array, ...]]:
    """A function of arrays `[..., batch]` becomes one of arrays `[...]` that `vmap` maps as a whole, batch last.

    JAX's own batching puts the new axis first, where it is of no use to vector instructions.
    """

    @jax.custom_batching.custom_vmap
    def one(*arrays: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(a[..., 0] for a in function(*(a[..., None] for a in arrays)))

    @one.def_vmap
    def all_together(size: int, batched: Any, *arrays: jax.Array) -> tuple[tuple[jax.Array, ...], tuple[bool, ...]]:
        def last(a: jax.Array, mapped: bool) -> jax.Array:
            return jnp.moveaxis(a, 0, -1) if mapped else jnp.broadcast_to(a[..., None], (*a.shape, size))

        found = function(*(last(a, mapped) for a, mapped in zip(arrays, batched, strict=True)))
        return tuple(jnp.moveaxis(a, -1, 0) for a in found), (True,) * len(found)

    return one


class _World(NamedTuple):
    """axes: motion of a unit velocity of every joint, S_i, 6 components; inertias of the links; all at the origin."""

    axes: Vector
    inertias: Inertias


class _Chain:
    """The tables as constants of the compiled program, and sums along its branches."""

    def __init__(self, tables: ArmTables) -> None:
        self.tables, self.n, self.parents = tables, tables.n, tables.parents
        self.rotation = np.stack([tables.rotation[i] @ turn_z(tables.offset[i]) for i in range(tables.n)])

    def column(self, values: np.ndarray, like: jax.Array) -> jax.Array:
        return jnp.asarray(values, like.dtype)[:, None]

    def towards_tips(self, own: jax.Array) -> jax.Array:
        """`[..., n, batch]`: per link the sum over the joints between it and the base, its own among them."""
        rows: list[jax.Array] = []
        for i, parent in enumerate(self.parents):
            rows.append(own[..., i, :] if parent < 0 else rows[parent] + own[..., i, :])
        return jnp.stack(rows, -2)

    def towards_base(self, own: jax.Array) -> jax.Array:
        """`[..., n, batch]`: per joint the sum over the links that it carries."""
        rows = [own[..., i, :] for i in range(self.n)]
        for i in reversed(range(self.n)):
            if self.parents[i] >= 0:
                rows[self.parents[i]] = rows[self.parents[i]] + rows[i]
        return jnp.stack(rows, -2)

    def below(self, k: int) -> list[int]:
        """The joints between joint k and the base, without k."""
        found = []
        while (k := self.parents[k]) >= 0:
            found.append(k)
        return found


def _accelerations(chain: _Chain, q: Batch, v: Batch, tau: Batch) -> tuple[Batch, jax.Array, jax.Array]:
    """q̈, and what its derivative needs: the factors of M and the world's axes and inertias."""
    world = _world(chain, q)
    factor = _factorise(chain, _mass(chain, world))
    a = _solve(chain, factor, tau - _newton_euler(chain, world, v, None))
    return a, factor, jnp.stack([*world.axes, *world.inertias.first, *world.inertias.second])


def _world(chain: _Chain, q: Batch) -> _World:
    tables = chain.tables
    rotation, p = _frames(chain, q)
    axis = [rotation[a][2] for a in range(3)]
    axes = axis + cross(p, axis)
    mass = chain.column(tables.mass, q)
    center = [p[a] + sum(rotation[a][k] * chain.column(tables.center[:, k], q) for k in range(3)) for a in range(3)]
    first = scale(mass, center)
    half = [
        [sum(rotation[a][k] * chain.column(tables.inertia[:, k, b], q) for k in range(3)) for b in range(3)]
        for a in range(3)
    ]

    def second(a: int, b: int) -> jax.Array:
        turned = sum((half[a][k] * rotation[b][k] for k in range(1, 3)), half[a][0] * rotation[b][0])
        return turned - first[a] * center[b] + (dot(first, center) if a == b else 0.0)

    moments = [second(a, b) for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return _World(axes, Inertias(mass, first, moments))


def _frames(chain: _Chain, q: Batch) -> tuple[list[list[jax.Array]], Vector]:
    """Rotation matrices, `[row][column] -> [n, batch]`, and origins of the joint frames in the world.

    The barriers keep the compiler from computing a link's frame again in every link behind it (0.3 µs of 1.0).
    """
    keep = jax.lax.optimization_barrier
    c, s = keep((jnp.cos(q), jnp.sin(q)))
    turned: list[list[jax.Array]] = []
    origins: list[jax.Array] = []
    for i, parent in enumerate(chain.parents):
        fixed, shift = chain.rotation[i], chain.tables.position[i]
        if parent < 0:
            x, y, z = (jnp.broadcast_to(chain.column(fixed[:, k], q), (3, q.shape[1])) for k in range(3))
            origin = jnp.broadcast_to(chain.column(shift, q), (3, q.shape[1]))
        else:
            x, y, z = (_combine(fixed[:, k], turned[parent]) for k in range(3))
            origin = origins[parent] + _combine(shift, turned[parent])
        ci, si = c[i : i + 1], s[i : i + 1]
        *columns, origin = keep((ci * x + si * y, ci * y - si * x, z, origin))
        turned.append(columns)
        origins.append(origin)
    *stacked, p = keep((*(jnp.stack([t[k] for t in turned], 1) for k in range(3)), jnp.stack(origins, 1)))
    return [[stacked[b][a] for b in range(3)] for a in range(3)], [p[a] for a in range(3)]


def _combine(weights: np.ndarray, columns: list[jax.Array]) -> jax.Array:
    """Σ weight · column with the zeros and ones of the tables folded away."""
    terms = [c if w == 1 else float(w) * c for w, c in zip(weights, columns, strict=True) if abs(w) > 1e-15]
    return sum(terms[1:], terms[0]) if terms else jnp.zeros_like(columns[0])


def _newton_euler(chain: _Chain, world: _World, v: Batch, a: Batch | None) -> Batch:
    """τ of the links without the armature; a None: h(q, q̇), with q̈ = 0."""
    own = scale(v, world.axes)
    velocity = list(chain.towards_tips(jnp.stack(own)))
    gain = motion_cross(velocity, own)
    if a is not None:
        gain = plus(gain, scale(a, world.axes))
    acceleration = _with_gravity(chain, chain.towards_tips(jnp.stack(gain)))
    force = plus(momentum(world.inertias, acceleration), force_cross(velocity, momentum(world.inertias, velocity)))
    return dot(world.axes, list(chain.towards_base(jnp.stack(force))))


def _with_gravity(chain: _Chain, acceleration: jax.Array) -> Vector:
    """A base that accelerates against gravity gives every link its weight."""
    gravity = chain.tables.gravity
    return [*acceleration[:3], *(acceleration[3 + k] - float(gravity[k]) for k in range(3))]


def _mass(chain: _Chain, world: _World) -> list[list[Any]]:
    """M_jk for j ≤ k; zero where neither joint carries the other."""
    one = jnp.ones_like(world.axes[0])
    own = [one * world.inertias.mass, *world.inertias.first, *world.inertias.second]
    carried = chain.towards_base(jnp.stack(own))
    composite = Inertias(carried[0], list(carried[1:4]), list(carried[4:]))
    force = momentum(composite, world.axes)
    product = sum(s[:, None] * f[None, :] for s, f in zip(world.axes, force, strict=True))
    assert isinstance(product, jax.Array)
    upper: list[list[Any]] = [[0.0] * chain.n for _ in range(chain.n)]
    for k in range(chain.n):
        upper[k][k] = product[k, k] + float(chain.tables.armature[k])
        for j in chain.below(k):
            upper[j][k] = product[j, k]
    return upper


def _factorise(chain: _Chain, upper: list[list[Any]]) -> jax.Array:
    """L_kj for every j below k, then 1 / D_k, with M = LᵀDL; in this order branches stay zero."""
    m = [list(row) for row in upper]
    rows: list[jax.Array] = []
    inverse = [jnp.zeros(())] * chain.n
    for k in reversed(range(chain.n)):
        inverse[k] = 1.0 / m[k][k]
        below = chain.below(k)
        factors = {j: m[j][k] * inverse[k] for j in below}
        for i in below:
            for j in below:
                if j <= i:
                    m[j][i] = m[j][i] - factors[i] * m[j][k]
        rows += factors.values()
    return jnp.stack(rows + inverse)


def _solve(chain: _Chain, factor: jax.Array, b: Batch) -> Batch:
    """M⁻¹ b: Lᵀ, D and L in turn."""
    lower: dict[tuple[int, int], jax.Array] = {}
    for k in reversed(range(chain.n)):
        for j in chain.below(k):
            lower[k, j] = factor[len(lower)]
    x = [b[i] for i in range(chain.n)]
    for k in reversed(range(chain.n)):
        for j in chain.below(k):
            x[j] = x[j] - lower[k, j] * x[k]
    x = [x[k] * factor[len(lower) + k] for k in range(chain.n)]
    for k in range(chain.n):
        for j in reversed(chain.below(k)):
            x[k] = x[k] - lower[k, j] * x[j]
    return jnp.stack(x)


def _pull_back(
    chain: _Chain, v: Batch, a: Batch, factor: jax.Array, world: jax.Array, a_bar: Batch
) -> tuple[Batch, Batch, Batch]:
    """Cotangents of q, q̇ and τ.

    λᵀτ = Σ_i Λ_iᵀ f_i with Λ_i = Σ S_j λ_j, and f_i = I_i a_i + v_i ×* I_i v_i. Turning joint k turns all it carries
    about S_k, which changes nothing but what these links inherit from the parent p of link k; with sums over the links
    that k carries, F = Σ f_i, Π = Σ I_i Λ_i, and B = Σ (v_i ×* I_i Λ_i - Λ_i ×* I_i v_i - I_i (v_i × Λ_i)) - v_p ×* Π,

        ∂λᵀτ/∂q_k = -S_kᵀ (Λ_p ×* F + a_p ×* Π + v_p ×* B),         ∂λᵀτ/∂q̇_k = S_kᵀ (B - v_p ×* Π)
    """
    tau_bar = _solve(chain, factor, a_bar)
    axes = list(world[:6])
    inertias = Inertias(chain.column(chain.tables.mass, v), list(world[6:9]), list(world[9:]))
    own_v, own_pull = scale(v, axes), scale(tau_bar, axes)
    both = chain.towards_tips(jnp.stack(own_v + own_pull))
    velocity, pull = list(both[:6]), list(both[6:])
    gain = plus(motion_cross(velocity, own_v), scale(a, axes))
    acceleration = _with_gravity(chain, chain.towards_tips(jnp.stack(gain)))

    moving = momentum(inertias, velocity)
    force = plus(momentum(inertias, acceleration), force_cross(velocity, moving))
    pulled = momentum(inertias, pull)
    turning = minus(force_cross(velocity, pulled), force_cross(pull, moving))
    turning = minus(turning, momentum(inertias, motion_cross(velocity, pull)))
    carried = chain.towards_base(jnp.stack(force + pulled + turning))
    f, pi = list(carried[:6]), list(carried[6:12])

    of_parent = minus(velocity, own_v)
    b = minus(list(carried[12:]), force_cross(of_parent, pi))
    by_q = plus(
        force_cross(minus(pull, own_pull), f), force_cross(minus(acceleration, gain), pi), force_cross(of_parent, b)
    )
    return dot(axes, by_q), -dot(axes, minus(b, force_cross(of_parent, pi))), tau_bar
