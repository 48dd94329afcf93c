"""Logs of an arm that tracks a smooth path: torques by Pinocchio's inverse dynamics, which the library does not use."""

import numpy as np
import pinocchio as pin

from pgrssnn_jax.physics.arms.tables import described, pinocchio_model
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record

KUKA = described("kuka_kr300")
DT, LINES = 0.1, np.array([0.03, 0.07, 0.11, 0.16, 0.23])  # s, Hz


def path(rng: np.random.Generator, sequences: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, speed and acceleration `[seq, time, n]` at the times dt, 2 dt, ..."""
    t = DT * np.arange(1, samples + 1)[None, :, None, None]
    w = 2 * np.pi * LINES
    size = rng.normal(size=(sequences, 1, KUKA.n, len(LINES))) * np.array([0.3, 0.2, 0.12, 0.08, 0.05])
    phase = rng.uniform(0, 2 * np.pi, size.shape)
    angle = w * t + phase
    return tuple((size * wave).sum(-1) for wave in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))


def log(
    seed: int,
    *,
    tables=KUKA,
    sequences: int = 6,
    samples: int = 300,
    home=0.0,
    gain=1.0,
    bias=0.0,
    friction=1.0,
    load=0.0,
    balance: tuple[float, float] = (0.0, 0.0),
    wave: float = 0.0,
    noise: float = 1e-5,
    torque_noise: float = 0.02,
    model=None,
) -> Record:
    """Motor torques of the joint angles; encoders read them `home` later. Torque and reading belong to one moment: the
    torque of a row acts before its reading, so that they are half a sample apart at most. balance: moment, Nm, and
    angle, rad, of a spring at the second joint; wave: torque of the third joint that depends on its angle, Nm."""
    rng = np.random.default_rng(seed)
    q, v, a = path(rng, sequences, samples)
    model = pinocchio_model(tables) if model is None else model
    data, n = model.createData(), tables.n
    flat = zip(*(x.reshape(-1, n) for x in (q, v, a)), strict=True)
    moved = np.stack([pin.rnea(model, data, *one).copy() for one in flat]).reshape(q.shape)
    rubbed = tables.gear**2 * tables.viscous * v + np.abs(tables.gear) * tables.coulomb * np.sign(v)
    rest = moved + friction * rubbed - bias
    rest[..., 1] += balance[0] * np.sin(q[..., 1] - balance[1])
    rest[..., 2] += wave * np.sin(4 * q[..., 2])
    drive = rest / (1 - load * np.sign(v * rest))  # drive - load |drive| sign(v) = rest
    u = drive / (gain * tables.gear) + torque_noise * rng.normal(size=q.shape)
    y = q + home + noise * rng.normal(size=q.shape)
    channels = ([Channel(f"{what}_{i + 1}", unit) for i in range(n)] for what, unit in SIGNALS)
    return record(u, y, RecordInfo(*map(tuple, channels), DT, "simulated", f"path {seed}"))


SIGNALS = (("torque", "Nm"), ("position", "rad"))
