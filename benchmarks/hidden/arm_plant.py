"""The true arm under a joint controller; Pinocchio's forward dynamics, Runge-Kutta 4, `sub_steps` steps per sample.

    M(q) q̈ + h(q, q̇) = gain G u + θ - G² B q̇ - G Tc sign(q̇) - k q - c sin(q2 - φ) + a sin(2π f t)     u held
    reading, q̇ within their limits after each sample, then q̇_t += S q̇_{t-1};     reading = q + home
    G u_t  = ID of the arm that the controller knows, along the plan + K (plan - reading) + L (planned velocity - q̇)

rad, Nm; link masses with payload, gravity and friction are in `tables`. Recorded are u and the reading: as on a real
robot the torque holds what the controller had to do against the effect, so that every motion stays feasible.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - its files are in a folder of their own
from jaxtyping import Float

from pgrssnn_jax.data.arm_simulator import Plan, torque
from pgrssnn_jax.physics.arms.tables import ArmTables, pinocchio_model

SAMPLE_TIME, SUB_STEPS = 0.1, 10  # s
_STIFFNESS = 2.0  # rad/s of the controlled joints, well below the sample rate

Joints = Float[np.ndarray, "n"]
Batch = Float[np.ndarray, "n seq"]


class Effects(NamedTuple):
    """Neutral values. bias: θ, Nm on the link side; memory: diagonal of S; gain; home: rad; spring: k, Nm/rad; ripple:
    a, Nm; counterbalance: c, Nm, and φ, rad, of joint 2; hum: f, Hz."""

    bias: Joints = np.zeros(6)
    memory: Joints = np.zeros(6)
    gain: Joints = np.ones(6)
    home: Joints = np.zeros(6)
    spring: Joints | float = 0.0
    ripple: Joints | float = 0.0
    counterbalance: tuple[float, float] = (0.0, 0.0)
    hum: float = 0.0


class Motion(NamedTuple):
    """u: Nm on the motor side; reading: rad, without noise."""

    u: Float[np.ndarray, "seq time n"]
    reading: Float[np.ndarray, "seq time n"]


def controlled(
    known: ArmTables,
    tables: ArmTables,
    effects: Effects,
    plan: Plan,
    dt: float = SAMPLE_TIME,
    home: Joints | float = 0.0,
) -> Motion:
    """The true arm, tables and effects, under a controller that knows another one, and where its encoders are zero."""
    forward = np.moveaxis(torque(known, plan._replace(q=plan.q - home)), 0, 2)  # [time, n, seq]
    q_plan, v_plan = (np.moveaxis(signal, 0, 2) for signal in (plan.q, plan.v))
    model = pinocchio_model(known)
    inertia = np.diag(pin.crba(model, model.createData(), np.zeros(known.n)))[:, None]
    stiff, damp = inertia * _STIFFNESS**2, 2 * inertia * _STIFFNESS

    def command(t: int, reading: Batch, v: Batch) -> Batch:
        start = q_plan[t] - dt / 2 * v_plan[t]  # plans are given at the middle of a sample
        return forward[t] + (stiff * (start - reading) + damp * (v_plan[t] - v)) / known.gear[:, None]

    return _run(tables, effects, command, plan.q.shape, dt, SUB_STEPS)


def free_run(
    tables: ArmTables, effects: Effects, u: Float[np.ndarray, "seq time n"], dt: float, sub_steps: int
) -> Float[np.ndarray, "seq time n"]:
    """Readings under recorded torques."""
    given = np.moveaxis(u, 0, 2)
    return _run(tables, effects, lambda t, *_: given[t], u.shape, dt, sub_steps).reading


def _run(
    tables: ArmTables,
    effects: Effects,
    command: Callable[[int, Batch, Batch], Batch],
    shape: tuple[int, ...],
    dt: float,
    sub_steps: int,
) -> Motion:
    """Every sequence starts at rest where the encoders read zero. sub_steps: in 0.1 s."""
    n_seq, samples, n = shape
    bias, memory, gain, home, spring, ripple, gear = (
        np.broadcast_to(np.asarray(a, float), n)[:, None] for a in (*effects[:6], tables.gear)
    )
    low, high, fastest = (a[:, None] for a in (tables.position_min, tables.position_max, tables.velocity_max))
    dynamics, (moment, angle) = _dynamics(tables), effects.counterbalance
    steps = max(1, round(sub_steps * dt / SAMPLE_TIME))

    def acceleration(q: Batch, v: Batch, push: Batch) -> Batch:
        force = push - spring * q
        force[1] -= moment * np.sin(q[1] - angle)
        return dynamics(q, v, force)

    q, v = np.broadcast_to(-home, (n, n_seq)).copy(), np.zeros((n, n_seq))
    u, reading = np.empty((samples, n, n_seq)), np.empty((samples, n, n_seq))
    for t in range(samples):
        u[t] = command(t, q + home, v)
        push, before = gain * gear * u[t] + bias + ripple * np.sin(2 * np.pi * effects.hum * dt * t), v
        for _ in range(steps):
            q, v = _runge_kutta(acceleration, q, v, push, dt / steps)
        q = np.clip(q, low - home, high - home)
        v = np.clip(v, -fastest, fastest) + memory * before
        reading[t] = q + home
    return Motion(*(np.ascontiguousarray(np.moveaxis(a, 2, 0)) for a in (u, reading)))


def _dynamics(tables: ArmTables) -> Callable[[Batch, Batch, Batch], Batch]:
    pool = pin.ModelPool(pinocchio_model(tables), 1)
    viscous = (tables.gear**2 * tables.viscous)[:, None]
    coulomb = (np.abs(tables.gear) * tables.coulomb)[:, None]

    def acceleration(q: Batch, v: Batch, push: Batch) -> Batch:
        force = push - viscous * v - coulomb * np.sign(v)
        found = pin.abaInParallel(1, pool, *(np.asfortranarray(a) for a in (q, v, force)))
        return found.reshape(q.shape)  # Pinocchio drops the axis of a batch of one

    return acceleration


def _runge_kutta(f: Callable[[Batch, Batch, Batch], Batch], q: Batch, v: Batch, push: Batch, h: float) -> tuple:
    a1 = f(q, v, push)
    v2 = v + h / 2 * a1
    a2 = f(q + h / 2 * v, v2, push)
    v3 = v + h / 2 * a2
    a3 = f(q + h / 2 * v2, v3, push)
    v4 = v + h * a3
    a4 = f(q + h * v3, v4, push)
    return q + h / 6 * (v + 2 * (v2 + v3) + v4), v + h / 6 * (a1 + 2 * (a2 + a3) + a4)
