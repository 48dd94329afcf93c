"""The panels of the prediction figure: one output with its residual, and the residual of a whole long sequence."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import Metrics, rounded

ENVELOPE_BINS = 700


class Signal(NamedTuple):
    """One output of one sequence in float64, NaN where there is nothing: members `[member, time]`, others `[time]`."""

    measured: np.ndarray
    members: np.ndarray
    mean: np.ndarray
    std: np.ndarray


def draw_pair(top: Axes, under: Axes, signal: Signal, metrics: Metrics, k: int, start: int, stop: int) -> None:
    name, unit = metrics["outputs"][k]["name"], metrics["outputs"][k].get("unit", "")
    t = metrics["dt"] * np.arange(start, stop)
    y, members, mean, std = (a[..., start:stop] for a in signal)
    marker = "." if stop - start <= 60 else ""
    faint = {"color": style.BLUE, "linewidth": 0.5, "alpha": float(np.clip(2.2 / max(len(members), 1), 0.06, 0.45))}

    style.quiet(top, title=_panel_title(metrics, k), y=style.label(name, unit))
    style.quiet(under, x="time (s)", y=style.label("residual", unit))
    top.tick_params(labelbottom=False)
    for ax, base in ((top, 0.0), (under, y)):
        sign = 1.0 if ax is top else -1.0
        for member in members:
            ax.plot(t, sign * (member - base), **faint)
        band = sign * (mean - base)
        ax.fill_between(t, band - std, band + std, color=style.SKY, alpha=0.30, linewidth=0)
    top.plot(t, y, color=style.TRUTH, linewidth=2.6, marker=marker, markersize=9, zorder=1.9)
    top.plot(t, mean, color=style.BLUE, linewidth=1.3, marker=marker, zorder=2.6)
    under.axhline(0.0, color=style.INK, linewidth=0.8)
    under.plot(t, y - mean, color=style.VERMILLION, linewidth=0.9, marker=marker)

    n_init = metrics["n_init"]
    for ax in (top, under):
        if start < n_init:
            ax.axvspan(t[0], metrics["dt"] * min(n_init, stop), color=style.QUIET, alpha=0.12, linewidth=0)
        ax.margins(x=0.01)
    limit(top, y, np.concatenate([members.ravel(), mean - std, mean + std]))
    limit(under, np.append(y - np.nanmedian(y) if np.isfinite(y).any() else y, 0.0), y - mean)
    if not np.isfinite(y - mean).any():
        under.set_yticks([])
    if not len(signal.members):
        style.note(top, "no finished member to show: measurement only")


def _panel_title(metrics: Metrics, k: int) -> str:
    """The output and its own figures, as means over members; on a single output the header has said it all."""
    if len(metrics["outputs"]) == 1:
        return ""
    tests = [m["test"] for m in metrics["members"] if m.get("test")]
    rmse, nrmse = (content.over_outputs([test[name][k] for test in tests]) for name in ("rmse", "nrmse"))
    unit = metrics["outputs"][k].get("unit", "")
    name = metrics["outputs"][k]["name"]
    return style.plain(f"{name} · member mean: RMSE {rounded(rmse, unit)}, NRMSE {rounded(nrmse)}")


def limit(ax: Axes, reference: np.ndarray, others: np.ndarray) -> None:
    """Keeps the measurement readable when a prediction runs far away: the axis reaches 1.5 spans beyond it at most."""
    reference, others = reference[np.isfinite(reference)], others[np.isfinite(others)]
    if not len(reference):
        return
    low, high = reference.min(), reference.max()
    span = (high - low) or abs(high) or 1.0
    if len(others) and (others.min() < low - 1.5 * span or others.max() > high + 1.5 * span):
        ax.set_ylim(
            max(others.min(), low - 1.5 * span) - 0.05 * span, min(others.max(), high + 1.5 * span) + 0.05 * span
        )
        box = {"boxstyle": "round,pad=0.3", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
        text = "predictions leave the axis"
        ax.text(
            0.995,
            0.97,
            text,
            transform=ax.transAxes,
            ha="right",
            va="top",
            fontsize=8,
            color=style.VERMILLION,
            bbox=box,
        )


def draw_overview(ax: Axes, signal: Signal, metrics: Metrics, k: int, start: int, stop: int) -> None:
    """The ensemble's residual over the whole sequence as its least and greatest value per bin."""
    dt, residual = metrics["dt"], signal.measured - signal.mean
    style.quiet(ax, x="time (s)", y=style.label("residual", metrics["outputs"][k].get("unit", "")))
    edges = np.unique(np.linspace(0, len(residual), ENVELOPE_BINS + 1).astype(int))
    filled = np.isfinite(residual)
    low = np.minimum.reduceat(np.where(filled, residual, np.inf), edges[:-1])
    high = np.maximum.reduceat(np.where(filled, residual, -np.inf), edges[:-1])
    low, high = (np.where(np.isfinite(a), a, np.nan) for a in (low, high))
    ax.fill_between(dt * edges[:-1], low, high, step="post", color=style.VERMILLION, alpha=0.75, linewidth=0.4)
    ax.axhline(0.0, color=style.INK, linewidth=0.8)
    ax.axvspan(dt * start, dt * stop, color=style.YELLOW, alpha=0.30, linewidth=0)
    ax.margins(x=0.01)
    ax.set_title(
        "residual of the whole sequence; shaded: the window above", loc="left", fontsize=8, color=style.QUIET, pad=3
    )
