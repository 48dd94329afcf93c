"""Less training data: error and correlation against the number of samples, and what the smallest number leads to."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgrssnn_jax.paper.boxes import loud
from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable, Row
from pgrssnn_jax.reports import style
from pgrssnn_jax.reports.content import rounded
from pgrssnn_jax.reports.panels import limit
from pgrssnn_jax.reports.prediction import compared

LOOKS = (  # colour, line, marker: told apart without colour too
    (style.BLUE, "-", "o"),
    (style.VERMILLION, (0, (5, 1.5)), "s"),
    (style.GREEN, (0, (1.5, 1.2)), "^"),
    (style.YELLOW, (0, (6, 1.5, 1.5, 1.5)), "v"),
    (style.SKY, (0, (3, 1, 1, 1, 1, 1)), "P"),
)
STRETCH = 300  # samples that can be read one by one


class Curve(NamedTuple):
    """The mean prediction of the members of a run, `[time]`."""

    title: str
    y_hat: np.ndarray
    look: tuple


def can_be_curves(table: EvidenceTable) -> bool:
    """Is the table about the training samples, with no more variants than can be told apart?"""
    return bool(table.sizes) and len(_looks(table)) <= len(LOOKS)


def efficiency_figure(table: EvidenceTable, paper: Paper) -> Figure:
    """Mean over members against the samples trained on, and where all of them lie."""
    lines = ["line: mean over finished members, band: from the least to the greatest of them, dots: members"]
    figure = style.headed(4.1, table.title, [*lines, f"published: {paper.source}"], loud(table))
    panels = [(table.merit, table.merit.upper(), table.unit), ("cc", "CC", "")]
    for k, (merit, name, unit) in enumerate(panels):
        ax = figure.add_subplot(1, 2, k + 1)
        style.quiet(ax, x=_amount(table, paper), y=style.label(f"test {name}", unit))
        ax.set_xticks(table.sizes)
        for series, look in _looks(table).items():
            _draw_series(ax, [row for row in table.rows if row.series == series], merit, look)
        if merit == table.merit:
            _draw_published(ax, table)
        if not ax.lines:
            style.note(ax, "no member finished")
    handles = [
        Line2D([], [], color=colour, linestyle=dash, marker=marker, markersize=5, label=style.plain(series))
        for series, (colour, dash, marker) in _looks(table).items()
    ]
    look = {"marker": "D", "markerfacecolor": "white", "markeredgecolor": style.INK, "markeredgewidth": 1.4}
    handles.append(
        Line2D([], [], linewidth=0, markersize=6.5, label="published mean, in the colour of its model", **look)
    )
    style.legend(figure, handles)
    return figure


def _amount(table: EvidenceTable, paper: Paper) -> str:
    """Of the arms n_train counts sequences, of other data what their loader says."""
    known = paper.systems.get(table.system)
    return "training samples" if known and known.n_train is not None else "n_train"


def _looks(table: EvidenceTable) -> dict[str, tuple]:
    series = dict.fromkeys(row.series for row in table.rows if row.state != "quoted")
    return {name: LOOKS[k % len(LOOKS)] for k, name in enumerate(series)}


def _draw_series(ax: Axes, rows: Sequence[Row], merit: str, look: tuple) -> None:
    colour, dash, marker = look
    points = []
    for row in rows:
        values = np.array([value for value in row.values(merit) if np.isfinite(value)])
        if row.variant.n_train is None or not len(values):
            continue
        points.append((row.variant.n_train, values.mean(), values.min(), values.max()))
        if len(values) > 1:
            ax.plot(np.full(len(values), row.variant.n_train), values, ".", color=colour, alpha=0.35, markersize=5)
    if points:
        n, mean, least, greatest = np.array(sorted(points)).T
        ax.fill_between(n, least, greatest, color=colour, alpha=0.13, linewidth=0)
        ax.plot(n, mean, color=colour, linestyle=dash, marker=marker, markersize=5, linewidth=1.6, gid="mean")


def _draw_published(ax: Axes, table: EvidenceTable) -> None:
    looks = _looks(table)
    for row in table.rows:
        n_train, mean = row.variant.n_train, row.published.mean if row.published else None
        if n_train is not None and mean is not None:
            edge = {"markeredgecolor": looks[row.series][0], "markeredgewidth": 1.5}
            ax.plot(n_train, mean, "D", markersize=7, markerfacecolor="white", zorder=5, gid="published", **edge)


def overlay_figure(table: EvidenceTable, paper: Paper) -> Figure:
    """Measured and predicted with the fewest training samples: a stretch from the middle, and the whole test record.

    The prediction of a model is the mean over its finished members. Runs whose predictions cannot be read, or belong to
    another test record, are named as left out.
    """
    size = table.sizes[0]
    curves: list[Curve] = []
    measured, metrics, left_out = np.zeros(0), None, []
    for row in table.rows:
        if row.variant.n_train != size:
            continue
        found = _prediction(row)
        if found is None or (metrics is not None and not np.array_equal(found[0], measured, equal_nan=True)):
            left_out.append(row.series)
            continue
        measured, metrics = found[0], row.run.metrics if row.run else None
        title = f"{row.series}: {rounded(row.figures.ensemble, table.unit)}"
        curves.append(Curve(title, found[1], _looks(table)[row.series]))
    what = f"beside its name the {table.merit.upper()} of the curve"
    lines = [f"free run over the test record; a curve is the mean prediction of the finished members, {what}"]
    lines += [f"left out, no prediction: {', '.join(left_out)}"] if left_out else []
    figure = style.headed(5.4, f"{table.title} · {_amount(table, paper)}: {size}", lines, loud(table))
    top, under = figure.add_subplot(2, 1, 1), figure.add_subplot(2, 1, 2)
    if metrics is None:
        for ax in (top, under):
            style.note(style.quiet(ax), "no member finished")
        return figure
    output = metrics["outputs"][0]
    start = max(0, (len(measured) - STRETCH) // 2)
    stop = min(len(measured), start + STRETCH)
    for ax, (a, b), wide in ((top, (start, stop), 1.5), (under, (0, len(measured)), 1.0)):
        title = f"samples {a} to {b - 1}" if ax is top else f"whole test record, {b} samples; shaded: the stretch above"
        style.quiet(ax, title=title, y=style.label(output["name"], output.get("unit", "")), x="time (s)")
        t = metrics["dt"] * np.arange(a, b)
        ax.plot(t, measured[a:b], color=style.TRUTH, linewidth=3.0 * wide / 1.5, alpha=0.8)
        for curve in curves:
            ax.plot(t, curve.y_hat[a:b], color=curve.look[0], linestyle=curve.look[1], linewidth=wide)
        limit(ax, measured[a:b], np.concatenate([curve.y_hat[a:b] for curve in curves]))
        ax.margins(x=0.01)
    under.axvspan(metrics["dt"] * start, metrics["dt"] * (stop - 1), color=style.YELLOW, alpha=0.15, linewidth=0)
    handles = [Line2D([], [], color=style.TRUTH, linewidth=3.0, label="measured")]
    handles += [
        Line2D([], [], color=c.look[0], linestyle=c.look[1], linewidth=1.6, label=style.plain(c.title)) for c in curves
    ]
    style.legend(figure, handles)
    return figure


def _prediction(row: Row) -> tuple[np.ndarray, np.ndarray] | None:
    """Measured and predicted first output of the first test sequence, `[time]`; None where there is no such file."""
    if row.run is None or row.run.metrics is None or not row.finished:
        return None
    try:
        with np.load(row.run.path / "predictions.npz") as stored:
            arrays = {name: stored[name] for name in ("y", "mask", "y_hat", "ensemble_mean", "ensemble_std")}
        y = np.where(arrays["mask"], arrays["y"], np.nan)[0, :, 0].astype(np.float64)
        return y, compared(arrays, row.run.metrics).mean[0, :, 0]
    except Exception:  # a damaged archive fails in many ways; the figure names the run
        return None
