"""A hidden periodic disturbance is a line in the spectrum of the errors that the input does not have.

    P_k = Σ_seq |Σ_t w_t e_t exp(-2πi k t / T)|²,    w: Hann's window

The line lies where a parabola through the logarithms of the three highest values of P has its top.
Source of the interpolation: Gasior, Gonzalez, Improving FFT frequency measurement resolution, CERN-AB-2004-023 (2004).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

_LINE = 30.0  # times the median of its neighbourhood: a line in the spectrum of the errors
_LINE_SHARE = 0.1  # of the energy of the errors
_NEIGHBOURS = 25  # bins on either side, at most
_LOWEST = 8  # bin, and highest from the end, that has neighbours on both sides
_PERIODS = 16  # in the record, at least: of fewer, slow errors and a line look alike


class Line(NamedTuple):
    """A sinusoid in the errors: period in samples, amplitude in their unit, share of their energy, the output."""

    period: float
    amplitude: float
    share: float
    output: int


def spectral_line(error: Float[np.ndarray, "seq time y"], u: Float[np.ndarray, "seq time u"]) -> Line | None:
    """The strongest line in the errors that stands out of its neighbourhood and is not one of the input."""
    found = [line for line in lines_of(error) if not has_line(u, line)]
    return max(found, key=lambda line: line.share, default=None)


def lines_of(error: Float[np.ndarray, "seq time y"]) -> list[Line]:
    """The strongest line of each output that has one."""
    found = [_strongest(error[..., j]) for j in range(error.shape[2])]
    return [line._replace(output=j) for j, line in enumerate(found) if line is not None]


def power_at(signal: Float[np.ndarray, "seq time"], line: Line) -> float:
    return float(_power(signal)[round(signal.shape[1] / line.period)])


def has_line(u: Float[np.ndarray, "seq time u"], line: Line) -> bool:
    """Has any input a line in this bin?"""
    k = round(u.shape[1] / line.period)
    return any(power[k] >= _LINE * _surroundings(power, k) for power in _powers(u))


def has_lines(u: Float[np.ndarray, "seq time u"]) -> bool:
    """Has any input a line anywhere?"""
    return any(p[k] >= _LINE * _surroundings(p, k) for p in _powers(u) for k in range(_LOWEST, len(p) - _LOWEST))


def without_line(
    error: Float[np.ndarray, "seq time"], measured: Bool[np.ndarray, "seq time"]
) -> Float[np.ndarray, "seq time"]:
    """Errors without their strongest line, if they have one: every sequence without the nearest sinusoid, whose
    amplitude and frequency may drift by a little."""
    line = _strongest(error)
    if line is None:
        return error
    t = np.arange(error.shape[1])
    angle = 2.0 * np.pi * t / line.period
    fixed = np.stack([np.cos(angle), np.sin(angle)], 1)
    columns = np.concatenate([fixed, (t / len(t) - 0.5)[:, None] * fixed], 1)
    found = error.copy()
    for one, counts in zip(found, measured, strict=True):
        size, *_ = np.linalg.lstsq(columns[counts], one[counts], rcond=None)
        one[counts] -= columns[counts] @ size
    return found


def _strongest(error: Float[np.ndarray, "seq time"]) -> Line | None:
    time = error.shape[1]
    if time < 4 * _NEIGHBOURS:
        return None
    power = _power(error)
    k = int(np.argmax(power[_PERIODS:-2])) + _PERIODS
    share = float(power[k - 2 : k + 3].sum() / max(power[1:].sum(), np.finfo(float).tiny))
    if not power[k] > _LINE * _surroundings(power, k) or share <= _LINE_SHARE:
        return None
    return Line(time / (k + _top(power[k - 1 : k + 2])), float(np.sqrt(2.0 * share * (error**2).mean())), share, 0)


def _power(signal: Float[np.ndarray, "seq time"]) -> Float[np.ndarray, " bin"]:
    return (np.abs(np.fft.rfft(signal * np.hanning(signal.shape[1]), axis=1)) ** 2).sum(0)


def _powers(u: Float[np.ndarray, "seq time u"]) -> list[Float[np.ndarray, " bin"]]:
    """Of every input that moves."""
    moved = u - u.mean(1, keepdims=True)
    return [_power(moved[..., j]) for j in range(u.shape[2]) if np.any(moved[..., j])]


def _top(three: Float[np.ndarray, "3"]) -> float:
    """Where the parabola has its top, in bins from the middle one."""
    left, middle, right = np.log(np.maximum(three, np.finfo(float).tiny))
    bend = left - 2.0 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


def _surroundings(power: np.ndarray, k: int) -> float:
    """Median of the neighbourhood of a bin, at most an octave down and up, without the line itself."""
    low, high = max(k // 2, k - _NEIGHBOURS), min(2 * k, k + _NEIGHBOURS)
    return float(np.median(np.r_[power[low : k - 3], power[k + 4 : high + 1]]))
