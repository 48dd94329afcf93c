"""Magnitudes of effects: some are plain numbers, some are set where a signal of the plant spends a share of its time.

threshold = quantile_q(signal)
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np


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


def resolved(draw: Mapping[str, Any], signals: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Plain numbers, and the thresholds of those signals that are known."""
    known = {k: v for k, v in draw.items() if not isinstance(v, Quantile)}
    found = {
        k: float(np.quantile(signals[v.of], v.q))
        for k, v in draw.items()
        if isinstance(v, Quantile) and v.of in signals
    }
    return known | found
