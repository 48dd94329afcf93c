"""The true arm under a joint controller; Pinocchio's forward dynamics, Runge-Kutta 4, `sub_steps` steps per sample.

    M(q) q̈ + h(q, q̇) = gain G u + θ - G² B q̇ - G Tc sign(q̇)              u held over the sample
    q, q̇ within their limits after each sample, then q̇_t += S q̇_{t-1};     reading = q + home
    G u_t  = ID of the described arm along the plan + K (plan - reading) + L (planned velocity - q̇)

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
    """Neutral values. bias: Nm on the link side; memory: diagonal of S; gain; home: rad."""

    bias: Joints = np.zeros(6)
    memory: Joints = np.zeros(6)
    gain: Joints = np.ones(6)
    home: Joints = np.zeros(6)


class Motion(NamedTuple):
    """u: Nm on the motor side; reading: rad, without noise."""

    u: Float[np.ndarray, "seq time n"]
    reading: Float[np.ndarray, "seq time n"]


def controlled(described: ArmTables, tables: ArmTables, effects: Effects, plan: Plan) -> Motion:
    """The true arm, tables and effects, under a controller that knows the described one."""
    forward = np.moveaxis(torque(described, plan), 0, 2)  # [time, n, seq]
    q_plan, v_plan = (np.moveaxis(signal, 0, 2) for signal in (plan.q, plan.v))
    model = pinocchio_model(described)
    inertia = np.diag(pin.crba(model, model.createData(), np.zeros(described.n)))[:, None]
    stiff, damp = inertia * _STIFFNESS**2, 2 * inertia * _STIFFNESS

    def command(t: int, reading: Batch, v: Batch) -> Batch:
        start = q_plan[t] - SAMPLE_TIME / 2 * v_plan[t]  # plans are given at the middle of a sample
        return forward[t] + (stiff * (start - reading) + damp * (v_plan[t] - v)) / described.gear[:, None]

    return _run(tables, effects, command, plan.q.shape)


def free_run(
    tables: ArmTables, effects: Effects, u: Float[np.ndarray, "seq time n"], sub_steps: int = SUB_STEPS
) -> Float[np.ndarray, "seq time n"]:
    """Readings under recorded torques."""
    given = np.moveaxis(u, 0, 2)
    return _run(tables, effects, lambda t, *_: given[t], u.shape, sub_steps).reading


def _run(
    tables: ArmTables,
    effects: Effects,
    command: Callable[[int, Batch, Batch], Batch],
    shape: tuple[int, ...],
    sub_steps: int = SUB_STEPS,
) -> Motion:
    """Every sequence starts at rest where the encoders read zero."""
    n_seq, samples, n = shape
    columns = [np.asarray(a, float)[:, None] for a in (*effects, tables.gear)]
    bias, memory, gain, home, gear = columns
    low, high, fastest = (a[:, None] for a in (tables.position_min, tables.position_max, tables.velocity_max))
    acceleration = _dynamics(tables)
    q, v = np.broadcast_to(-home, (n, n_seq)).copy(), np.zeros((n, n_seq))
    u, reading = np.empty((samples, n, n_seq)), np.empty((samples, n, n_seq))
    for t in range(samples):
        u[t] = command(t, q + home, v)
        push, before = gain * gear * u[t] + bias, v
        for _ in range(sub_steps):
            q, v = _runge_kutta(acceleration, q, v, push, SAMPLE_TIME / sub_steps)
        q = np.clip(q, low, high)
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
