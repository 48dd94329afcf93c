"""How the joints of an arm move and what torques nobody models, as Gaussian processes: the prior of its filter.

    q⃛ = -c q̈ - (σ_q̈ / σ_q̇)² q̇ - c (σ_q̇ / σ_q)² (q - q̄) + w        w white
    d_t = e^{-dt / T_d} d_{t-1} + w                                   var d = σ_d² + σ_r² P(at rest)

The stationary standard deviations of q - q̄, q̇ and q̈ are σ_q, σ_q̇ and σ_q̈ whatever the damping c > 0.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Parameter

Joints = Float[jax.Array, " n"]
PerJoint = Float[jax.Array, "n 3 3"]
OF_ALL_JOINTS = ("damping", "time")  # the others are per joint
_TERMS, _HALVINGS = 10, 4  # of an exponential: errors below 1e-7 where the norm of A dt is at most 16
_NODES, _WEIGHTS = (part.tolist() for part in np.polynomial.legendre.leggauss(4))


class FilterNumbers(NamedTuple):
    """Per joint `[n]`. mean: position that a motion returns to, rad; position, speed, acceleration: standard deviations
    of q, q̇, q̈ (rad, s); moving, resting: of d while the joint moves and what comes to it at rest, motor torque, Nm;
    noise: of v, Nm; slow: speed below which a joint is at rest, rad/s. One in all: damping: how fast a motion forgets,
    1/s; time: of d, s."""

    mean: Any
    position: Any
    speed: Any
    acceleration: Any
    moving: Any
    resting: Any
    noise: Any
    slow: Any
    damping: Any
    time: Any


_POSITIVE = (1e-9, float("inf"))
MEANINGS = FilterNumbers(
    mean=Parameter("q̄", "rad"),
    position=Parameter("σ_q", "rad", bounds=_POSITIVE),
    speed=Parameter("σ_q̇", "rad/s", bounds=_POSITIVE),
    acceleration=Parameter("σ_q̈", "rad/s²", bounds=_POSITIVE),
    moving=Parameter("σ_d", "Nm", bounds=_POSITIVE),
    resting=Parameter("σ_r", "Nm", bounds=_POSITIVE),
    noise=Parameter("σ_v", "Nm", bounds=_POSITIVE),
    slow=Parameter("v_r", "rad/s", bounds=_POSITIVE),
    damping=Parameter("c", "1/s", bounds=_POSITIVE),
    time=Parameter("T_d", "s", bounds=_POSITIVE),
)


def motion(numbers: FilterNumbers, dt: float) -> tuple[PerJoint, PerJoint]:
    """What takes [q - q̄, q̇, q̈] from one sample to the next, and the covariance of what w adds on the way."""
    stiff, inert = (numbers.speed / numbers.position) ** 2, (numbers.acceleration / numbers.speed) ** 2
    last = jnp.stack([-numbers.damping * stiff, -inert, -numbers.damping * jnp.ones_like(stiff)], -1)
    a = jnp.stack([*jnp.broadcast_to(jnp.eye(3, dtype=last.dtype)[1:, None], (2, *last.shape)), last], 1)
    power = 2 * numbers.damping * numbers.speed**2 * (inert - stiff)

    def over(time: float) -> jax.Array:
        term = total = jnp.broadcast_to(jnp.eye(3, dtype=last.dtype), a.shape)
        for k in range(1, _TERMS + 1):
            term = a @ term * (time / 2**_HALVINGS / k)
            total = total + term
        for _ in range(_HALVINGS):
            total = total @ total
        return total

    added = jnp.zeros_like(a)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        column = over(dt * (node + 1) / 2)[..., 2]
        added = added + weight * dt / 2 * column[:, :, None] * column[:, None, :]
    return over(dt), power[:, None, None] * added


def starting(numbers: FilterNumbers, *, at_rest: bool) -> Float[jax.Array, "z z"]:
    """Covariance of z at the beginning of a record."""
    n = len(numbers.mean)
    torque = numbers.moving**2 + numbers.resting**2
    if at_rest:
        return jnp.diag(jnp.concatenate([jnp.zeros(3 * n, torque.dtype), torque]))
    together = -(numbers.speed**2)
    whole = jnp.diag(
        jnp.concatenate([numbers.position**2, numbers.speed**2, numbers.acceleration**2, torque]).astype(torque.dtype)
    )
    each = np.arange(n)
    return whole.at[each, each + 2 * n].set(together).at[each + 2 * n, each].set(together)


def disturbance(numbers: FilterNumbers, v: Joints, variance: Joints) -> Joints:
    """Stationary variance of d, by how likely a speed is one of rest: the mean of exp(-q̇² / 2 v_r²)."""
    whole = numbers.slow**2 + variance
    at_rest = numbers.slow / jnp.sqrt(whole) * jnp.exp(-(v**2) / whole / 2)
    return numbers.moving**2 + numbers.resting**2 * at_rest
