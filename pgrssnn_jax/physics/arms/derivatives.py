"""Derivatives of an arm's forward dynamics in closed form: of the solution, not of the way it was found.

    M q̈ + h = τ      hence      δq̈ = M⁻¹ (δτ - ∂τ/∂q δq - ∂τ/∂q̇ δq̇ - ∂τ/∂β δβ),      ∂τ/∂· at fixed q̈

with β what the arm has besides its tables (`Extra`). Reverse, for a cotangent ā of q̈ and λ = M⁻¹ ā:

    τ̄ = λ,     q̄ = -∂(λᵀ τ)/∂q,     q̇̄ = -∂(λᵀ τ)/∂q̇,     β̄ = -∂(λᵀ τ)/∂β

Turning joint k turns all it carries about S_k, which changes nothing but what these links inherit from the parent p of
link k. Source: Carpentier and Mansard, Analytical derivatives of rigid body dynamics, RSS 2018, here in world axes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.arms.chain import Batch, Chain, World, carried_inertias, outer, solve, with_gravity
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.spatial import (
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
    symmetric,
)

Matrix = Float[jax.Array, "n columns batch"]


class Motion(NamedTuple):
    """velocity and acceleration of the links, with the weight in the latter; gain: what each adds to the acceleration
    of its parent; moving: momentum, force: what moves the link."""

    velocity: Vector
    gain: Vector
    acceleration: Vector
    moving: Vector
    force: Vector


def pull_back(
    chain: Chain, v: Batch, a: Batch, factor: jax.Array, world: World, extra: Extra, a_bar: Batch
) -> tuple[Batch, Batch, Batch, Extra]:
    """Cotangents of q, q̇, τ and β.

    λᵀτ = Σ_i Λ_iᵀ f_i with Λ_i = Σ S_j λ_j, and f_i = I_i a_i + v_i ×* I_i v_i. With sums over the links that k
    carries, F = Σ f_i, Π = Σ I_i Λ_i, and B = Σ (v_i ×* I_i Λ_i - Λ_i ×* I_i v_i - I_i (v_i × Λ_i)) - v_p ×* Π,

        ∂λᵀτ/∂q_k = -S_kᵀ (Λ_p ×* F + a_p ×* Π + v_p ×* B),         ∂λᵀτ/∂q̇_k = S_kᵀ (B - v_p ×* Π)
    """
    tau_bar = solve(chain, factor, a_bar)
    axes, inertias = world.axes, world.inertias
    own_v, own_pull = scale(v, axes), scale(tau_bar, axes)
    both = chain.towards_tips(jnp.stack(own_v + own_pull))
    velocity, pull = list(both[:6]), list(both[6:])
    motion = _motion(chain, world, own_v, velocity, a, extra)

    pulled = momentum(inertias, pull)
    turning = minus(force_cross(velocity, pulled), force_cross(pull, motion.moving))
    turning = minus(turning, momentum(inertias, motion_cross(velocity, pull)))
    carried = chain.towards_base(jnp.stack(motion.force + pulled + turning))
    f, pi = list(carried[:6]), list(carried[6:12])

    of_parent = minus(velocity, own_v)
    b = minus(list(carried[12:]), force_cross(of_parent, pi))
    by_q = plus(
        force_cross(minus(pull, own_pull), f),
        force_cross(minus(motion.acceleration, motion.gain), pi),
        force_cross(of_parent, b),
    )
    extra_bar = jax.tree.map(
        lambda by_beta: -(by_beta * tau_bar[:, None]).sum(0), _by_extra(chain, world, motion, a, extra)
    )
    return dot(axes, by_q), -dot(axes, minus(b, force_cross(of_parent, pi))), tau_bar, extra_bar


def jacobian(chain: Chain, v: Batch, a: Batch, factor: jax.Array, world: World, extra: Extra) -> Matrix:
    """∂q̈/∂(q, q̇, τ, β), `[n, 3 n + β, batch]`."""
    by_q, by_v, _, *by_extra = _slopes(chain, v, a, world, extra)
    identity = jnp.broadcast_to(jnp.eye(chain.n, dtype=v.dtype)[:, :, None], by_q.shape)
    return solve(chain, factor, jnp.concatenate([-by_q, -by_v, identity, *(-by for by in by_extra)], 1))


def inverse_jacobian(chain: Chain, v: Batch, a: Batch, world: World, extra: Extra) -> Matrix:
    """∂τ/∂(q, q̇, q̈, β), `[n, 3 n + β, batch]`."""
    return jnp.concatenate(_slopes(chain, v, a, world, extra), 1)


def _slopes(chain: Chain, v: Batch, a: Batch, world: World, extra: Extra) -> list[Matrix]:
    """∂τ/∂q, ∂τ/∂q̇, ∂τ/∂q̈ = M and ∂τ/∂β of each β.

    With c_k = v_p × S_k, e_k = a_p × S_k + v_p × c_k, and of what the deeper one of the joints i and k carries the
    inertia I, its rate J = Σ (v_i ×* I_i - I_i v_i ×), the momentum h and the force F,

        ∂τ_i/∂q_k = S_iᵀ (I e_k + J c_k + c_k ×* h  [+ S_k ×* F where k is the deeper]),
        ∂τ_i/∂q̇_k = S_iᵀ (2 I c_k + J S_k + S_k ×* h),        M_ik = S_iᵀ I S_k [+ what turns the motors]
    """
    axes, inertias = world.axes, world.inertias
    own_v = scale(v, axes)
    velocity = list(chain.towards_tips(jnp.stack(own_v)))
    motion = _motion(chain, world, own_v, velocity, a, extra)
    whole = carried_inertias(chain, world)
    carried = chain.towards_base(jnp.stack(motion.force + motion.moving + _rate(inertias, velocity)))
    force, moving, rate = (list(part) for part in (carried[:6], carried[6:12], carried[12:]))

    of_parent = minus(velocity, own_v)
    c = motion_cross(of_parent, axes)
    e = plus(motion_cross(minus(motion.acceleration, motion.gain), axes), motion_cross(of_parent, c))
    heavy, changing, held = momentum(whole, axes), _changing(rate, axes), force_cross(axes, moving)
    # rows: i the deeper; columns: k the deeper
    across = minus(changing, held)
    rows_q, rows_v = outer(heavy, e) + outer(across, c), 2.0 * outer(heavy, c) + outer(across, axes)
    by_q = plus(force_cross(axes, force), momentum(whole, e), _changing(rate, c), force_cross(c, moving))
    by_v = plus(scale(jnp.asarray(2.0, v.dtype), momentum(whole, c)), changing, held)
    columns_q, columns_v = outer(axes, by_q), outer(axes, by_v)

    above, deeper = (jnp.asarray(mask, v.dtype) for mask in _kinship(chain))
    pairs = ((columns_q, rows_q), (columns_v, rows_v), (outer(axes, heavy), outer(heavy, axes)))
    by = [above * columns + deeper * rows for columns, rows in pairs]
    by[2] = by[2] + _of_motors(chain, a, extra)
    return [*by, *(p for p in _by_extra(chain, world, motion, a, extra) if p is not None)]


def _of_motors(chain: Chain, a: Batch, extra: Extra) -> Matrix:
    """What the motors add to M."""
    diagonal = (
        jnp.zeros_like(a) + chain.column(chain.tables.armature, a) + (0.0 if extra.rotor is None else extra.rotor)
    )
    added = jnp.eye(chain.n, dtype=a.dtype)[:, :, None] * diagonal[None]
    if extra.wrist is None:
        return added
    inertia, ratio = extra.wrist
    turning = jnp.zeros_like(a).at[-1].set(1.0).at[-2].set(ratio)
    return added + (inertia[None] * turning)[:, None] * turning[None]


def _kinship(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """`[i, k, 1]`: does joint i carry joint k and is not k; does joint k carry joint i or is i."""
    above = np.zeros((chain.n, chain.n, 1))
    for k in range(chain.n):
        above[chain.below(k), k] = 1.0
    return above, np.swapaxes(above, 0, 1) + np.eye(chain.n)[:, :, None]


def _motion(chain: Chain, world: World, own_v: Vector, velocity: Vector, a: Batch, extra: Extra) -> Motion:
    gain = plus(motion_cross(velocity, own_v), scale(a, world.axes))
    acceleration = with_gravity(chain, chain.towards_tips(jnp.stack(gain)), extra)
    moving = momentum(world.inertias, velocity)
    force = plus(momentum(world.inertias, acceleration), force_cross(velocity, moving))
    return Motion(velocity, gain, acceleration, moving, force)


def _rate(inertias: Inertias, velocity: Vector) -> Vector:
    """v ×* I - I v ×, the rate of an inertia that moves with v: first moment (3), second moment (6)."""
    mass, first, (xx, yy, zz, xy, xz, yz) = inertias
    turn, shift = velocity[:3], velocity[3:]
    x, y, z = cross(turn, [xx, xy, xz]), cross(turn, [xy, yy, yz]), cross(turn, [xz, yz, zz])
    mixed = [shift[i] * first[i] for i in range(3)]
    return [
        *plus(scale(mass, shift), cross(turn, first)),
        2.0 * (x[0] + mixed[1] + mixed[2]),
        2.0 * (y[1] + mixed[0] + mixed[2]),
        2.0 * (z[2] + mixed[0] + mixed[1]),
        y[0] + x[1] - shift[0] * first[1] - shift[1] * first[0],
        z[0] + x[2] - shift[0] * first[2] - shift[2] * first[0],
        z[1] + y[2] - shift[1] * first[2] - shift[2] * first[1],
    ]


def _changing(rate: Vector, a: Vector) -> Vector:
    """The rate of an inertia times a motion; no mass comes or goes."""
    first = rate[:3]
    return plus(symmetric(rate[3:], a), cross(first, a[3:])) + cross(a[:3], first)


def _by_extra(chain: Chain, world: World, motion: Motion, a: Batch, extra: Extra) -> Extra:
    """∂τ/∂β at fixed q̈, `[n, β, batch]` of each."""
    return Extra(
        None if extra.payload is None else _by_payload(chain, world, motion, extra.payload),
        None if extra.rotor is None else jnp.eye(chain.n, dtype=a.dtype)[:, :, None] * a[:, None],
        None if extra.gravity is None else _by_gravity(chain, world),
        None if extra.wrist is None else _by_wrist(chain, a, extra.wrist),
        None if extra.links is None else _by_links(chain, world, motion),
    )


def _by_payload(chain: Chain, world: World, motion: Motion, payload: jax.Array) -> Matrix:
    """A mass μ at r pulls with f = μ r̈, r̈ = a + α × r + ω × (v + ω × r), moment r × f + μ κ² α; n: ∂r/∂place."""
    assert world.point is not None
    last = [[component[-1:] for component in vector] for vector in (motion.velocity, motion.acceleration)]
    (w, v), (alpha, a) = ((part[:3], part[3:]) for part in last)
    r, *directions = (world.point[k : k + 3] for k in range(0, len(world.point), 3))
    moved = plus(a, cross(alpha, r), cross(w, plus(v, cross(w, r))))
    gyration, nothing = payload[4:5], [jnp.zeros_like(part) for part in alpha]
    by = [plus(cross(r, moved), scale(gyration**2, alpha)) + moved]
    for n in directions:
        turned = plus(cross(alpha, n), cross(w, cross(w, n)))
        by.append(scale(payload[:1], plus(cross(n, moved), cross(r, turned)) + turned))
    by.append(scale(2.0 * payload[:1] * gyration, alpha) + nothing)
    carries = chain.column(np.isin(np.arange(chain.n), [chain.n - 1, *chain.below(chain.n - 1)]), payload)
    return jnp.stack([carries * dot(world.axes, one) for one in by], 1)


def _by_wrist(chain: Chain, a: Batch, wrist: jax.Array) -> Matrix:
    """Of an inertia I that turns with ẇ = q̈_n + r q̈_{n-1}: (r ẇ, ẇ) by I and I (ẇ + r q̈_{n-1}, q̈_{n-1}) by r, on
    the last two joints."""
    (inertia, ratio), before = wrist, a[-2]
    turning = a[-1] + ratio * before
    by_inertia, by_ratio = [ratio * turning, turning], [inertia * (turning + ratio * before), inertia * before]
    others = [jnp.zeros_like(before)] * (chain.n - 2)
    return jnp.stack([jnp.stack([*others, *by]) for by in (by_inertia, by_ratio)], 1)


def _by_links(chain: Chain, world: World, motion: Motion) -> Matrix:
    """A unit mass of link i asks the joints that carry it for S_kᵀ (I a_i + v_i ×* I v_i), I its inertia."""
    assert world.unit is not None
    unit = Inertias(jnp.ones_like(world.unit[0]), world.unit[:3], world.unit[3:])
    moving = momentum(unit, motion.velocity)
    force = plus(momentum(unit, motion.acceleration), force_cross(motion.velocity, moving))
    above, _ = _kinship(chain)
    carries = jnp.asarray(above + np.eye(chain.n)[:, :, None], force[0].dtype)
    return carries * outer(world.axes, force)


def _by_gravity(chain: Chain, world: World) -> Matrix:
    """-S_kᵀ (c × e, m e) for the first moment c and the mass m of what k carries, and e along each axis of the base."""
    whole, axes = carried_inertias(chain, world), world.axes
    turned = cross(axes[:3], whole.first)  # (s × c)ᵀ e = sᵀ (c × e)
    return -jnp.stack([turned[k] + whole.mass * axes[3 + k] for k in range(3)], 1)
