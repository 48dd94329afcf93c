"""Torque residual of an arm's model: the applied torque minus the one that the measured motion requires.

    e = u - û,   τ(q, q̇, drive(û)) = M q̈ + h        motor torque, Nm; zero where the model is right

What a step adds to the velocities after its torques have acted, S times the velocity of the sample before, say, is
divided by dt and subtracted from q̈. drive(u) is assumed to be linear in u; τ of a joint to depend on no other joint's
drive, to grow with its own, and to be linear in it on either side of zero. Samples are columns, `[n, batch]`.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

from pgrssnn_jax.physics.arms.chain import Batch
from pgrssnn_jax.physics.arms.derivatives import Matrix
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.points import ArmPoints, Joints


def required_torque(points: ArmPoints, p: Any, dt: float, reading: Batch, v: Batch, a: Batch) -> Batch:
    """M q̈ + h, Nm on the link side."""
    return points.inverse(p, *inverse_inputs(points, p, dt, reading, v, a))


def required_slopes(points: ArmPoints, p: Any, dt: float, reading: Batch, v: Batch, a: Batch) -> tuple[Batch, Matrix]:
    """The same with its derivative by `inverse_inputs`."""
    return points.inverse_slopes(p, *inverse_inputs(points, p, dt, reading, v, a))


def inverse_inputs(
    points: ArmPoints, p: Any, dt: float, reading: Batch, v: Batch, a: Batch
) -> tuple[Batch, Batch, Batch, Extra]:
    """q, q̇, q̈ and masses that the inverse dynamics of a motion take."""
    assert points.masses is not None
    q = jax.vmap(points.position, (None, 1), 1)(p, reading)
    disturbed = jax.vmap(partial(points.disturbance, p), (1, 1), 1)

    def added(before: Batch) -> Batch:
        states = jnp.concatenate([reading - dt * v, before]), jnp.concatenate([reading, v])
        return disturbed(*states)[len(v) :] - v

    before = v - dt * a
    before += added(before) / 2  # measured speeds are the mean of those before and after something is added
    return q, v, a - added(before) / dt, points.masses(p)


def torque_residual(points: ArmPoints, p: Any, required: Batch, reading: Batch, v: Batch, u: Batch) -> Batch:
    """e, Nm on the motor side, of a motion that requires the torque `required`."""
    q = jax.vmap(points.position, (None, 1), 1)(p, reading)
    drive = jax.vmap(points.drive, (None, 1), 1)(p, u)
    torque = partial(jax.vmap(points.torque, (None, 1, 1, 1), 1), p, q, v)

    def step(needed: Batch) -> tuple[Batch, Batch]:
        given, passed_on = jax.jvp(torque, (needed,), (jnp.ones_like(drive),))
        return needed - (given - required) / passed_on, passed_on

    # The first step finds the side of zero: that of the measured torque would tell what is to be predicted.
    needed, passed_on = jax.lax.stop_gradient(step(step(drive)[0]))
    # Where torque = required, one more step changes no value and carries the derivative of the solution.
    needed -= (torque(needed) - required) / passed_on
    return jnp.linalg.inv(drive_slope(points, p, u[:, 0])) @ (drive - needed)


def drive_slope(points: ArmPoints, p: Any, u: Float[jax.Array, " n"]) -> Float[jax.Array, "n n"]:
    """∂drive/∂u, the same for every u."""
    return jax.jacfwd(lambda torque: points.drive(p, torque))(jnp.zeros_like(u))


def torque_slope(points: ArmPoints, p: Any, q: Joints, v: Joints, u: Joints) -> Float[jax.Array, "n n"]:
    """D of one sample."""
    return jax.jacfwd(lambda torque: points.torque(p, q, v, points.drive(p, torque)))(u)
