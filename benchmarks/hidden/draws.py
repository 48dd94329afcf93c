"""Magnitudes of effects: some are plain numbers, some are set where a signal of the plant spends a share of its time.

threshold = quantile_q(signal)
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

SUB_STEPS = 10  # per sample, of which a delay is a whole number


class Quantile(NamedTuple):
    """A threshold at the quantile q of a signal, which is known only after the plant has been simulated.

    at: the value that an input is shifted to have there; None leaves the input where it is.
    """

    q: float
    of: str
    at: float | None = None


def uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def either_sign(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))


def humming(rng: np.random.Generator, size: float | Quantile) -> dict[str, Any]:
    """Period in samples, phases of both records in turns."""
    return {"hum": size, "period": uniform(rng, 12.0, 50.0), "phases": rng.uniform(0.0, 1.0, 2).tolist()}


Draw = Callable[[np.random.Generator], dict[str, Any]]
COMMON: dict[str, Draw] = {  # what any actuator and sensor may have; a delay of one sample is a convention of reading
    "input_saturation": lambda rng: {"u_top": Quantile(uniform(rng, 0.70, 0.88), "input")},
    "input_delay": lambda rng: {"delay": round(uniform(rng, 1.4, 3.5) * SUB_STEPS) / SUB_STEPS},
    "sensor_saturation": lambda rng: {"y_top": Quantile(uniform(rng, 0.75, 0.92), "reading")},
    "periodic_disturbance": lambda rng: humming(rng, Quantile(uniform(rng, 0.3, 0.6), "input")),
}


def resolved(draw: Mapping[str, Any], signals: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Plain numbers, and the thresholds of those signals that are known."""
    known = {k: v for k, v in draw.items() if not isinstance(v, Quantile)}
    found = {
        k: float(np.quantile(signals[v.of], v.q))
        for k, v in draw.items()
        if isinstance(v, Quantile) and v.of in signals
    }
    return known | found
