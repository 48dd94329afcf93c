"""Velocities and accelerations of a measured arm, without delay, and how sure they are.

    low-pass forwards and backwards (Butterworth, order 4), then a spline of degree 5:   q, q̇, q̈ = s, s', s''

Where nobody says a cut-off, it is the highest frequency at which the spectrum of a position is ten times its floor (the
median of the upper fifth), the median over the joints: a derivative has the same ratio of signal to noise at every
frequency. Of a record that was filtered the spectrum ends where the filter begins: behind it the floor is that of the
filter. Torques stay as they were measured: their noise is no regressor.
Source: Gautier, Vandanjon, Presse, Identification of inertial and drive gain parameters of robots, CDC 1994.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.records.record import Record

_RATIO = 10.0  # power of signal and noise over that of noise at the cut-off
_FLOOR = 0.8  # of the highest frequency: above it a spectrum is taken for noise
_OPEN = 0.8  # of the highest frequency: with a cut-off above it nothing is filtered
_PASSED = 0.8  # of a filter's cut-off: up to it one of order 4 that passes twice leaves 73 % of the power
_ORDER = 4
_SPLINE = 3  # samples at an end where a spline of degree 5 is no better than its last knots
_SMOOTHED = 5  # lines of a spectrum, so that a line by chance is none
PerSample = Float[np.ndarray, "seq time n"]


class Motion(NamedTuple):
    """reading, v, a: position as encoders read it, rad, its rate and the rate of that; torque: of the motors, Nm; all
    at the same moments, `spacing` s apart. cutoff: Hz, None where nothing was filtered; noise: standard deviation of a
    over that of the signal in it, per joint; unsure: standard deviation of v, rad/s."""

    reading: PerSample
    v: PerSample
    a: PerSample
    torque: PerSample
    spacing: float
    cutoff: float | None
    noise: Float[np.ndarray, " n"]
    unsure: Float[np.ndarray, " n"]


def motion_of(
    record: Record,
    dt: float,
    *,
    at_rest: bool,
    shift: float = 0.0,
    cutoff: float | None = None,
    edge: int | None = None,
) -> Motion:
    """shift: by how many samples the motion is read after the torque of the same row was; 0: a torque belongs to the
    position that was read before it, 1: to the one behind it. at_rest: sequences begin with all joints at zero.
    cutoff: Hz, None: from the spectrum. edge: samples left out at the end, and at a beginning that is not at rest,
    where a filter knows one side only; None: half a period of the cut-off. Samples that were not measured are refused:
    `ValueError`."""
    y, u = np.asarray(record.y, np.float64), np.asarray(record.u, np.float64)
    if not np.asarray(record.mask).all():
        raise ValueError("discovery: inverse dynamics: expected all positions measured, found missing ones")
    found, floor = spectrum_of(y, dt, record.info.bandwidth)
    chosen = found if cutoff is None else cutoff
    highest = 0.5 / dt
    filtered = filters(chosen, dt)
    edge = max(_SPLINE, round(0.5 / (chosen * dt))) if edge is None else edge
    before = np.zeros_like(y[:, :1]).repeat(edge, 1) if at_rest else 2 * y[:, :1] - y[:, 1:2]
    whole = np.concatenate([before, y], axis=1)  # its last sample of before is at the time 0, as the first torque
    if filtered:
        sections = scipy.signal.butter(_ORDER, chosen, fs=1 / dt, output="sos")
        whole = scipy.signal.sosfiltfilt(sections, whole, axis=1)
    spline = scipy.interpolate.make_interp_spline(
        dt * (np.arange(whole.shape[1]) - before.shape[1] + 1), whole, k=5, axis=1
    )
    kept = np.arange(0 if at_rest else edge, u.shape[1] - edge)
    q, v, a = (np.asarray(spline(dt * (kept + shift), nu=order)) for order in range(3))
    upper = chosen if filtered else highest
    noise = np.sqrt(floor * (2 * np.pi) ** 4 * upper**5 / 5)
    size = a.std(axis=(0, 1))
    ratio = noise / np.sqrt(np.maximum(size**2 - noise**2, 1e-300))
    unsure = np.sqrt(floor * (2 * np.pi) ** 2 * upper**3 / 3)
    return Motion(q, v, a, u[:, kept], dt, chosen if filtered else None, ratio, unsure)


def filters(cutoff: float, dt: float) -> bool:
    """Is a cut-off, Hz, low enough to filter anything?"""
    return cutoff < _OPEN * 0.5 / dt


def thinned(motion: Motion, step: int) -> Motion:
    """Every `step`-th sample."""
    reading, v, a, torque = (one[:, ::step] for one in motion[:4])
    return Motion(reading, v, a, torque, motion.spacing * step, *motion[5:])


def few(motion: Motion, samples: int) -> Motion:
    return thinned(motion, max(1, motion.v.shape[0] * motion.v.shape[1] // samples))


def spectrum_of(y: PerSample, dt: float, bandwidth: float | None = None) -> tuple[float, Float[np.ndarray, " n"]]:
    """The cut-off, Hz, and the floor of the spectra, rad²/Hz. Of whole sequences: parts of them would resolve a slow
    motion the less, the faster it is sampled. bandwidth: of a filter that the record has passed, Hz."""
    f, power = scipy.signal.periodogram(y, 1 / dt, window="blackmanharris", axis=1, detrend="linear")
    passed = f <= _PASSED * (np.inf if bandwidth is None else bandwidth)
    f, power = f[passed], power[:, passed]
    power = scipy.ndimage.uniform_filter1d(power.mean(0), _SMOOTHED, axis=0, mode="nearest")
    power = np.maximum(power, 0.0)  # running sums of a record without noise end below
    floor = np.median(power[f > _FLOOR * f[-1]], axis=0)
    above = power > _RATIO * floor
    highest = np.array([f[above[:, j]].max(initial=0.0) for j in range(y.shape[2])])
    return max(float(np.median(highest)), float(f[1])), floor
