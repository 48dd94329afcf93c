"""Linear least squares within bounds, from normal equations.

    minimise ½ δᵀ N δ - gᵀ δ    with    low <= δ <= high

Numbers that would leave their bounds are held there, one after another, in the order of their cost.
"""

import numpy as np
from jaxtyping import Float

_RIDGE = 1e-9  # of a column's energy
_TINY = 1e-300


def step_within(
    normal: Float[np.ndarray, "k k"],
    pull: Float[np.ndarray, " k"],
    low: Float[np.ndarray, " k"],
    high: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " k"]:
    """δ for N = normal and g = pull."""
    size, scaled = _scaled(normal)
    right, lowest, highest = pull / size, low * size, high * size  # in units of the columns
    fixed = np.zeros(len(pull), bool)
    step = np.zeros(len(pull))
    while not fixed.all():
        free = np.flatnonzero(~fixed)
        held = np.where(fixed, step, 0.0)
        step[free] = np.linalg.solve(scaled[free[:, None], free], (right - scaled @ held)[free])
        beyond = np.maximum(lowest - step, step - highest)[free]
        worst = free[beyond.argmax()]
        if beyond.max() <= 0.0:
            break
        step[worst], fixed[worst] = np.clip(step[worst], lowest[worst], highest[worst]), True
    return np.clip(step / size, low, high)


def scaled_step(normal: Float[np.ndarray, "k k"], pull: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """N⁻¹ g, each number in units of its own column, so that the ridge is the same for all."""
    size, scaled = _scaled(normal)
    return np.linalg.solve(scaled, pull / size) / size


def _scaled(normal: Float[np.ndarray, "k k"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    size = np.sqrt(np.maximum(np.diag(normal), _TINY))
    return size, normal / size / size[:, None] + _RIDGE * np.eye(len(size))
