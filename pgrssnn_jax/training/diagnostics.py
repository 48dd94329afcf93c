"""Entries of `metrics.json` beside the errors: coverage and width of the intervals, share of the networks, share of the
samples outside the range of training."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgrssnn_jax.records.record import take
from pgrssnn_jax.training.evaluation import Predictions
from pgrssnn_jax.training.intervals import LEVEL, Intervals, inside
from pgrssnn_jax.training.plan import MemberTests
from pgrssnn_jax.training.shares import network_share, outside


def diagnostics(
    intervals: Intervals | None,
    together: Sequence[Sequence[int]],
    rows: Sequence[dict[str, Any]],
    tests: MemberTests,
    found: Predictions,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The entries of `metrics.json`, and the arrays behind them, of the first members that were tested together."""
    info = tests.measured.info
    metrics: dict[str, Any] = {"interval": None, "network": _network_figures(rows, tests, found)}
    arrays: dict[str, np.ndarray] = {}
    if together and intervals is not None:
        metrics["interval"], low, high = _interval_figures(intervals, together, tests, found, LEVEL)
        arrays |= {"interval_low": low.astype(np.float32), "interval_high": high.astype(np.float32)}
        u, y = np.asarray(tests.measured.u[together[0][0]]), found.y[together[0]].mean(0)
        metrics["outside"] = outside(intervals, info.inputs, info.outputs, u, y)
    if together and found.alone is not None and found.x is not None:
        supplied, states = found.y[together[0]] - found.alone[together[0]], found.x[together[0]]
        arrays |= {"network": supplied.mean(0).astype(np.float32), "x": states.mean(0).astype(np.float32)}
    return metrics, arrays


def _interval_figures(
    intervals: Intervals, together: Sequence[Sequence[int]], tests: MemberTests, predictions: Predictions, level: float
) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """How many measurements of the test record the intervals hold and how wide they are, per output, mean over the
    groups of members `together`; and the ends of the first group's interval, `[seq, time, y]`."""
    ends, figures = [], []
    for group in together:
        y_hat, u = predictions.y[group].astype(np.float64), np.asarray(tests.measured.u[group[0]], np.float64)
        mean = y_hat.mean(0)
        half = intervals.half_width(mean, y_hat.std(0), u, level)
        figures.append(inside(take(tests.measured, group[0]), mean, half, tests.n_inits[0]))
        ends.append((mean - half, mean + half))
    coverage, width = np.mean(figures, axis=0)
    return {"level": level, "coverage": coverage.tolist(), "width": width.tolist()}, *ends[0]


def _network_figures(
    rows: Sequence[dict[str, Any]], tests: MemberTests, predictions: Predictions
) -> dict[str, list[float]] | None:
    """The share of the networks per output, mean over finished members (`shares.py`); None where they stand alone, or
    there are none."""
    finished = [i for i, row in enumerate(rows) if row["status"] == "ok"]
    if predictions.alone is None or not finished:
        return None
    shares = [network_share(take(tests.measured, i), predictions.y[i], predictions.alone[i]) for i in finished]
    return {"share": np.mean(shares, axis=0).tolist()}
