"""How well blocks of a record are predicted by fits that have not seen them.

log p = -½ Σ (n log 2πσ² + s / σ²)        s: squared error of a block of n samples, σ² = Σ s / Σ n
"""

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.null import LEAST_GAIN


def log_likelihood(
    squares: Float[np.ndarray, " block"], counts: Int[np.ndarray, " block"]
) -> Float[np.ndarray, " block"]:
    """Predictive, of every block."""
    variance = max(float(squares.sum() / counts.sum()), 1e-300)
    return -0.5 * (counts * np.log(2.0 * np.pi * variance) + squares / variance)


def with_standard_error(difference: Float[np.ndarray, " block"]) -> tuple[float, float]:
    """The sum over blocks, and its standard error, no smaller than what fits leave undone when they end."""
    return float(difference.sum()), max(float(len(difference) ** 0.5 * difference.std(ddof=1)), LEAST_GAIN)
