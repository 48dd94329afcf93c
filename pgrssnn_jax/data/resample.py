"""Logs on an even grid of time, and on a coarser one without aliases.

    jitter      positions by a cubic spline through their samples (Hermite's where velocities were measured), torques
                linearly between theirs, onto the median step of the log
    coarser     Butterworth low-pass of order 4, forwards and backwards, then every dt s by a cubic spline

Nothing is delayed. A gap in the log may be as long as dt.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

_ORDER = 4
_OPEN = 0.8  # of the highest frequency that is left: where the filter begins unless somebody says
_EVEN = 0.01  # of a step: clocks and rounded time stamps are no better
_LEAST = 16  # samples of the log: fewer are no sequence
Samples = Float[np.ndarray, "time n"]


class Log(NamedTuple):
    """time, s; position, torque, velocity (None: not measured) of the joints, in any unit."""

    time: Float[np.ndarray, " time"]
    position: Samples
    torque: Samples
    velocity: Samples | None = None


class Resampled(NamedTuple):
    """rate: Hz, of the log; cutoff: Hz, None: nothing was filtered; kept: share of the torques' variance that is left,
    of the joint that lost most."""

    position: Samples
    torque: Samples
    rate: float
    cutoff: float | None
    kept: float

    @property
    def words(self) -> str:
        rate = f"{self.rate:.4g} Hz"
        if self.cutoff is None:
            return rate
        how = f"Butterworth of order {_ORDER}, forwards and backwards"
        left = f"at least {100 * self.kept:.1f} % of each torque's variance left"
        return f"{rate}, low-pass filtered at {self.cutoff:.4g} Hz ({how}; {left})"


def resampled(log: Log, dt: float, cutoff: float | None, where: str) -> Resampled:
    """Samples every dt s. cutoff: Hz, None: 0.4 / dt where the log is finer than dt; where: begins messages. Raises
    `ValueError` for times that do not grow, for gaps beyond dt, and for a log that is coarser."""
    if len(log.time) < _LEAST:
        raise ValueError(f"{where}: expected at least {_LEAST} samples, found {len(log.time)}")
    steps = np.diff(log.time)
    step = float(np.median(steps))
    if not (steps > 0).all():
        late = log.time[1:][steps <= 0][0]
        raise ValueError(f"{where}: time: expected times that grow, found {late:g} s twice or behind a later one")
    if step > dt * (1 + _EVEN):
        raise ValueError(f"{where}: expected a sample every {dt:g} s (physics.dt) or more, found one every {step:g} s")
    if steps.max() > max(dt, 1.5 * step):
        after = log.time[int(np.argmax(steps))]
        raise ValueError(
            f"{where}: time: expected gaps up to {dt:g} s (physics.dt), found {steps.max():g} s at {after:g} s"
        )
    whole = np.concatenate([log.position, log.torque], 1)
    if np.abs(steps - step).max() > _EVEN * step:
        whole = _even(log, step)
    finer = step < dt * (1 - _EVEN)
    spread, chosen = whole.std(0), _OPEN * 0.5 / dt if cutoff is None and finer else cutoff
    if chosen is not None:
        if not 0 < chosen < 0.5 / step:
            raise ValueError(f"{where}: cutoff: expected more than 0 and less than {0.5 / step:g} Hz, found {chosen:g}")
        low_pass = scipy.signal.butter(_ORDER, chosen, fs=1 / step, output="sos")
        whole = scipy.signal.sosfiltfilt(low_pass, whole, axis=0)
    ratio = whole.std(0) / np.maximum(spread, 1e-300)
    if finer:
        at = np.arange(0.0, (len(whole) - 1) * step * (1 + 1e-12), dt)
        whole = scipy.interpolate.make_interp_spline(step * np.arange(len(whole)), whole, k=3)(at)
    n = log.position.shape[1]
    return Resampled(whole[:, :n], whole[:, n:], 1 / step, chosen, float(ratio[n:].min() ** 2))


def _even(log: Log, step: float) -> Float[np.ndarray, "time channel"]:
    """Position and torque every `step` s."""
    at = np.arange(log.time[0], log.time[-1] + 1e-9 * step, step)
    if log.velocity is None:
        through = scipy.interpolate.make_interp_spline(log.time, log.position, k=3)
    else:
        through = scipy.interpolate.CubicHermiteSpline(log.time, log.position, log.velocity)
    torque = np.stack([np.interp(at, log.time, one) for one in log.torque.T], 1)
    return np.concatenate([through(at), torque], 1)
