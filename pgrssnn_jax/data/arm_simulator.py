"""A simulated KUKA KR300 for machines without its data, written independently of the library's JAX dynamics.

    q(t)   = s w(t) (m + c z(t))                         planned motion; z: random low-frequency multisine, |z| ≤ 1
    G u_t  = ID(q, q̇, q̈) + B G² q̇ + G Tc sign(q̇)       at the middle of sample t; ID: inverse dynamics with armature
    M(q) q̈ = G u_t + θ_t - C q̇ - g - friction            RK4 over the sample with u_t held, θ_t ~ N(θ, spread² I)
    q, q̇   within their limits after each step, then     q̇_t += S q̇_{t-1}
    y_t    = q_t + e_t,   e ~ N(0, noise² I)

q in rad, u in Nm on the motor side, θ in Nm on the link side. w and its first two derivatives vanish at both ends, so
a plan starts and ends at rest at q = 0; m and c keep it within the position limits, s within the velocity limits. The
arm itself starts there, then leaves the plan, as the published simulated arm does: the torque knows neither S nor θ.
S, θ, noise and their sizes are those of the published files (Li, Seth, Kok, IFAC 2026); the spread of θ_t is measured
on them: between the ten, positions differ by 0.005 to 0.12 rad beyond their noise.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - its files are in a folder of their own
from jaxtyping import Float

from pgrssnn_jax.data.tank_simulator import runge_kutta
from pgrssnn_jax.physics.arms.tables import ArmTables, described, pinocchio_model

SAMPLE_TIME = 0.1  # s
_FASTEST = 0.135  # Hz, of a plan: rms speed / position 0.5 and acceleration / speed 0.7 rad/s, as measured
_RAMP = 0.12  # share of the time at either end in which w rises and falls
_REACH = (0.3, 0.9)  # share of the range of positions that a plan uses
_SPEED = (0.35, 0.8)  # share of the greatest speed that a plan may reach

Batch = Float[np.ndarray, "n batch"]


class ArmSimulator(NamedTuple):
    """What the arm does and the described one does not. memory: the diagonal of S, theta: mean disturbance, spread:
    its standard deviation, Nm on the link side; noise: standard deviation of the measured positions, rad."""

    memory: tuple[float, ...] = (-0.05, 0.1, -0.2, 0.05, 0.1, -0.1)
    theta: tuple[float, ...] = (4.0, 5.0, 5.0, 0.5, 2.0, 0.5)
    spread: float = 0.2
    noise: float = 0.1


class ArmData(NamedTuple):
    """u: torque, Nm on the motor side, the same for every realisation; q: true and y: measured positions, rad."""

    u: Float[np.ndarray, "seq time n"]
    q: Float[np.ndarray, "realisation seq time n"]
    y: Float[np.ndarray, "realisation seq time n"]


class Plan(NamedTuple):
    """Position, velocity and acceleration in rad, rad/s and rad/s²."""

    q: Float[np.ndarray, "*seq time n"]
    v: Float[np.ndarray, "*seq time n"]
    a: Float[np.ndarray, "*seq time n"]


def simulated_arm(
    seed: int, sequences: int, samples: int, realisations: int = 1, simulator: ArmSimulator | None = None
) -> ArmData:
    """Sequences of an arm that starts at rest at q = 0. Realisations share u and differ in disturbance and noise; fewer
    of them, or fewer sequences, are a part of more."""
    simulator, tables = simulator or ArmSimulator(), described("kuka_kr300", "reference")
    plans, members = np.random.default_rng(seed).spawn(2)
    u = torque(tables, planned(plans, tables, sequences, samples))
    # [realisation, (disturbance, sensor), seq, time, n]
    draws = np.stack(
        [
            [[rng.standard_normal((samples, tables.n)) for rng in kind.spawn(sequences)] for kind in member.spawn(2)]
            for member in members.spawn(realisations)
        ]
    )
    q = simulate(tables, np.broadcast_to(u, draws[:, 0].shape), draws[:, 0], simulator)
    return ArmData(u, q, q + simulator.noise * draws[:, 1])


def planned(rng: np.random.Generator, tables: ArmTables, sequences: int, samples: int, dt: float = SAMPLE_TIME) -> Plan:
    """Motions at the middle of every sample of dt, s, each from a random stream of its own."""
    time = (np.arange(samples) + 0.5) * dt
    plans = [_plan(stream, tables, time, samples * dt) for stream in rng.spawn(sequences)]
    return Plan(*(np.stack(signal) for signal in zip(*plans, strict=True)))


def _plan(
    rng: np.random.Generator, tables: ArmTables, time: Float[np.ndarray, " time"], duration: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, q̇, q̈ `[time, n]` of one sequence."""
    lines = np.arange(1, max(1, round(_FASTEST * duration)) + 1)
    rate = 2 * np.pi * lines / duration
    size = rng.standard_normal((2, len(lines), tables.n))
    reach, speed = rng.uniform(*_REACH, tables.n), rng.uniform(*_SPEED, tables.n)
    sine, cosine = np.sin(np.outer(time, rate)), np.cos(np.outer(time, rate))
    z = sine @ size[0] + cosine @ size[1]
    dz = cosine @ (rate[:, None] * size[0]) - sine @ (rate[:, None] * size[1])
    ddz = -sine @ (rate[:, None] ** 2 * size[0]) - cosine @ (rate[:, None] ** 2 * size[1])
    low, high = reach * tables.position_min, reach * tables.position_max
    largest = np.abs(z).max(0)
    middle, range_ = (low + high) / 2, (high - low) / 2 / largest
    w, dw, ddw = (column[:, None] for column in _window(time, duration))
    p, dp, ddp = middle + range_ * z, range_ * dz, range_ * ddz
    q, v, a = w * p, dw * p + w * dp, ddw * p + 2 * dw * dp + w * ddp
    slower = np.minimum(1.0, speed * tables.velocity_max / np.abs(v).max(0))
    return slower * q, slower * v, slower * a


