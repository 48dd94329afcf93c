"""Where simulation and measurement disagree, said so that a person can read it: in time, and in the signals.

A correction signal d_t becomes intervals of time in which it stands out of its uncertainty, a box in the space of
states and inputs that holds most of its energy in few samples, and a map over two signals.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pgrssnn_jax.physics.base import Signal

_CLEAR = 2.0  # standard deviations
_CUTS = np.linspace(0.05, 0.95, 19)  # quantiles at which a box may end
_CELLS = 12
_FEW = 8  # samples below which a cell of the map says nothing


class Box(NamedTuple):
    """region: `{signal: (low, high)}`, infinite where open; rule: the same in words."""

    region: dict[str, tuple[float, float]]
    rule: str
    share_of_error: float
    share_of_samples: float


class Map(NamedTuple):
    """Mean correction over two signals with its standard error and number of samples, `[a, b]`; NaN in cells with too
    few visits."""

    a: str
    b: str
    a_edges: np.ndarray
    b_edges: np.ndarray
    mean: np.ndarray
    std_error: np.ndarray
    samples: np.ndarray


def intervals(active: Bool[np.ndarray, " time"], dt: float, longest_gap: int = 3) -> list[tuple[float, float]]:
    """Stretches in seconds in which `active` holds; gaps of up to `longest_gap` samples are closed, single samples
    dropped."""
    found: list[list[int]] = []
    for t in np.flatnonzero(active):
        if found and t - found[-1][1] <= longest_gap + 1:
            found[-1][1] = int(t)
        else:
            found.append([int(t), int(t)])
    return [(start * dt, (stop + 1) * dt) for start, stop in found if stop > start]


def clear(mean: Float[np.ndarray, " time"], std: Float[np.ndarray, " time"]) -> Bool[np.ndarray, " time"]:
    return np.abs(mean) > _CLEAR * std


def box(
    energy: Float[np.ndarray, " samples"],
    values: Float[np.ndarray, "samples signals"],
    signals: Sequence[Signal],
) -> Box:
    """The box of at most two signals whose share of the error exceeds its share of the samples most."""
    total = energy.sum()
    inside = np.ones(len(energy), bool)
    region: dict[str, tuple[float, float]] = {}
    words: list[str] = []
    for _ in range(2):
        best = (_advantage(energy, inside, total) + 0.05, None)  # a further condition must be worth its words
        for j, signal in enumerate(signals):
            if signal.name in region:
                continue
            for cut in np.unique(np.quantile(values[inside, j], _CUTS)):
                for above in (True, False):
                    part = inside & ((values[:, j] > cut) if above else (values[:, j] <= cut))
                    gain = _advantage(energy, part, total)
                    if gain > best[0]:
                        best = (gain, (j, float(cut), above, part))
        if best[1] is None:
            break
        j, cut, above, inside = best[1]
        region[signals[j].name] = (cut, float("inf")) if above else (-float("inf"), cut)
        words.append(f"{signals[j].name} {'above' if above else 'below'} {cut:.3g} {signals[j].unit}".rstrip())
    share, samples = float(energy[inside].sum() / total) if total > 0 else 0.0, float(inside.mean())
    where = " and ".join(words) if words else "everywhere"
    return Box(
        region, f"{where}: {100 * share:.0f} % of the error in {100 * samples:.0f} % of the samples", share, samples
    )


def _advantage(energy: np.ndarray, part: np.ndarray, total: float) -> float:
    return float(energy[part].sum() / total - part.mean()) if total > 0 and part.any() else 0.0


def signal_map(
    correction: Float[np.ndarray, "seq time"],
    a: Float[np.ndarray, "seq time"],
    b: Float[np.ndarray, "seq time"],
    names: tuple[str, str],
    counts: Bool[np.ndarray, "seq time"],
) -> Map:
    """Mean and standard error of the correction per cell over the samples that count; the error counts visits, not
    samples, because neighbouring samples tell the same."""
    ends = [(s[counts].min(), s[counts].max()) for s in (a, b)]
    edges = [np.linspace(low, high + 1e-9 * max(abs(low), abs(high), 1e-300), _CELLS + 1) for low, high in ends]
    place = [np.clip(np.searchsorted(e, s, "right") - 1, 0, _CELLS - 1) for e, s in zip(edges, (a, b), strict=True)]
    cell = place[0] * _CELLS + place[1]
    begins = np.ones(cell.shape, bool)
    begins[:, 1:] = cell[:, 1:] != cell[:, :-1]

    def totals(weights: np.ndarray) -> np.ndarray:
        return np.bincount(cell[counts], weights[counts], _CELLS**2).reshape(_CELLS, _CELLS)

    count, visits = totals(np.ones(cell.shape)), totals(begins * 1.0)
    enough = count >= _FEW
    divisor = np.where(enough, count, 1.0)
    mean = totals(correction) / divisor
    variance = np.maximum(totals(correction**2) / divisor - mean**2, 0.0)
    error = np.sqrt(variance / np.maximum(visits, 1.0))
    shown = (np.where(enough, mean, np.nan), np.where(enough, error, np.nan))
    return Map(names[0], names[1], edges[0], edges[1], *shown, count.astype(int))
