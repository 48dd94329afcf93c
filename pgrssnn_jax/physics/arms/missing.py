"""By how much the torque of an arm's model misses the one that a motion takes.

    e = D⁻¹ (τ(q, q̇, drive(u)) - M q̈ - h)        D = ∂drive/∂u: motor torque, Nm; zero where the model is right

What a step adds to the velocities once its torques have acted is taken off q̈: S q̇ / dt, say. drive(u) is taken for
linear in u. Samples are columns, `[n, batch]`.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from pgrssnn_jax.physics.arms.chain import Batch
from pgrssnn_jax.physics.arms.points import ArmPoints


def required(points: ArmPoints, p: Any, dt: float, reading: Batch, v: Batch, a: Batch) -> Batch:
    """M q̈ + h, Nm on the link side."""
    assert points.masses is not None
    q = jax.vmap(points.position, (None, 1), 1)(p, reading)
    given = jax.vmap(partial(points.disturbance, p), (1, 1), 1)(state := jnp.concatenate([reading, v]), state)
    return points.inverse(p, q, v, a - (given[len(v) :] - v) / dt, points.masses(p))


def missing(points: ArmPoints, p: Any, needed: Batch, reading: Batch, v: Batch, u: Batch) -> Batch:
    """e, Nm on the motor side, where a motion takes the torque `needed`."""
    q = jax.vmap(points.position, (None, 1), 1)(p, reading)
    drive = jax.vmap(points.drive, (None, 1), 1)(p, u)
    given = jax.vmap(points.torque, (None, 1, 1, 1), 1)(p, q, v, drive)
    by_motor = jax.jacfwd(lambda torque: points.drive(p, torque))(jnp.zeros(len(u), u.dtype))
    return jnp.linalg.solve(by_motor, given - needed)
