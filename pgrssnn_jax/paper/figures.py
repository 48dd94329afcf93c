"""The figures of many runs: how the seeds of every variant spread beside the published figure, and what less training
data leads to."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable, Row
from pgrssnn_jax.paper.tables import who
from pgrssnn_jax.reports import style
from pgrssnn_jax.reports.content import number
from pgrssnn_jax.reports.panels import Curve, Signals, draw_signal
from pgrssnn_jax.reports.prediction import compared

KINDS = {
    "guided": ("physics-guided", style.BLUE),
    "black_box": ("black box", style.YELLOW),
    "baseline": ("other baseline", style.GREEN),
    "physics": ("physics only", style.QUIET),
}
PUBLISHED: dict[str, Any] = {"marker": "D", "markersize": 6, "markerfacecolor": "white", "markeredgewidth": 1.5}
ROW = 0.34  # inches
FAR = 12.0  # largest over smallest figure, from which on the axis is logarithmic
LOOKS: tuple[dict[str, Any], ...] = (  # told apart without colour too
    {"color": style.BLUE, "linestyle": "-", "marker": "o"},
    {"color": style.VERMILLION, "linestyle": (0, (5, 1.5)), "marker": "s"},
    {"color": style.GREEN, "linestyle": (0, (1.5, 1.2)), "marker": "^"},
    {"color": style.YELLOW, "linestyle": (0, (6, 1.5, 1.5, 1.5)), "marker": "v"},
    {"color": style.SKY, "linestyle": (0, (3, 1, 1, 1, 1, 1)), "marker": "P"},
)
STRETCH = 300  # samples that can be read one by one


def box_figure(table: EvidenceTable, paper: Paper) -> Figure:
    """Median, quartiles and extremes over finished members, each member a dot; failed members by name at the right."""
    rows = [row for row in table.rows if row.state != "quoted"]
    counted = sum(len(row.finished) for row in rows), sum(row.planned or 0 for row in rows)
    lines = [
        f"{counted[0]} of {counted[1]} members finished in the runs there are",
        f"box: quartiles, line: median, whiskers: all members · published: {paper.source}, means over runs",
    ]
    figure = style.headed(ROW * len(rows) + 0.75, table.title, lines, loud(table))
    ax = style.quiet(figure.add_subplot(), x=style.label(f"test {table.merit.upper()}", table.unit))
    style.rows(ax, [row.label for row in rows])
    ax.tick_params(axis="y", labelcolor=style.INK, labelsize=8.5)
    published = [(k, row.published.mean) for k, row in enumerate(rows) if row.published]
    published = [(place, mean) for place, mean in published if mean is not None]
    shown = np.array([*(value for row in rows for value in row.finite(table.merit)), *(mean for _, mean in published)])
    if len(shown) and shown.min() > 0 and shown.max() > FAR * shown.min():
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
    for place, row in enumerate(rows):
        known = paper.models.get(row.variant.model)
        _draw_row(ax, place, row, known.kind if known else "baseline", table.merit)
    for place, mean in published:
        look = {**PUBLISHED, "markeredgecolor": style.VERMILLION, "gid": "published", "label": "published mean"}
        ax.plot(mean, place, linewidth=0, zorder=4, **look)
    physics = [row for row in table.measured if row.variant.model == "physics_only"]
    if len(physics) == 1:
        look = {"color": style.QUIET, "linestyle": style.DASHED, "gid": "physics", "label": "physics only"}
        ax.axvline(physics[0].figures.mean, linewidth=1.1, zorder=1, **look)
    if not len(shown):
        ax.set_xticks([])
        style.note(ax, "no member finished")
    style.legend(figure)
    return figure


def loud(table: EvidenceTable) -> list[str]:
    """What nobody may overlook in a figure of this table."""
    failed = sum(len(row.failed) for row in table.rows)
    absent = sum(row.state in ("missing", "failed", "unfinished", "damaged") for row in table.rows)
    phrases = {
        "SIMULATED DATA": any(row.simulated for row in table.rows),
        f"{failed} MEMBER{'S'[: failed - 1]} FAILED": failed,
        f"{absent} RUN{'S'[: absent - 1]} WITHOUT FIGURES": absent,
        f"BUDGET {table.budget}".upper(): table.budget,
    }
    return [text for text, true in phrases.items() if true]


def _draw_row(ax: Axes, place: int, row: Row, kind: str, merit: str) -> None:
    values, (label, colour) = row.finite(merit), KINDS[kind]
    if len(values) > 1:
        line = {"color": style.INK, "linewidth": 0.9}
        looks: dict[str, Any] = {"whiskerprops": line, "capprops": line, "medianprops": line | {"linewidth": 1.7}}
        looks["boxprops"] = {"facecolor": colour, "alpha": 0.30, "edgecolor": style.INK, "linewidth": 0.9}
        place_of = {"positions": [place], "widths": 0.56, "orientation": "horizontal", "manage_ticks": False}
        ax.boxplot(values, whis=(0, 100), patch_artist=True, **place_of, **looks)
    lift = 0.15 * np.sin(2.4 * np.arange(len(values))) if len(values) > 1 else np.zeros(len(values))
    look: dict[str, Any] = {"markersize": 3.6, "alpha": 0.8, "markeredgewidth": 0, "zorder": 3}
    ax.plot(values, place + lift, "o", color=colour, label=label, **look)
    good = row.metrics is not None and not row.failed
    text = f"{len(row.finished)} of {row.planned}" if good else row.state
    if row.failed:
        text = f"{len(row.failed)} of {row.planned} failed: {who(row, row.failed[:4])}"
        text += f" and {len(row.failed) - 4} more" if len(row.failed) > 4 else ""
    at = {"transform": ax.get_yaxis_transform(), "va": "center", "fontsize": 8}
    ax.text(1.01, place, text, color=style.QUIET if good else style.VERMILLION, **at)


def can_be_curves(table: EvidenceTable) -> bool:
    """Is the table about the training samples, with no more variants than can be told apart?"""
    return bool(table.sizes) and len(_looks(table)) <= len(LOOKS)


def efficiency_figure(table: EvidenceTable, paper: Paper) -> Figure:
    """Mean over members against the samples trained on, and where all of them lie."""
    lines = ["line: mean over finished members, band: from the least to the greatest of them, dots: members"]
    figure = style.headed(4.1, table.title, [*lines, f"published: {paper.source}"], loud(table))
    for ax, merit, unit in zip(figure.subplots(1, 2), (table.merit, "cc"), (table.unit, ""), strict=True):
        style.quiet(ax, x=_amount(table, paper), y=style.label(f"test {merit.upper()}", unit))
        ax.set_xticks(table.sizes)
        for series, look in _looks(table).items():
            _draw_series(ax, [row for row in table.rows if row.series == series], merit, look)
        if not ax.lines:
            style.note(ax, "no member finished")
    look = {**PUBLISHED, "markeredgecolor": style.INK, "label": "published mean, in the colour of its model"}
    style.legend(figure, Line2D([], [], linewidth=0, **look))
    return figure


def _amount(table: EvidenceTable, paper: Paper) -> str:
    """Of the arms n_train counts sequences, of other data what their loader says."""
    known = paper.systems.get(table.system)
    return "training samples" if known and known.n_train is not None else "n_train"


def _looks(table: EvidenceTable) -> dict[str, dict[str, Any]]:
    series = dict.fromkeys(row.series for row in table.rows if row.state != "quoted")
    return {name: LOOKS[k % len(LOOKS)] for k, name in enumerate(series)}


def _draw_series(ax: Axes, rows: Sequence[Row], merit: str, look: dict[str, Any]) -> None:
    points = []
    for row in rows:
        n, values = row.variant.n_train, row.finite(merit)
        if n is not None and len(values):
            points.append((n, values.mean(), values.min(), values.max()))
            if len(values) > 1:
                ax.plot(np.full(len(values), n), values, ".", color=look["color"], alpha=0.35, markersize=5)
        if n is not None and merit != "cc" and row.published and row.published.mean is not None:
            mark = {**PUBLISHED, "markeredgecolor": look["color"], "gid": "published"}
            ax.plot(n, row.published.mean, zorder=5, **mark)
    if points:
        n, mean, least, greatest = np.array(sorted(points)).T
        ax.fill_between(n, least, greatest, color=look["color"], alpha=0.13, linewidth=0)
        ax.plot(n, mean, markersize=5, linewidth=1.6, gid="mean", label=style.plain(rows[0].series), **look)


def overlay_figure(table: EvidenceTable, paper: Paper) -> Figure:
    """Measured and predicted with the fewest training samples: a stretch from the middle, and the whole test record.

    The prediction of a model is the mean over its finished members. Runs whose predictions cannot be read, or belong to
    another test record, are named as left out.
    """
    curves: list[Curve] = []
    measured, metrics, left_out = np.zeros((0, 1)), None, []
    for row in table.rows:
        if row.variant.n_train != table.sizes[0]:
            continue
        found = _prediction(row)
        if found is None or (metrics is not None and not np.array_equal(found[0], measured, equal_nan=True)):
            left_out.append(row.series)
            continue
        measured, metrics, look = found[0], row.metrics, _looks(table)[row.series]
        name = style.plain(f"{row.series}: {number(row.figures.ensemble, table.unit)}")
        curves.append(Curve(name, row.series, found[1], look["color"], dash=look["linestyle"]))
    what = f"beside its name the {table.merit.upper()} of the curve"
    lines = [f"free run over the test record; a curve is the mean prediction of the finished members, {what}"]
    lines += [f"left out, no prediction: {', '.join(left_out)}"] if left_out else []
    figure = style.headed(5.4, f"{table.title} · {_amount(table, paper)}: {table.sizes[0]}", lines, loud(table))
    top, under = figure.subplots(2, 1)
    if metrics is None:
        for ax in (top, under):
            style.note(style.quiet(ax), "no member finished")
        return figure
    time = len(measured)
    start = max(0, (time - STRETCH) // 2)
    stop = min(time, start + STRETCH)
    t, nothing = metrics["dt"] * np.arange(time), np.full((0, time, 1), np.nan)
    signals = Signals(metrics["outputs"], t, measured, curves, nothing, np.full((time, 1), np.nan))
    draw_signal(top, signals.cut(start, stop), 0, x="time (s)", title=f"samples {start} to {stop - 1}")
    whole = f"whole test record, {time} samples; shaded: the stretch above"
    draw_signal(under, signals, 0, x="time (s)", title=whole)
    under.axvspan(t[start], t[stop - 1], color=style.YELLOW, alpha=0.15, linewidth=0)
    style.legend(figure)
    return figure


def _prediction(row: Row) -> tuple[np.ndarray, np.ndarray] | None:
    """Measured and predicted first output of the first test sequence, `[time, 1]`; None where there is no such file."""
    if row.run is None or row.metrics is None or not row.finished:
        return None
    try:
        with np.load(row.run.path / "predictions.npz") as stored:
            arrays = {name: stored[name] for name in ("y", "mask", "y_hat", "ensemble_mean", "ensemble_std")}
        y = np.where(arrays["mask"], arrays["y"], np.nan)[0, :, :1].astype(np.float64)
        return y, compared(arrays, row.metrics).mean[0, :, :1]
    except Exception:  # a damaged archive fails in many ways; the figure names the run
        return None
