"""The dynamics of an arm in world axes, many samples at once.

    τ = M(q) q̈ + h(q, q̇)          M from composite inertias, h by Newton-Euler, M = LᵀDL by elimination from the tips

Everything is written about the world's origin, where sums along the chain are plain sums: v_i = Σ S_j q̇_j over the
joints j between base and link i, τ_j = S_jᵀ Σ f_i over the links i that j carries. Links are stacked and the batch
comes last (`[n, batch]`), which the compiler turns into long vector loops.
Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.spatial import (
    Inertias,
    Vector,
    cross,
    dot,
    force_cross,
    momentum,
    motion_cross,
    plus,
    scale,
)
from pgrssnn_jax.physics.arms.tables import ArmTables, turn_z

Batch = Float[jax.Array, "n batch"]


class World(NamedTuple):
    """axes: motion of a unit velocity of every joint, S_i, 6 components; inertias of the links; all at the origin.
    point: where the payload is, m, and how it moves by each number of its place, 4 · 3 components `[1, batch]`; unit:
    first and second moments of a link by its mass, 9 components `[n, batch]`, where `Extra.links` are."""

    axes: Vector
    inertias: Inertias
    point: Vector | None = None
    unit: Vector | None = None

    def packed(self) -> tuple[jax.Array, ...]:
        """As one array, and others of what the tables do not say."""
        rows = jnp.stack([*self.axes, *self.inertias.first, *self.inertias.second])
        more = [jnp.stack(part) for part in (self.point, self.unit) if part is not None]
        return (rows, self.inertias.mass, *more) if more else (rows,)


class Chain:
    """The tables as constants of the compiled program, and sums along its branches."""

    def __init__(self, tables: ArmTables) -> None:
        self.tables, self.n, self.parents = tables, tables.n, tables.parents
        self.rotation = np.stack([tables.rotation[i] @ turn_z(tables.offset[i]) for i in range(tables.n)])
        self.outwards = -1.0 if tables.tip[2] < 0 else 1.0  # from the last joint to the tip, along its axis

    def column(self, values: np.ndarray, like: jax.Array) -> jax.Array:
        return jnp.asarray(values, like.dtype)[:, None]

    def last(self, like: jax.Array) -> jax.Array:
        """1 for the last link, 0 for the others, `[n, 1]`."""
        return self.column(np.arange(self.n) == self.n - 1, like)

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


def accelerations(chain: Chain, q: Batch, v: Batch, tau: Batch, extra: Extra) -> tuple[Batch, jax.Array, World]:
    """q̈, and what its derivative needs: the factors of M and the world's axes and inertias."""
    world = world_at(chain, q, extra)
    factor = factorise(chain, mass(chain, world, extra))
    a = solve(chain, factor, tau - bias(chain, world, v, extra))
    return a, factor, world


