"""The true pendulum; Runge-Kutta 4, ten steps per sample (`pendulum.py` has the equations)."""

from math import inf, sin
from typing import NamedTuple

import numpy as np

from .signals import Wave, command

GRAVITY, SAMPLE_TIME, SUB_STEPS = 9.81, 0.05, 10  # m/s², s
HISTORY = 8  # samples before a record starts: what a delayed motor still has to run


class Plant(NamedTuple):
    """length in m, damping in 1/s; the rest is neutral. delay in samples, a whole number of sub-steps; lag, the
    time constant of the motor, in samples."""

    length: float
    damping: float
    u_offset: float = 0.0
    u_dead: float = 0.0
    u_top: float = inf
    delay: float = 0.0
    lag: float = 0.0
    y_offset: float = 0.0
    y_top: float = inf
    y_bottom: float = -inf


def swing(plant: Plant, u: Wave, start: tuple[float, float]) -> Wave:
    """Angles after each sample of the record, which starts HISTORY samples after u does."""
    n, h = len(u) - HISTORY, SAMPLE_TIME / SUB_STEPS
    pushes = (torque(plant, command(u, SUB_STEPS, plant.delay, plant.lag, HISTORY)) / plant.length**2).tolist()
    stiffness, damping = GRAVITY / plant.length, plant.damping
    angle, rate = start
    angles = np.empty(n)
    for t in range(n):
        for push in pushes[t * SUB_STEPS : (t + 1) * SUB_STEPS]:
            a = push - stiffness * sin(angle) - damping * rate
            rate_b = rate + h / 2 * a
            b = push - stiffness * sin(angle + h / 2 * rate) - damping * rate_b
            rate_c = rate + h / 2 * b
            c = push - stiffness * sin(angle + h / 2 * rate_b) - damping * rate_c
            rate_d = rate + h * c
            d = push - stiffness * sin(angle + h * rate_c) - damping * rate_d
            angle += h / 6 * (rate + 2 * (rate_b + rate_c) + rate_d)
            rate += h / 6 * (a + 2 * (b + c) + d)
        angles[t] = angle
    return angles


def torque(plant: Plant, u: Wave) -> Wave:
    """Nm that reach the joint."""
    v = u + plant.u_offset
    moved = np.sign(v) * np.maximum(np.abs(v) - plant.u_dead, 0.0)
    return np.clip(moved, -plant.u_top, plant.u_top)


def reading(plant: Plant, angle: Wave, noise: Wave | float = 0.0) -> Wave:
    """rad; the range of the encoder ends after its noise."""
    return np.clip(angle + plant.y_offset + noise, plant.y_bottom, plant.y_top)
