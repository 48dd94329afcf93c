"""A sensor whose characteristic is curved: a smooth curve through points at equal steps of its reading.

    y = y' + Σ_j c_j φ(s - j),    s = (m - 1) (y' - low) / (high - low), within 0 and m - 1
    φ(d) = 1 - 5/2 d² + 3/2 |d|³                          |d| < 1
           2 - 4 |d| + 5/2 d² - 1/2 |d|³                  1 <= |d| < 2,    0 beyond

m points from low to high, one more at each end on the parabola through the last three. A parabola is met exactly, and
beyond low and high the curve goes on as a straight line. One row of c per output, in its unit.
Source: Keys, Cubic convolution interpolation, IEEE Trans. Acoust. Speech Signal Process. 29 (1981).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.base import Effect, Needs, Numbers, SignalRange, counted, on_output
from pgrssnn_jax.physics.base import Parameter, Physics
from pgrssnn_jax.physics.signals import unit_of_all

POINTS = 6  # measured tanks: 4, 5, 8, 10 predict left-out blocks worse by 152, 80, 28, 35 nats
_PART = np.linspace(0.0, 1.0, POINTS)
_BOW = 0.2 * _PART * (1.0 - _PART)  # of the range, where fits begin: 5 % in its middle
_STRAIGHT = 0.1  # of the deviations: a curve that departs less from a straight line is an offset or a gain


def sensor_nonlinearity(physics: Physics) -> Effect:
    n = len(physics.outputs)
    unit = unit_of_all(physics.outputs)

    def change(p: Any, y: jax.Array) -> jax.Array:
        curves = [_curve(y[j], p["low"][j], p["high"][j], p["deviation"][j]) for j in range(n)]
        return y + jnp.stack(curves)

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        low, high = span.y
        high = np.where(high > low, high, low + 1.0)  # of an output that does not move
        bow = np.outer(high - low, _BOW)
        return [{"deviation": sign * bow, "low": low, "high": high} for sign in (1.0, -1.0)]

    return Effect(
        "sensor_nonlinearity",
        title="Curved sensor characteristic",
        equation="y = y' + a smooth curve through points at equal steps from y_low to y_high",
        cause="the sensor's calibration is a straight line, its characteristic is not",
        acts_on="measurement",
        parameters={
            "deviation": Parameter("c", unit, neutral=0.0),
            "low": Parameter("y_low", unit, neutral=0.0, trainable=False),
            "high": Parameter("y_high", unit, neutral=1.0, trainable=False),
        },
        initial_guesses=initial_guesses,
        wrap=lambda base: on_output(base, "sensor_nonlinearity", change),
        needs=Needs(counted(n, "output"), lambda other: len(other.outputs) == n),
        shapes={"deviation": (n, POINTS), "low": (n,), "high": (n,)},
        channels="output, point",
        simpler=("sensor_offset", "sensor_gain", "sensor_saturation"),
        elaborate=True,
        credible=lambda numbers, span: _bends(np.asarray(numbers["deviation"])) and _within_range(numbers),
    )


def _curve(value: jax.Array, low: Any, high: Any, c: Any) -> jax.Array:
    """Of one output. c `[m]`: deviations at the points."""
    c = jnp.asarray(c)
    before, behind = 3.0 * c[0] - 3.0 * c[1] + c[2], 3.0 * c[-1] - 3.0 * c[-2] + c[-3]
    points = jnp.concatenate([before[None], c, behind[None]])
    wanted = (value - low) / (high - low) * (POINTS - 1)
    place = jnp.clip(wanted, 0.0, POINTS - 1.0)
    slope = 0.5 * jnp.where(wanted < 0.0, c[1] - before, behind - c[-2])  # at the end
    d = jnp.abs(place - jnp.arange(-1, POINTS + 1, dtype=c.dtype))
    near = (1.5 * d - 2.5) * d * d + 1.0
    far = ((2.5 - 0.5 * d) * d - 4.0) * d + 2.0
    inside = (jnp.where(d < 1.0, near, jnp.where(d < 2.0, far, 0.0)) * points).sum()
    return inside + slope * (wanted - place)


def _bends(deviation: Float[np.ndarray, "y m"]) -> bool:
    """Does the curve of any output depart from a straight line?"""
    line = np.stack([np.ones(POINTS), _PART], 1)
    left = deviation.T - line @ np.linalg.lstsq(line, deviation.T, rcond=None)[0]
    return bool((left**2).sum() > _STRAIGHT**2 * (deviation**2).sum())


def _within_range(numbers: Numbers) -> bool:
    """Is no reading wrong by more than its whole range? A point that no sample is near may lie anywhere."""
    deviation, low, high = (np.asarray(numbers[name]) for name in ("deviation", "low", "high"))
    return bool((np.abs(deviation) <= (high - low)[:, None]).all())
