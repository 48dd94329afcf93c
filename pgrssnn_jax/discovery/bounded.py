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
    """δ for N = normal and g = pull.

    Holding one number w at c changes the others along its column of the inverse P of N:
    δ += P_w (c - δ_w) / P_ww,   P -= P_w P_wᵀ / P_ww
    """
    size, scaled = _scaled(normal)
    right, lowest, highest = pull / size, low * size, high * size  # in units of the columns
    inverse, free = np.linalg.inv(scaled), np.ones(len(pull), bool)
    step = inverse @ right
    while free.any():
        beyond = np.where(free, np.maximum(lowest - step, step - highest), -np.inf)
        worst = int(beyond.argmax())
        if beyond[worst] <= 0.0:
            break
        along = inverse[worst] / inverse[worst, worst]
        at = lowest[worst] if lowest[worst] > step[worst] else highest[worst]
        step += along * (at - step[worst])
        inverse -= np.outer(along, inverse[worst])
        step[worst], free[worst] = at, False
        inverse[worst] = inverse[:, worst] = 0.0
    left = np.flatnonzero(free)  # once more without the rounding of an inverse
    step[left] = np.linalg.solve(scaled[left[:, None], left], (right - scaled @ np.where(free, 0.0, step))[left])
    return np.clip(step / size, low, high)


def scaled_steps(normal: Float[np.ndarray, "k k"], pull: Float[np.ndarray, "many k"]) -> Float[np.ndarray, "many k"]:
    """N⁻¹ g of many g, each number in units of its own column, so that the ridge is the same for all."""
    size, scaled = _scaled(normal)
    return np.linalg.solve(scaled, (pull / size).T).T / size


def _scaled(normal: Float[np.ndarray, "k k"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    size = np.sqrt(np.maximum(np.diag(normal), _TINY))
    return size, normal / size / size[:, None] + _RIDGE * np.eye(len(size))
