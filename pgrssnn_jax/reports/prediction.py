"""The prediction figure: measured against predicted, and what is left over, for the first test sequence.

A record too long to read is shown through a window of stated range, with the residual of the whole record under it.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch

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
    found, outputs, dt = compared(predictions, metrics), metrics["outputs"], metrics["dt"]
    best, unit = content.headline(metrics), content.unit(metrics)
    spread = content.number(best.mean, unit, std=best.std)
    result = f"{content.merit(metrics)}: ensemble {number(best.ensemble, unit)} · members {spread} (mean ± std)"
    result += f" · {content.counts(metrics)} · n_init {metrics['n_init']}"
    measured = panels.finite(np.where(predictions["mask"], predictions["y"], np.nan))
    n_seq, time, n_y = measured.shape
    stop = time if time <= panels.READABLE else panels.WINDOW
    ratios = [3.0, 1.3] if stop == time else [3.0, 1.3, 1.3]
    body = -(-n_y // min(n_y, 2)) * (sum(ratios) * (1.05 if n_y == 1 else 0.78) + 0.5)
    extent = f"{found.remark}{panels.extent(0, stop, time, n_seq)} · {content.source(metrics)}"
    figure = style.page(body, metrics, [result, extent])
    members, mean, half_width = (panels.finite(array[..., 0, :, :]) for array in found[:3])
    curve = panels.Curve(found.label, mean, style.BLUE, style.VERMILLION)
    signals = panels.Signals(outputs, dt * np.arange(time), measured[0], [curve], members, half_width)
    for k, axes in enumerate(panels.pair_axes(figure, n_y, ratios)):
        panels.draw_signal(axes[0], signals.cut(0, stop), k)
        panels.draw_residuals(axes[1], signals.cut(0, stop), k)
        if not len(members):
            style.note(axes[0], "no finished member to show: measurement only")
        if metrics["n_init"]:
            for ax in axes[:2]:
                ax.axvspan(0.0, dt * min(metrics["n_init"], stop), color=style.QUIET, alpha=0.12, linewidth=0)
        for ax in axes[2:]:
            panels.draw_overview(ax, signals, k, stop)
    handles: list[Artist] = [style.key("measured", style.TRUTH, linewidth=2.8)]
    if len(members):
        handles += [
            style.key(found.label, style.BLUE, linewidth=1.4),
            Patch(facecolor=style.SKY, alpha=0.35, label=found.band),
            style.key("members", style.BLUE, linewidth=0.7, alpha=0.5),
            style.key(f"residual: measured − {found.label}", style.VERMILLION, linewidth=1.2),
        ]
    style.legend(figure, handles)
    return figure


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
