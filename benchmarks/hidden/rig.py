"""Two cascaded tanks with whatever may go wrong in them; Runge-Kutta 4, `sub_steps` steps per sample.

    f     = k3 curve(clip(z + u_offset - u_dead, 0, u_top)),   lag dz/dt = u(t - delay) - z          pump flow
    dx1/dt = (1 - bypass) f - d - leak x1,   d = k1 √x1 - k2 x1                 x1 ≤ rim_1, the rest spills
    dx2/dt = bypass f + d - k4 √r (x2 / r)^g + k5 x2 + share · spill            x2 ≤ rim_2, the rest is lost
    y      = min(x2 + y_bend x2 (1 - x2 / 10) + y_offset + e, y_top)

x1, x2, u, y in V, time in s. curve(v) = v (1 + a v / 10) or r_u (v / r_u)^p. At the reference level r an outlet of any
exponent lets out the same: k4 keeps the unit and the size of the square-root law.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from .signals import Wave, command

SAMPLE_TIME, SUB_STEPS = 4.0, 20  # s
HISTORY = 8  # samples before a record starts: what a delayed pump still has to run
REFERENCE_LEVEL, REFERENCE_VOLTAGE = 4.0, 3.0  # V


class Rig(NamedTuple):
    """Neutral but for the published k1 .. k5. delay in samples, a whole number of sub-steps;
    lag, the time constant of the pump, in samples."""

    k1: float = 0.0464
    k2: float = 0.0003
    k3: float = 0.0412
    k4: float = 0.0586
    k5: float = 0.0039
    u_offset: float = 0.0
    u_dead: float = 0.0
    u_top: float = inf
    curvature: float = 0.0
    power: float = 1.0
    delay: float = 0.0
    lag: float = 0.0
    bypass: float = 0.0
    leak: float = 0.0
    rim_1: float = inf
    share: float = 0.0
    rim_2: float = inf
    exponent: float = 0.5
    y_offset: float = 0.0
    y_bend: float = 0.0
    y_top: float = inf


def flow(rig: Rig, u: Wave) -> Wave:
    """V/s into the tanks."""
    v = np.clip(u + rig.u_offset - rig.u_dead, 0.0, rig.u_top - rig.u_dead)
    curved = v * (1 + rig.curvature * v / 10)
    return rig.k3 * REFERENCE_VOLTAGE * (curved / REFERENCE_VOLTAGE) ** rig.power


def levels(rig: Rig, u: Wave, start: tuple[float, float], sub_steps: int = SUB_STEPS) -> tuple[Wave, Wave]:
    """Levels after each sample of the record, which starts HISTORY samples after u does.

    Plain floats: for two states they are several times as fast as arrays.
    """
    n, h = len(u) - HISTORY, SAMPLE_TIME / sub_steps
    flows = flow(rig, command(u, sub_steps, rig.delay, rig.lag, HISTORY)).tolist()
    k1, k2, k5, g, bypass, leak = rig.k1, rig.k2, rig.k5, rig.exponent, rig.bypass, rig.leak
    rim_1, rim_2, share = rig.rim_1, rig.rim_2, rig.share
    k4 = rig.k4 * REFERENCE_LEVEL ** (0.5 - g)

    def slope(x1: float, x2: float, f: float) -> tuple[float, float]:
        x1, x2 = max(x1, 0.0), max(x2, 0.0)
        drain = k1 * sqrt(x1) - k2 * x1
        return (1 - bypass) * f - drain - leak * x1, bypass * f + drain - k4 * x2**g + k5 * x2

    x1, x2 = min(start[0], rim_1), min(start[1], rim_2)
    upper, lower = np.empty(n), np.empty(n)
    for t in range(n):
        for f in flows[t * sub_steps : (t + 1) * sub_steps]:
            a1, a2 = slope(x1, x2, f)
            b1, b2 = slope(x1 + h / 2 * a1, x2 + h / 2 * a2, f)
            c1, c2 = slope(x1 + h / 2 * b1, x2 + h / 2 * b2, f)
            d1, d2 = slope(x1 + h * c1, x2 + h * c2, f)
            x1 = max(x1 + h / 6 * (a1 + 2 * (b1 + c1) + d1), 0.0)
            x2 = max(x2 + h / 6 * (a2 + 2 * (b2 + c2) + d2), 0.0)
            if x1 > rim_1:  # what a sub-step brings above the rim has spilled within it
                x1, x2 = rim_1, x2 + share * (x1 - rim_1)
            x2 = min(x2, rim_2)
        upper[t], lower[t] = x1, x2
    return upper, lower


def reading(rig: Rig, lower: Wave, noise: Wave | float = 0.0) -> Wave:
    """V; the range of the sensor ends after its noise, as on the measured rig."""
    curved = lower + rig.y_bend * lower * (1 - lower / 10)
    return np.minimum(curved + rig.y_offset + noise, rig.y_top)
