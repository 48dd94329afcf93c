"""The same cases by sparse regression on derivatives (SINDy), as a practitioner would use it with pysindy.

    r = d y/dt - model's derivative at the measured signals ≈ Σ base terms + one library term

Base terms are those that other parameters of the model could explain; the term that explains most of the rest of r is
named, if it explains at least 5 % of it. Derivatives come from pysindy's smoothed differences, the choice of the term
from its forward orthogonal least squares. The upper tank's level is hidden: r takes it from the nominal model's own
run, and only y and u are in the library. Term by term a name stands for the effect that would show as that term; what
acts on the hidden level (overflow, leak) or on the reading's range has no term, and cannot be named.
"""

import numpy as np

from .case import Case
from .rig import HISTORY, SAMPLE_TIME, Rig, levels

SYSTEMS = ("tanks", "pendulum")  # the others have no derivative to regress on (sampled), or none of one signal (arm)
_LEAST = 0.05
Terms = dict[str, np.ndarray]


def sindy_name(case: Case, window: int = 15) -> str | None:
    """Name of the best single term, or None. Raises `ImportError` without pysindy (`pip install pysindy`), and
    `ValueError` for a system other than tanks and pendulum. window: samples of the smoothing."""
    import pysindy  # an optional extra

    if case.system not in SYSTEMS:
        raise ValueError(f"sindy_name: system: expected one of {SYSTEMS}, found {case.system!r}")
    smooth = pysindy.SmoothedFiniteDifference(smoother_kws={"window_length": window, "polyorder": 3})

    def slope(signal: np.ndarray, dt: float) -> np.ndarray:
        return np.asarray(smooth(signal[:, None], dt * np.arange(len(signal))))[:, 0]

    u, y = case.train.u[0, :, 0], case.train.y[0, :, 0]
    u = (u + np.append(u[1:], u[-1])) / 2  # y_t is read between the spans in which u_t and u_t+1 act
    if case.system == "tanks":
        residual, base, library = _tanks(case, u, y, slope(y, SAMPLE_TIME))
    else:
        dt = case.train.info.dt
        rate = slope(y, dt)
        residual, base, library = _pendulum(case, u, y, rate, slope(rate, dt), slope(u, dt))
    known = np.column_stack(base)
    inside = slice(window, -window)  # differences are poor at the ends

    def rest(signal: np.ndarray) -> np.ndarray:
        return (signal - known @ np.linalg.lstsq(known[inside], signal[inside], rcond=None)[0])[inside]

    target = rest(residual)
    rests = {name: rest(term) for name, term in library.items() if np.std(term[inside]) > 0 or name == "input_offset"}
    terms = np.column_stack(list(rests.values()))
    chosen = pysindy.FROLS(max_iter=1, alpha=0.0, normalize_columns=True).fit(terms, target[:, None])
    coefficients = np.ravel(chosen.coef_)
    explained = 1 - np.var(target - terms @ coefficients) / np.var(target)
    return list(rests)[int(np.argmax(np.abs(coefficients)))] if explained >= _LEAST else None


def _tanks(case: Case, u: np.ndarray, y: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, list[np.ndarray], Terms]:
    rig, level = Rig(**case.physics), np.maximum(y, 0.0)
    before = np.concatenate([np.full(HISTORY, u[0]), u])
    upper = levels(rig, before, (float(level[0]), float(level[0])), 2)[0]
    drain = rig.k1 * np.sqrt(upper) - rig.k2 * upper
    residual = slope - (drain - rig.k4 * np.sqrt(level) + rig.k5 * level)
    library = {
        "input_offset": np.ones_like(u),
        "bypass": u,
        "pump_nonlinearity": u**2,
        "pump_saturation": np.maximum(u - np.quantile(u, 0.8), 0.0),
        "pump_dead_zone": np.maximum(np.quantile(u, 0.16) - u, 0.0),
        "tank2_overflow": np.maximum(level - np.quantile(level, 0.8), 0.0),
        "outlet_exponent": level**0.75,
    }
    return residual, [np.sqrt(level), level, drain], library


def _pendulum(
    case: Case, u: np.ndarray, y: np.ndarray, rate: np.ndarray, slope: np.ndarray, change: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray], Terms]:
    length, damping = case.physics["length"], case.physics["damping"]
    residual = slope + 9.81 / length * np.sin(y) + damping * rate - u / length**2
    size = np.abs(u)
    library = {
        "input_offset": np.ones_like(u),
        "sensor_offset": np.cos(y),
        "input_saturation": np.sign(u) * np.maximum(size - np.quantile(size, 0.8), 0.0),
        "input_dead_zone": np.sign(u) * np.minimum(size, np.quantile(size, 0.17)),
        "input_delay": change,
    }
    return residual, [np.sin(y), rate, u], library
