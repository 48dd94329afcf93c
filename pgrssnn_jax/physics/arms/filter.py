"""Positions of an arm from its motor torques alone: an extended Kalman filter that takes a torque as a measurement.

    z = [q, q̇, q̈, d]      each joint's motion a stationary Gaussian process of order three, d a slow torque that the
                           model does not know:    z_t = F z_{t-1} + w,    w ~ N(0, Q(z))
    u = D⁻¹ (M q̈ + h - τ(q, q̇)) + d + v           v ~ N(0, R(z)), motor torque, Nm (`residual.py`)

Torques integrated forward twice drift; here they correct a motion that returns to its mean, and nothing measured but
u_{1:t} is fed in. u_t is that of the motion before it, which it corrects; x_t is then the prediction dt later. Friction
jumps where a joint turns round: what enters is its mean over the direction, and its variance is noise,

    E τ = Φ τ(q̇₊) + (1 - Φ) τ(q̇₋)        Φ = P(q̇ > 0),  q̇± = E(q̇ | q̇ ≷ 0)

which is exact for Coulomb and for viscous friction. A joint at rest is held by its friction or a brake against any
torque within their reach, so that d is larger there. x = [q, q̇, q̈, d, the lower triangle of cov z less that of the
start]; networks neither see nor correct the covariance. Limits of velocities and stops do not act.
Source: Särkkä, Bayesian Filtering and Smoothing, 2013, chapter 5.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr
from jax.scipy.stats import norm
from jaxtyping import Float

from pgrssnn_jax.physics.arms.motion_prior import FilterNumbers, disturbance, motion, starting
from pgrssnn_jax.physics.arms.points import ArmPoints
from pgrssnn_jax.physics.arms.residual import drive_slope, required_torque
from pgrssnn_jax.physics.base import Signal, Step

Joints = Float[jax.Array, " n"]
Matrix = Float[jax.Array, "z z"]
_FURTHEST = 6.0  # standard deviations between a speed and zero: further away, its direction is certain
_SHARPEST = 0.1  # of the speed of rest: what a speed is unsure by at the least, so that friction has a slope


def filter_states(n: int) -> tuple[Signal, ...]:
    """What the filter has besides [q, q̇]."""
    joints = range(1, n + 1)
    return (
        *(Signal(f"acceleration_{i}", "rad/s²") for i in joints),
        *(Signal(f"disturbance_{i}", "Nm") for i in joints),
        *(Signal(f"covariance_{i}_{k}", inner=True) for i in range(1, 4 * n + 1) for k in range(1, i + 1)),
    )


def filter_step(points: ArmPoints, dt: float, *, at_rest: bool, limits: bool) -> Step:
    """at_rest: a record begins with all joints at rest where x_0 says, and not anywhere in the range of the motion;
    limits: do those of the positions act?"""
    n = points.tables.n
    bounds = (points.tables.position_min, points.tables.position_max) if limits else (-np.inf, np.inf)
    rows, columns = np.tril_indices(4 * n)
    place = np.zeros((4 * n, 4 * n), int)
    place[rows, columns] = place[columns, rows] = np.arange(len(rows))

    def step(p: Any, x: Float[jax.Array, " x"], u: Joints) -> Float[jax.Array, " x"]:
        assert points.filter is not None
        numbers = points.filter(p)
        start = starting(numbers, at_rest=at_rest)
        z, cov = _updated(points, p, numbers, dt, x[: 4 * n], x[4 * n :][place] + start, u)
        z, cov = _predicted(numbers, dt, z, cov)
        q = jnp.clip(z[:n], *(jnp.asarray(bound, x.dtype) for bound in bounds))
        return jnp.concatenate([q, z[n:], (cov - start)[rows, columns]])

    return step


def _updated(
    points: ArmPoints, p: Any, numbers: FilterNumbers, dt: float, z: jax.Array, cov: Matrix, u: Joints
) -> tuple[jax.Array, Matrix]:
    """z and its covariance once the torque u is known."""
    n = len(u)
    spread = jnp.sqrt(_variances(cov)[1] + (_SHARPEST * numbers.slow) ** 2)
    error, by_motion, unsure = linearised(points, p, dt, z[: 3 * n], spread, u)
    by_z = jnp.concatenate([-by_motion, jnp.eye(n, dtype=z.dtype)], 1)
    noise = numbers.noise**2 + unsure
    seen = cov @ by_z.T
    gain = jnp.linalg.solve(by_z @ seen + jnp.diag(noise), seen.T).T
    return z + gain @ (error - z[3 * n :]), cov - gain @ seen.T


def linearised(
    points: ArmPoints, p: Any, dt: float, motion: jax.Array, spread: Joints, u: Joints
) -> tuple[Joints, Float[jax.Array, "n m"], Joints]:
    """Mean torque residual of a motion [q, q̇, q̈], its derivative by the motion, and the variance that friction of an
    unknown direction adds; spread: standard deviation of the speeds, rad/s."""

    def both(v: Joints, reading: Joints, drive: Joints) -> tuple[Joints, Joints, Joints]:
        """P(q̇ > 0), and the torque in either direction."""
        z = jnp.clip(v / spread, -_FURTHEST, _FURTHEST)
        density, forwards = norm.logpdf(z), log_ndtr(z)
        ahead, back = jnp.exp(density - forwards), jnp.exp(density - log_ndtr(-z))
        q = points.position(p, reading)
        speeds = (v + spread * ahead, v - spread * back)
        torques = [points.torque(p, q, speed, drive) for speed in speeds]
        return jnp.exp(forwards), torques[0], torques[1]

    def mean(v: Joints, reading: Joints, drive: Joints) -> Joints:
        share, ahead, back = both(v, reading, drive)
        return share * ahead + (1 - share) * back

    def residual(motion: jax.Array) -> tuple[Joints, Joints]:
        reading, v, a = jnp.split(motion, 3)
        required = required_torque(points, p, dt, reading[:, None], v[:, None], a[:, None])[:, 0]
        found = mean(v, reading, points.drive(p, u)) - required
        return found, found

    slope, error = jax.jacfwd(residual, has_aux=True)(motion)
    reading, v, _ = jnp.split(motion, 3)
    (share, ahead, back), one = both(v, reading, drive := points.drive(p, u)), jnp.ones_like(v)
    by_speed = jax.jvp(lambda v: mean(v, reading, drive), (v,), (one,))[1]
    passed_on = jax.jvp(lambda drive: mean(v, reading, drive), (drive,), (one,))[1]
    unsure = share * (1 - share) * (ahead - back) ** 2 - (by_speed * spread) ** 2
    by_motor = passed_on[:, None] * drive_slope(points, p, u)
    inverted = jnp.linalg.inv(by_motor)
    return inverted @ error, inverted @ slope, jnp.maximum(unsure, 0) / jnp.diag(by_motor) ** 2


def _predicted(numbers: FilterNumbers, dt: float, z: jax.Array, cov: Matrix) -> tuple[jax.Array, Matrix]:
    """z and its covariance dt later."""
    n = len(numbers.mean)
    kernel, noise = motion(numbers, dt)
    kept, each = jnp.exp(-dt / numbers.time), np.arange(n)
    blocks = _moved(kernel, kept, cov)
    both = _moved(kernel, kept, blocks.T)
    added = jnp.zeros((4, n, 4, n), z.dtype).at[:3, each, :3, each].set(noise)
    added = added.at[3, each, 3, each].set((1 - kept**2) * disturbance(numbers, z[n : 2 * n], _variances(cov)[1]))
    mean = jnp.concatenate([numbers.mean, jnp.zeros(3 * n, z.dtype)])
    return mean + _moved(kernel, kept, z - mean), both + added.reshape(4 * n, 4 * n)


def _moved(kernel: Float[jax.Array, "n 3 3"], kept: jax.Array, z: Float[jax.Array, "z *columns"]) -> jax.Array:
    """F z, for every column of z."""
    n = len(kernel)
    q, v, a, d = (z[k * n : (k + 1) * n] for k in range(4))
    by = [[kernel[:, i, k].reshape(n, *(1,) * (z.ndim - 1)) for k in range(3)] for i in range(3)]
    return jnp.concatenate([*(row[0] * q + row[1] * v + row[2] * a for row in by), kept * d])


def _variances(cov: Matrix) -> Float[jax.Array, "4 n"]:
    return jnp.maximum(jnp.diag(cov), 0).reshape(4, -1)
