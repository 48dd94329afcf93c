"""Measuring calls side by side."""

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np


def medians(calls: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median ms of every call, compiled first and then measured in turn, so that a busy moment meets all of them."""
    for call in calls.values():
        jax.block_until_ready(call())
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            started = time.perf_counter()
            jax.block_until_ready(call())
            times[name].append(1e3 * (time.perf_counter() - started))
    return {name: float(np.median(values)) for name, values in times.items()}