def _window(time: Float[np.ndarray, " time"], duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """w, ẇ, ẅ: a quintic rise from 0 to 1, rest at 1, and the mirrored fall."""
    left = time <= duration / 2
    ramp = _RAMP * duration
    s = np.minimum(np.where(left, time, duration - time) / ramp, 1.0)
    w = s**3 * (10 + s * (6 * s - 15))
    dw = np.where(left, 1.0, -1.0) * 30 * s**2 * (1 - s) ** 2 / ramp
    return w, dw, 60 * s * (1 - s) * (1 - 2 * s) / ramp**2


def torque(tables: ArmTables, plan: Plan) -> Float[np.ndarray, "seq time n"]:
    """Motor-side torque that the described arm needs for a motion."""
    q, v, a = (np.asfortranarray(signal.reshape(-1, tables.n).T) for signal in plan)
    link = pin.rneaInParallel(1, pin.ModelPool(pinocchio_model(tables), 1), q, v, a)
    motor = (link.reshape(v.shape) + _friction(tables, v)) / tables.gear[:, None]
    return np.ascontiguousarray(motor.T).reshape(plan.q.shape)


def simulate(
    tables: ArmTables,
    u: Float[np.ndarray, "*lead time n"],
    draws: Float[np.ndarray, "*lead time n"],
    simulator: ArmSimulator,
) -> Float[np.ndarray, "*lead time n"]:
    """True positions after each sample. draws: standard normal, of the disturbance."""
    *lead, samples, n = u.shape
    pool = pin.ModelPool(pinocchio_model(tables), 1)
    push = tables.gear * u + np.array(simulator.theta) + simulator.spread * draws
    columns = np.moveaxis(push.reshape(-1, samples, n), 0, 2)
    lowest, highest, fastest = (
        limit[:, None] for limit in (tables.position_min, tables.position_max, tables.velocity_max)
    )
    memory = np.array(simulator.memory)[:, None]

    def slope(x: Float[np.ndarray, "2 n batch"], tau: Batch) -> Float[np.ndarray, "2 n batch"]:
        q, v = x
        force = tau - _friction(tables, v)
        acceleration = pin.abaInParallel(1, pool, *(np.asfortranarray(column) for column in (q, v, force)))
        return np.stack([v, acceleration.reshape(q.shape)])  # Pinocchio drops the axis of a batch of one

    x = np.zeros((2, *columns.shape[1:]))
    found = np.empty_like(columns)
    for t, tau in enumerate(columns):
        q, v = runge_kutta(partial(slope, tau=tau), x, SAMPLE_TIME)
        found[t] = np.clip(q, lowest, highest)
        x = np.stack([found[t], np.clip(v, -fastest, fastest) + memory * x[1]])
    return np.ascontiguousarray(np.moveaxis(found, 2, 0)).reshape(*lead, samples, n)


def _friction(tables: ArmTables, v: Batch) -> Batch:
    """Nm on the link side, zero at zero velocity."""
    viscous, coulomb = tables.gear**2 * tables.viscous, tables.gear * tables.coulomb
    return viscous[:, None] * v + coulomb[:, None] * np.sign(v)
