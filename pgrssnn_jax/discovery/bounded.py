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
    fixed = np.zeros(len(pull), bool)
    step = np.zeros(len(pull))
    while not fixed.all():
        free = ~fixed
        step[free] = scaled_step(normal[np.ix_(free, free)], (pull - normal @ np.where(fixed, step, 0.0))[free])
        beyond = np.maximum(low - step, step - high) * np.sqrt(np.maximum(np.diag(normal), _TINY))
        worst = int(np.argmax(np.where(free, beyond, -np.inf)))
        if beyond[worst] <= 0.0:
            break
        step[worst], fixed[worst] = np.clip(step[worst], low[worst], high[worst]), True
    return step


def scaled_step(normal: Float[np.ndarray, "k k"], pull: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """N⁻¹ g, each number in units of its own column, so that the ridge is the same for all."""
    size = np.sqrt(np.maximum(np.diag(normal), _TINY))
    scaled = normal / size / size[:, None] + _RIDGE * np.eye(len(pull))
    return np.linalg.solve(scaled, pull / size) / size
