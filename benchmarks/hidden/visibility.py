"""What of a hidden effect remains when the base parameters are refitted: a bound for everyone who is to name it.

    visibility = RMS of the best fit's residual on the training record / RMS of the noise in it

1: the base physics with other parameters and another initial state explains the record, so nothing can be named.
The fit starts at the true parameters, so that a poor start is no excuse; the arm's base physics is not refitted here.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from .case import Case, rms
from .pendulum_plant import HISTORY as PENDULUM_HISTORY
from .pendulum_plant import Plant, swing
from .rig import HISTORY as RIG_HISTORY
from .rig import Rig, levels

Residual = Callable[[np.ndarray], np.ndarray]


def visibility(case: Case) -> float:
    u, y = case.train.u[0, :, 0], case.train.y[0, :, 0]
    start, predict = {"tanks": _tanks, "pendulum": _pendulum, "lgssm": _linear}[case.system](case, u, y)
    best = least_squares(lambda p: predict(p) - y, start, x_scale=np.maximum(np.abs(start), 0.1), max_nfev=60)
    return rms(best.fun) / case.noise


def _tanks(case: Case, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, Residual]:
    """p: factors on k1 .. k5, initial levels."""
    names, k = zip(*case.magnitudes["parameters"].items(), strict=True)
    before = np.concatenate([np.full(RIG_HISTORY, u[0]), u])

    def predict(p: np.ndarray) -> np.ndarray:
        rig = Rig(**dict(zip(names, np.abs(p[:5]) * k, strict=True)))
        return levels(rig, before, (abs(p[5]), abs(p[6])), 2)[1]

    return np.array([1, 1, 1, 1, 1, max(y[0], 0.5), max(y[0], 0.5)], float), predict


def _pendulum(case: Case, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, Residual]:
    """p: length, damping, initial angle and rate."""
    before = np.concatenate([np.full(PENDULUM_HISTORY, u[0]), u])
    start = [*case.magnitudes["parameters"].values(), y[0], (y[1] - y[0]) / 0.05]
    return np.array(start), lambda p: swing(Plant(abs(p[0]), p[1]), before, (p[2], p[3]))


def _linear(case: Case, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, Residual]:
    """p: the transfer function (b0 + b1 z⁻¹) / (1 + a1 z⁻¹ + a2 z⁻²), which is all that y says of A, B and C, and the
    filter's initial state."""
    a, b, c = (np.array(case.magnitudes["parameters"][name]) for name in "ABC")
    b0, b1 = (c @ b)[0, 0], (c @ (a - np.trace(a) * np.eye(2)) @ b)[0, 0]
    start = [b0, b1, -np.trace(a), np.linalg.det(a), 0.0, 0.0]

    def predict(p: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            return np.clip(np.nan_to_num(lfilter(p[:2], [1, *p[2:4]], u, zi=p[4:])[0]), -1e3, 1e3)

    return np.array(start), predict
