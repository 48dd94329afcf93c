"""What disturbs a reading, of several kinds with one stationary standard deviation σ.

white      e ~ N(0, σ²)                         heavy      Student's t with 2.5 degrees of freedom
ar95, ar99 e_t = a e_{t-1} + w_t, a = 0.95, 0.99    lowpass    a first-order low-pass of 10 samples: a = exp(-1/10)
state      six times larger where the reading is in its upper half
quantised  the reading is rounded to steps of σ √12
process    white, and a disturbance of the state, where the simulator has one
"""

import numpy as np
from scipy.signal import lfilter

from .signals import Wave

KINDS = ("white", "ar95", "ar99", "heavy", "state", "quantised", "lowpass", "process")
_COLOURS = {"ar95": 0.95, "ar99": 0.99, "lowpass": float(np.exp(-1 / 10))}
_DEGREES = 2.5  # of Student's t: hardly a variance, no fourth moment
_LOUDER = 6.0


def errors(rng: np.random.Generator, kind: str, deviation: float, reading: Wave) -> Wave:
    """What is added to a reading without noise. White noise of one stream is the same whatever the reading."""
    n = len(reading)
    if kind in ("white", "process"):
        return deviation * rng.standard_normal(n)
    if kind in _COLOURS:
        return deviation * _coloured(rng.standard_normal(n + 1), _COLOURS[kind])
    if kind == "heavy":  # whose variance is ν / (ν - 2)
        return deviation * (1 - 2 / _DEGREES) ** 0.5 * rng.standard_t(_DEGREES, n)
    if kind == "state":
        size = np.where(reading > np.median(reading), _LOUDER, 1.0)
        return deviation * size / np.sqrt(np.mean(size**2)) * rng.standard_normal(n)
    if kind == "quantised":
        step = deviation * 12**0.5  # of a uniform error
        return step * np.round(reading / step) - reading if step > 0 else np.zeros(n)
    raise ValueError(f"hidden case: noise: expected one of {KINDS}, found {kind!r}")


def _coloured(white: Wave, a: float) -> Wave:
    """Stationary from its first sample on; a variance of 1."""
    found, _ = lfilter([(1 - a**2) ** 0.5], [1, -a], white[1:], zi=[a * white[0]])
    return found
