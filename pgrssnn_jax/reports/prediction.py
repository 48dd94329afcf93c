"""The prediction figure: measured against predicted, and the residual, for the first test sequence.

A record too long to read is shown through a window of stated range, with the residual of the whole record under it.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pgrssnn_jax.reports import content, panels, style
from pgrssnn_jax.reports.content import Metrics, number
from pgrssnn_jax.training.intervals import LEVEL


class Compared(NamedTuple):
    """What is compared with the measurement: members `[member, seq, time, y]`, their mean, half the width of the band
    around it, and their names."""

    y_hat: np.ndarray
    mean: np.ndarray
    half_width: np.ndarray
    label: str
    remark: str
    band: str = "±1 std over members"


def prediction_figure(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> Figure:
    """One pair of panels per output: the whole sequence up to 1500 samples, the first 300 samples of a longer one."""
    found, dt, n_init = compared(predictions, metrics), metrics["dt"], metrics["n_init"]
    best, unit = content.headline(metrics), content.unit(metrics)
    measured = panels.finite(np.where(predictions["mask"], predictions["y"], np.nan))
    n_seq, time, n_y = measured.shape
    stop = time if time <= panels.READABLE else panels.WINDOW
    ratios = [3.0, 1.3] if stop == time else [3.0, 1.3, 1.3]
    spread = number(best.mean, unit, std=best.std)
    result = f"{content.merit(metrics)}: ensemble {number(best.ensemble, unit)} · members {spread} (mean ± std)"
    extent = f"{found.remark}{panels.extent(0, stop, time, n_seq)} · {content.source(metrics)}"
    body = panels.rows_of(n_y) * (sum(ratios) * (1.05 if n_y == 1 else 0.78) + 0.5)
    figure = style.page(body, metrics, [f"{result} · {content.counts(metrics)} · n_init {n_init}", extent])
    members, mean, half_width = (panels.finite(array[..., 0, :, :]) for array in found[:3])
    curve = panels.Curve(found.label if len(members) else "_", "mean", mean, style.BLUE, style.VERMILLION)
    times = dt * np.arange(time)
    signals = panels.Signals(metrics["outputs"], times, measured[0], [curve], members, half_width, found.band)
    for k, axes in enumerate(panels.draw_pairs(figure, signals, (0, stop), ratios)):
        if not len(members):
            style.note(axes[0], "no finished member to show: measurement only")
        for ax in axes[:2]:
            shade_uncounted(ax, metrics, stop)
        for ax in axes[2:]:
            _draw_overview(ax, signals, k, stop)
    style.legend(figure)
    return figure


def shade_uncounted(ax: Axes, metrics: Metrics, stop: int) -> None:
    """The first n_init samples, which do not count."""
    if metrics["n_init"]:
        end = metrics["dt"] * min(metrics["n_init"], stop)
        ax.axvspan(0.0, end, color=style.QUIET, alpha=0.12, linewidth=0)


def _draw_overview(ax: Axes, signals: panels.Signals, k: int, stop: int) -> None:
    """The residual over the whole sequence; the first `stop` samples are those of the window."""
    style.quiet(ax, x="time (s)", y=signals.label(k, "residual"))
    title = "residual of the whole sequence; shaded: the window above"
    ax.set_title(title, loc="left", fontsize=8, color=style.QUIET, pad=3)
    ax.plot(signals.time, signals.residual(k, 0), color=style.VERMILLION, alpha=0.75, linewidth=0.5)
    ax.axhline(0.0, color=style.INK, linewidth=0.8)
    ax.axvspan(signals.time[0], signals.time[stop], color=style.YELLOW, alpha=0.30, linewidth=0)
    ax.margins(x=0.01)


def compared(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> Compared:
    """The finished members and their ensemble.

    Where members were tested on different records there is no ensemble, and `y` is the record of the first member:
    then only members of its dataset belong to `y`, and their mean takes the place of the ensemble's.
    """
    members, y_hat = metrics["members"], np.asarray(predictions["y_hat"], np.float64)
    ok = np.array([member["status"] == "ok" for member in members], bool)
    mean, std = (np.asarray(predictions[name], np.float64) for name in ("ensemble_mean", "ensemble_std"))
    found = Compared(y_hat[ok], mean, std, "ensemble mean", "")
    if ok.any() and not np.isfinite(mean).any():
        dataset = members[0]["dataset"]
        ok &= np.array([member["dataset"] == dataset for member in members], bool)
        remark = f"only dataset {dataset}: members have test records of their own, hence no ensemble · "
        if ok.any():
            mean, std = y_hat[ok].mean(0), y_hat[ok].std(0)
        found = Compared(y_hat[ok], mean, std, f"mean of dataset {dataset}", remark)
    if "interval_low" in predictions and ok.any():
        low, high = (np.asarray(predictions[f"interval_{end}"], np.float64) for end in ("low", "high"))
        level = (metrics.get("interval") or {}).get("level", LEVEL)
        found = found._replace(half_width=(high - low) / 2, band=f"{100 * level:g} % interval")
    return found
