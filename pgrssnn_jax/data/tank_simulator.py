"""A simulated two-tank plant for machines without the measured data, written independently of `physics/tanks.py`.

    dh1/dt = k3 u - q1,      q1 = k1 √h1 - k2 h1            upper tank; h1 never exceeds its rim
    dh2/dt = q1 - q2 + s,    q2 = k4 √h2 - k5 h2            lower tank; s: a share of what the upper one spills
    y = min(max(h2 + e, 0 V), 10 V),    e ~ N(0, noise²)    the sensor's range ends at 10 V

Levels h and the output y in V, pump voltage u in V, time in s. Like the measured rig it overflows and saturates, and
its coefficients are near the published estimates, not equal to them: the physics alone explains it to some tenths of
a volt. Bandwidth, mean and spread of u are those of the measured records (Schoukens and Noël, Cascaded Tanks, 2016).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

SAMPLE_TIME = 4.0  # s
SENSOR_END = 10.0  # V
_SUB_STEPS = 20
_DRAWS, _SATURATED = 8, 0.02
_MEAN, _STD, _LARGEST = 2.8, 1.0, 10.0  # V, of the pump voltage
_STRONG, _WEAK = 20, 60  # the multisine's lines below the first are ten times as large as those up to the second
_START = (3.0, 7.0)  # V, range of the unknown initial levels


class TankSimulator(NamedTuple):
    """k1, k4 in √V/s; k2, k3, k5 in 1/s; rim and noise in V; share: of the spill, that the lower tank catches."""

    k1: float = 0.0475
    k2: float = 0.0005
    k3: float = 0.0410
    k4: float = 0.0580
    k5: float = 0.0036
    rim: float = 10.0
    share: float = 0.7
    noise: float = 0.025


def estimation_and_test(seed: int, n: int = 1024, simulator: TankSimulator | None = None) -> Float[np.ndarray, "{n} 4"]:
    """Two records of one plant as columns u_est, u_test, y_est, y_test in V, every 4 s; both start at the same levels.

    They are the first two of eight draws that reach the end of the sensor's range, and so have overflowed before, in
    at least 2 % of their samples: a record without would hide what the measured ones show.
    """
    inputs, start, noise = np.random.default_rng(seed).spawn(3)
    u = np.stack([pump_voltage(inputs, n) for _ in range(_DRAWS)], axis=1)
    levels = np.repeat(start.uniform(*_START, size=(2, 1)), _DRAWS, axis=1)
    y = simulate(u, levels, noise, simulator or TankSimulator())
    chosen = np.argsort(np.mean(y >= SENSOR_END, axis=0) < _SATURATED, kind="stable")[:2]
    return np.concatenate([u[:, chosen], y[:, chosen]], axis=1)


def pump_voltage(rng: np.random.Generator, n: int) -> Float[np.ndarray, "{n}"]:
    """A multisine of random phases, cut off below 0 V, because a pump does not suck."""
    lines = np.arange(n // 2 + 1)
    size = np.where(lines < _STRONG, 1.0, 0.1) * ((lines > 0) & (lines < _WEAK))
    wave = np.fft.irfft(size * np.exp(2j * np.pi * rng.uniform(size=len(lines))), n)
    return np.clip(_MEAN + _STD * wave / wave.std(), 0.0, _LARGEST)


def simulate(
    u: Float[np.ndarray, "time record"],
    levels: Float[np.ndarray, "2 record"],
    rng: np.random.Generator,
    simulator: TankSimulator,
) -> Float[np.ndarray, "time record"]:
    """Measured lower levels of plants that start at `levels`; u_t is held for the 4 s before y_t is read."""
    h = np.array(levels, float)
    step = SAMPLE_TIME / _SUB_STEPS
    true = np.empty_like(u)
    roots, lines = np.array([[simulator.k1], [simulator.k4]]), np.array([[simulator.k2], [simulator.k5]])
    for t, inflow in enumerate(simulator.k3 * u):
        slope = partial(_slope, roots=roots, lines=lines, inflow=inflow)
        for _ in range(_SUB_STEPS):
            h = np.maximum(runge_kutta(slope, h, step), 0.0)
            spilt = np.maximum(h[0] - simulator.rim, 0.0)
            h[0] -= spilt
            h[1] += simulator.share * spilt
        true[t] = h[1]
    return np.clip(true + simulator.noise * rng.standard_normal(u.shape), 0.0, SENSOR_END)


def _slope(h: np.ndarray, roots: np.ndarray, lines: np.ndarray, inflow: np.ndarray) -> np.ndarray:
    level = np.maximum(h, 0.0)
    q = roots * np.sqrt(level) - lines * level
    q[1] = q[0] - q[1]
    q[0] = inflow - q[0]
    return q


def runge_kutta(slope: Callable[[np.ndarray], np.ndarray], x: np.ndarray, step: float) -> np.ndarray:
    """The state a step later, by the classical rule of fourth order."""
    a = slope(x)
    b = slope(x + step / 2 * a)
    c = slope(x + step / 2 * b)
    d = slope(x + step * c)
    return x + step / 6 * (a + 2 * b + 2 * c + d)
