"""The figure of the networks' share: what they add to the physics, when, and at which inputs and states.

added = ŷ - ŷ of the same members without their networks            mean over members
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from pgrssnn_jax.reports import content, panels, style
from pgrssnn_jax.reports.content import Metrics

_OUTPUTS, _SIGNALS = 2, 6  # that one figure has room for
_BINS = 12  # of equally many samples


def network_figure(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> Figure:
    """Above, the first sequence: the residual of the physics alone, and the output that the networks add. Below: the
    RMS of that output against the inputs and states with which it changes most, over all sequences."""
    added, mask = panels.finite(predictions["network"]), predictions["mask"]
    mean = panels.finite(predictions["ensemble_mean"])
    if not np.isfinite(mean).any():
        mean = panels.finite(predictions["y_hat"][0])
    left = np.where(mask, predictions["y"], np.nan) - (mean - added)
    shares = np.asarray([np.nan if share is None else share for share in metrics["network"]["share"]], float)
    order = np.argsort(-np.nan_to_num(shares))[:_OUTPUTS]
    signals = _signals(predictions, metrics, added[..., order[0]])
    lines = [", ".join(f"{metrics['outputs'][k]['name']}: {100 * shares[k]:.3g} % of its std" for k in order)]
    figure = style.page(2.3 * len(order) + 2.4, metrics, [*lines, content.source(metrics)])
    grid = figure.add_gridspec(len(order) + 1, len(signals), height_ratios=[*(2.2 for _ in order), 2.0])
    stop = min(added.shape[1], panels.READABLE)
    time = metrics["dt"] * np.arange(stop)
    for row, k in enumerate(order):
        output = metrics["outputs"][k]
        ax = figure.add_subplot(grid[row, :])
        style.quiet(ax, x="time (s)", y=style.label(f"added to {output['name']}", output.get("unit")))
        ax.plot(time, left[0, :stop, k], color=style.TRUTH, linewidth=2.4, label="measured − physics alone")
        label = "added by the networks, mean over members"
        ax.plot(time, added[0, :stop, k], color=style.BLUE, linewidth=1.3, label=label)
        ax.axhline(0.0, color=style.INK, linewidth=0.8)
        ax.margins(x=0.01)
    unit = metrics["outputs"][order[0]].get("unit")
    for column, (label, centres, rms) in enumerate(signals):
        ax = figure.add_subplot(grid[-1, column])
        style.quiet(ax, x=label, y=style.label("RMS added", unit) if column == 0 else "")
        ax.plot(centres, rms, color=style.BLUE, marker="o", markersize=3.5, linewidth=1.2)
        ax.set_ylim(bottom=0.0)
    style.legend(figure)
    return figure


def _signals(
    predictions: Mapping[str, np.ndarray], metrics: Metrics, added: np.ndarray
) -> Sequence[tuple[str, np.ndarray, np.ndarray]]:
    """Label, centres of the bins and RMS in each, of the signals over which the RMS varies most."""
    names = metrics.get("signals") or {}
    found = []
    for kind, values in (("inputs", predictions["u"]), ("states", predictions["x"])):
        for k in range(values.shape[-1]):
            known = (names.get(kind) or [])[k : k + 1]
            label = style.label(*known[0]) if known else f"{kind[:-1]} {k + 1}"
            centres, rms = _binned(values[..., k].ravel(), added.ravel())
            if len(centres) > 1:
                found.append((np.ptp(rms), (label, centres, rms)))
    found.sort(key=lambda one: -one[0])
    return [signal for _, signal in found[:_SIGNALS]] or [("signal", np.zeros(0), np.zeros(0))]


def _binned(signal: np.ndarray, added: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    usable = np.isfinite(signal) & np.isfinite(added)
    signal, added = signal[usable], added[usable]
    edges = np.unique(np.quantile(signal, np.linspace(0.0, 1.0, _BINS + 1))) if len(signal) else np.zeros(1)
    if len(edges) < 2:
        return np.zeros(0), np.zeros(0)
    which = np.clip(np.searchsorted(edges, signal, side="right") - 1, 0, len(edges) - 2)
    count = np.maximum(np.bincount(which, minlength=len(edges) - 1), 1)
    mean_square = np.bincount(which, added**2, minlength=len(edges) - 1) / count
    return np.bincount(which, signal, minlength=len(edges) - 1) / count, np.sqrt(mean_square)