def world_at(chain: Chain, q: Batch, extra: Extra) -> World:
    tables = chain.tables
    rotation, p = _frames(chain, q)
    axis = [rotation[a][2] for a in range(3)]
    axes = axis + cross(p, axis)
    mass = chain.column(tables.mass, q)
    center = [p[a] + sum(rotation[a][k] * chain.column(tables.center[:, k], q) for k in range(3)) for a in range(3)]
    inertia = tables.inertia
    if extra.links is not None:  # of a unit mass
        inertia = inertia / np.where(tables.mass > 0, tables.mass, np.inf)[:, None, None]
    first = center if extra.links is not None else scale(mass, center)
    half = [
        [sum(rotation[a][k] * chain.column(inertia[:, k, b], q) for k in range(3)) for b in range(3)] for a in range(3)
    ]

    def second(a: int, b: int) -> jax.Array:
        turned = sum((half[a][k] * rotation[b][k] for k in range(1, 3)), half[a][0] * rotation[b][0])
        return turned - first[a] * center[b] + (dot(first, center) if a == b else 0.0)

    moments = [second(a, b) for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    found = World(axes, Inertias(mass, first, moments))
    if extra.links is not None:
        mass += extra.links
        found = World(axes, Inertias(mass, scale(mass, first), scale(mass, moments)), unit=[*first, *moments])
    if extra.payload is None:
        return found
    tip = [p[a][-1:] + sum(rotation[a][k][-1:] * float(tables.tip[k]) for k in range(3)) for a in range(3)]
    along = [chain.outwards * rotation[a][2][-1:] for a in range(3)]
    across = [[rotation[a][k][-1:] for a in range(3)] for k in range(2)]
    return _loaded(chain, found, tip, [along, *across], extra.payload)


def _loaded(chain: Chain, world: World, tip: Vector, directions: list[Vector], payload: jax.Array) -> World:
    """The last link carries a mass μ at r: mass μ, first moment μ r, second moment μ ((|r|² + κ²) 1 - r rᵀ)."""
    heavy = payload[:1]
    r = plus(tip, *(scale(payload[k : k + 1], d) for k, d in enumerate(directions, 1)))  # three numbers of its place
    squares, own = [c * c for c in r], payload[4:5] ** 2
    inner = [own + squares[1] + squares[2], own + squares[0] + squares[2], own + squares[0] + squares[1]]
    mixed = [-r[0] * r[1], -r[0] * r[2], -r[1] * r[2]]
    on_last = chain.last(heavy) * heavy
    mass, first, second = world.inertias
    return world._replace(
        inertias=Inertias(mass + on_last, plus(first, scale(on_last, r)), plus(second, scale(on_last, inner + mixed))),
        point=[*r, *(part for direction in directions for part in direction)],
    )


def unpacked(chain: Chain, packed: Sequence[jax.Array], extra: Extra) -> World:
    """The inverse of `World.packed`."""
    rows, *more = packed
    mass = more.pop(0) if more else chain.column(chain.tables.mass, rows)
    point, unit = (None if part is None else list(more.pop(0)) for part in (extra.payload, extra.links))
    return World(list(rows[:6]), Inertias(mass, list(rows[6:9]), list(rows[9:])), point, unit)


def _frames(chain: Chain, q: Batch) -> tuple[list[list[jax.Array]], Vector]:
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


def torques(chain: Chain, world: World, v: Batch, a: Batch, extra: Extra) -> Batch:
    """τ = M(q) q̈ + h(q, q̇)."""
    rotor = 0.0 if extra.rotor is None else extra.rotor
    tau = bias(chain, world, v, extra, a) + (chain.column(chain.tables.armature, a) + rotor) * a
    if extra.wrist is None:
        return tau
    inertia, ratio = extra.wrist
    turning = inertia * (a[-1] + ratio * a[-2])
    return tau.at[-1].add(turning).at[-2].add(ratio * turning)


def bias(chain: Chain, world: World, v: Batch, extra: Extra, a: Batch | None = None) -> Batch:
    """h(q, q̇), the torque without acceleration, by Newton-Euler; with the torque that the links take at q̈ = a."""
    own = scale(v, world.axes)
    velocity = list(chain.towards_tips(jnp.stack(own)))
    gain = motion_cross(velocity, own)
    gain = gain if a is None else plus(gain, scale(a, world.axes))
    acceleration = with_gravity(chain, chain.towards_tips(jnp.stack(gain)), extra)
    force = plus(momentum(world.inertias, acceleration), force_cross(velocity, momentum(world.inertias, velocity)))
    return dot(world.axes, list(chain.towards_base(jnp.stack(force))))


def with_gravity(chain: Chain, acceleration: jax.Array, extra: Extra) -> Vector:
    """A base that accelerates against gravity gives every link its weight."""
    if extra.gravity is None:
        pull = [float(g) for g in chain.tables.gravity]
    else:
        pull = [extra.gravity[k : k + 1] for k in range(3)]
    return [*acceleration[:3], *(acceleration[3 + k] - pull[k] for k in range(3))]


def mass(chain: Chain, world: World, extra: Extra) -> list[list[Any]]:
    """M_jk for j ≤ k; zero where neither joint carries the other."""
    force = momentum(carried_inertias(chain, world), world.axes)
    product = outer(world.axes, force)
    upper: list[list[Any]] = [[0.0] * chain.n for _ in range(chain.n)]
    for k in range(chain.n):
        upper[k][k] = product[k, k] + float(chain.tables.armature[k])
        if extra.rotor is not None:
            upper[k][k] = upper[k][k] + extra.rotor[k]
        for j in chain.below(k):
            upper[j][k] = product[j, k]
    if extra.wrist is not None:
        inertia, ratio = extra.wrist
        last, before = chain.n - 1, chain.parents[-1]
        upper[last][last] = upper[last][last] + inertia
        upper[before][last] = upper[before][last] + ratio * inertia
        upper[before][before] = upper[before][before] + ratio**2 * inertia
    return upper


def carried_inertias(chain: Chain, world: World) -> Inertias:
    """Per joint those of all that it carries."""
    one = jnp.ones_like(world.axes[0])
    own = [one * world.inertias.mass, *world.inertias.first, *world.inertias.second]
    carried = chain.towards_base(jnp.stack(own))
    return Inertias(carried[0], list(carried[1:4]), list(carried[4:]))


def outer(a: Vector, b: Vector) -> Float[jax.Array, "n n batch"]:
    """a_jᵀ b_k for every j and k."""
    product = sum(s[:, None] * f[None, :] for s, f in zip(a, b, strict=True))
    assert isinstance(product, jax.Array)
    return product


def factorise(chain: Chain, upper: list[list[Any]]) -> jax.Array:
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


def solve(
    chain: Chain, factor: jax.Array, b: Float[jax.Array, "n *columns batch"]
) -> Float[jax.Array, "n *columns batch"]:
    """M⁻¹ b: Lᵀ, D and L in turn."""
    lower: dict[tuple[int, int], jax.Array] = {}
    rows = [factor[i] if b.ndim == 2 else factor[i][None] for i in range(len(factor))]
    for k in reversed(range(chain.n)):
        for j in chain.below(k):
            lower[k, j] = rows[len(lower)]
    x = [b[i] for i in range(chain.n)]
    for k in reversed(range(chain.n)):
        for j in chain.below(k):
            x[j] = x[j] - lower[k, j] * x[k]
    x = [x[k] * rows[len(lower) + k] for k in range(chain.n)]
    for k in range(chain.n):
        for j in reversed(chain.below(k)):
            x[k] = x[k] - lower[k, j] * x[j]
    return jnp.stack(x)
