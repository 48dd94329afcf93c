"""The prediction figure: measured against predicted, and what is left over, for one test sequence.

A record too long to read is shown through a window of stated range, with the residual of the whole record under it.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import Metrics, rounded
from pgrssnn_jax.reports.panels import Signal, draw_overview, draw_pair

READABLE = 1500
WINDOW = 300


class Compared(NamedTuple):
    """What is compared with the measurement: members `[member, seq, time, y]`, their mean and std, and their names."""

    y_hat: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    label: str
    remark: str


def prediction_figure(
    predictions: Mapping[str, np.ndarray],
    metrics: Metrics,
    *,
    sequence: int = 0,
    window: tuple[int, int] | None = None,
) -> Figure:
    """One pair of panels per output, for the test sequence `sequence` and the samples `window` (start, stop).

    Without a window the whole sequence is shown up to 1500 samples, and the first 300 samples of a longer one. Raises
    `ValueError` where the arrays, the sequence or the window do not fit together.
    """
    _check(predictions, metrics, sequence)
    n_seq, time, n_y = predictions["y"].shape
    start, stop = window or (0, time if time <= READABLE else WINDOW)
    if not 0 <= start < stop <= time:
        raise ValueError(f"prediction_figure: window: expected 0 <= start < stop <= {time}, found {(start, stop)}")
    whole = (start, stop) == (0, time)

    columns = 1 if n_y == 1 else 2
    ratios = [3.0, 1.3] if whole else [3.0, 1.3, 1.3]
    rows = -(-n_y // columns)
    body = rows * (sum(ratios) * (1.05 if n_y == 1 else 0.78) + 0.5)
    of_which = f" · sequence {sequence + 1} of {n_seq}" if n_seq > 1 else ""
    shown = compared(predictions, metrics)
    extent = f"samples {start} to {stop - 1} of {time}"
    if whole:
        extent = "one sample" if time == 1 else f"all {time} samples"
    figure = style.page(
        11.0, body, metrics, [_result(metrics), f"{shown.remark}{extent}{of_which} · {content.source(metrics)}"]
    )
    # Every other row and column of the grid is room between the pairs.
    apart = {"width_ratios": [1.0, 0.012] * (columns - 1) + [1.0], "height_ratios": [1.0, 0.03] * (rows - 1) + [1.0]}
    grid = figure.add_gridspec(2 * rows - 1, 2 * columns - 1, **apart)
    aligned: list[list[Axes]] = [[] for _ in range(columns)]
    for k in range(n_y):
        inner = grid[k // columns * 2, k % columns * 2].subgridspec(len(ratios), 1, height_ratios=ratios, hspace=0.0)
        top = figure.add_subplot(inner[0])
        under = figure.add_subplot(inner[1], sharex=top)
        aligned[k % columns] += [top, under]
        signal = _signal(predictions, shown, sequence, k)
        draw_pair(top, under, signal, metrics, k, start, stop)
        if not whole:
            draw_overview(figure.add_subplot(inner[2]), signal, metrics, k, start, stop)
    for column in aligned:
        figure.align_ylabels(column)
    style.legend(figure, _handles(shown))
    return figure


def _check(predictions: Mapping[str, np.ndarray], metrics: Metrics, sequence: int) -> None:
    y = predictions["y"].shape
    if len(y) != 3 or 0 in y or y[2] != len(metrics["outputs"]):
        outputs = len(metrics["outputs"])
        raise ValueError(f"prediction_figure: y: expected [sequence, time, {outputs}], none of them empty, found {y}")
    shapes = {"mask": y, "ensemble_mean": y, "ensemble_std": y, "y_hat": (len(metrics["members"]), *y)}
    for name, expected in shapes.items():
        if predictions[name].shape != expected:
            raise ValueError(f"prediction_figure: {name}: expected {expected}, found {predictions[name].shape}")
    if not 0 <= sequence < y[0]:
        raise ValueError(f"prediction_figure: sequence: expected 0 to {y[0] - 1}, found {sequence}")


def _result(metrics: Metrics) -> str:
    best, unit = content.headline(metrics), content.unit(metrics)
    return (
        f"{content.merit(metrics)}: ensemble {rounded(best.ensemble, unit)} · members"
        f" {content.plus_minus(best.mean, best.std, unit)} (mean ± std) · {content.counts(metrics)}"
        f" · n_init {metrics['n_init']}"
    )


def compared(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> Compared:
    """The finished members and their ensemble.

    Where members were tested on different records there is no ensemble, and `y` is the record of the first member:
    then only members of its dataset belong to `y`, and their mean takes the place of the ensemble's.
    """
    members, y_hat = metrics["members"], np.asarray(predictions["y_hat"], np.float64)
    ok = np.array([member["status"] == "ok" for member in members], bool)
    mean, std = (np.asarray(predictions[name], np.float64) for name in ("ensemble_mean", "ensemble_std"))
    if not ok.any() or np.isfinite(mean).any():
        return Compared(y_hat[ok], mean, std, "ensemble mean", "")
    dataset = members[0]["dataset"]
    ok &= np.array([member["dataset"] == dataset for member in members], bool)
    remark = f"only dataset {dataset}: members have test records of their own, hence no ensemble · "
    if ok.any():
        mean, std = y_hat[ok].mean(0), y_hat[ok].std(0)
    return Compared(y_hat[ok], mean, std, f"mean of dataset {dataset}", remark)


def _signal(predictions: Mapping[str, np.ndarray], shown: Compared, sequence: int, k: int) -> Signal:
    def cut(values: np.ndarray) -> np.ndarray:
        values = np.asarray(values[..., sequence, :, k], np.float64)
        return np.where(np.isfinite(values), values, np.nan)

    measured = np.where(predictions["mask"][sequence, :, k], cut(predictions["y"]), np.nan)
    return Signal(measured, cut(shown.y_hat), cut(shown.mean), cut(shown.std))


def _handles(shown: Compared) -> list[Line2D | Patch]:
    measured = Line2D([], [], color=style.TRUTH, linewidth=2.8, label="measured")
    if not len(shown.y_hat):
        return [measured]
    return [
        measured,
        Line2D([], [], color=style.BLUE, linewidth=1.4, label=shown.label),
        Patch(facecolor=style.SKY, alpha=0.35, label="±1 std over members"),
        Line2D([], [], color=style.BLUE, linewidth=0.7, alpha=0.5, label="members"),
        Line2D([], [], color=style.VERMILLION, linewidth=1.2, label=f"residual: measured − {shown.label}"),
    ]
