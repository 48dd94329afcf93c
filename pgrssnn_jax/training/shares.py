"""What the networks of a model supply beside its physics, and where a run leaves the range that training has seen.

share = RMS(ŷ - ŷ of the same member without its networks) / std(y)
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.records.record import Channel, Record
from pgrssnn_jax.training.intervals import Intervals


def network_share(
    record: Record, predicted: Float[np.ndarray, "seq time y"], alone: Float[np.ndarray, "seq time y"]
) -> Float[np.ndarray, " y"]:
    """Per output of one member; NaN for an output that does not vary."""
    y = np.where(record.mask, np.asarray(record.y, np.float64), np.nan)
    added = np.sqrt(np.mean((predicted - alone).astype(np.float64) ** 2, axis=(0, 1)))
    deviation = np.nanstd(y, axis=(0, 1))
    return np.divide(added, deviation, out=np.full_like(added, np.nan), where=deviation > 0)


def outside(
    intervals: Intervals,
    inputs: Sequence[Channel],
    outputs: Sequence[Channel],
    u: Float[np.ndarray, "*seq time u"],
    y: Float[np.ndarray, "*seq time y"],
) -> dict[str, float]:
    """Share of the samples in which an input or a predicted output is outside the range that training has seen, by the
    signal's name; a signal that stays inside is not named."""
    found: dict[str, float] = {}
    for channels, values, (_, _, low, high) in ((inputs, u, intervals.u), (outputs, y, intervals.y)):
        shares = ((values < low) | (values > high)).reshape(-1, len(channels)).mean(0)
        found |= {channel.name: float(share) for channel, share in zip(channels, shares, strict=True) if share > 0}
    return found
