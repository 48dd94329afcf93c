"""The figures of many runs: how the seeds of every variant spread beside the published figure, and what less training
data leads to."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter

from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable, Row
from pgrssnn_jax.paper.tables import who
from pgrssnn_jax.reports import style
from pgrssnn_jax.reports.content import number
from pgrssnn_jax.reports.panels import limit
from pgrssnn_jax.reports.prediction import compared

COLOURS = {"guided": style.BLUE, "black_box": style.YELLOW, "baseline": style.GREEN, "physics": style.QUIET}
KINDS = {"guided": "physics-guided", "black_box": "black box", "baseline": "other baseline", "physics": "physics only"}
PUBLISHED: dict[str, Any] = {"marker": "D", "markersize": 6, "markerfacecolor": "white", "markeredgewidth": 1.5}
PUBLISHED["markeredgecolor"] = style.VERMILLION
ALONE: dict[str, Any] = {"color": style.QUIET, "linestyle": (0, (4, 2))}
ROW = 0.34  # inches
FAR = 12.0  # largest over smallest figure, from which on the axis is logarithmic
LOOKS = (  # colour, line, marker: told apart without colour too
    (style.BLUE, "-", "o"),
    (style.VERMILLION, (0, (5, 1.5)), "s"),
    (style.GREEN, (0, (1.5, 1.2)), "^"),
    (style.YELLOW, (0, (6, 1.5, 1.5, 1.5)), "v"),
    (style.SKY, (0, (3, 1, 1, 1, 1, 1)), "P"),
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
    ax.grid(False, axis="y")
    ax.set_yticks(range(len(rows)), [style.plain(row.label) for row in rows], color=style.INK, fontsize=8.5)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    published = {
        k: row.published.mean for k, row in enumerate(rows) if row.published and row.published.mean is not None
    }
    shown = np.array([*(value for row in rows for value in row.finite(table.merit)), *published.values()])
    if len(shown) and shown.min() > 0 and shown.max() > FAR * shown.min():
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
    for place, row in enumerate(rows):
        _draw_row(ax, place, row, COLOURS[_kind(row, paper)], table.merit)
    for place, mean in published.items():
        ax.plot(mean, place, linewidth=0, zorder=4, gid="published", **PUBLISHED)
    physics = [row for row in table.measured if _kind(row, paper) == "physics"]
    if len(physics) == 1:
        ax.axvline(physics[0].figures.mean, linewidth=1.1, zorder=1, gid="physics", **ALONE)
    if not len(shown):
        ax.set_xticks([])
        style.note(ax, "no member finished")
    kinds = {_kind(row, paper) for row in rows} - ({"physics"} if len(physics) == 1 else set())
    handles: list[Artist] = [Patch(facecolor=COLOURS[k], alpha=0.45, label=KINDS[k]) for k in KINDS if k in kinds]
    handles += [Line2D([], [], label="physics only", **ALONE)] if len(physics) == 1 else []
    handles += [Line2D([], [], linewidth=0, label="published mean", **PUBLISHED)] if published else []
    style.legend(figure, handles)
    return figure


def loud(table: EvidenceTable) -> list[str]:
    """What nobody may overlook in a figure of this table."""
    failed = sum(len(row.failed) for row in table.rows)
    absent = sum(row.state in ("missing", "failed", "unfinished", "damaged") for row in table.rows)
    simulated = any(row.run and row.run.metrics and row.run.metrics["source"] == "simulated" for row in table.rows)
    phrases = {
        "SIMULATED DATA": simulated,
        f"{failed} MEMBER{'S'[: failed - 1]} FAILED": failed,
        f"{absent} RUN{'S'[: absent - 1]} WITHOUT FIGURES": absent,
        f"BUDGET {table.budget}".upper(): table.budget,
    }
    return [text for text, true in phrases.items() if true]


def _kind(row: Row, paper: Paper) -> str:
    known = paper.models.get(row.variant.model)
    return known.kind if known else "baseline"


def _draw_row(ax: Axes, place: int, row: Row, colour: str, merit: str) -> None:
    values = row.finite(merit)
    if len(values) > 1:
        line = {"color": style.INK, "linewidth": 0.9}
        looks: dict[str, Any] = {"whiskerprops": line, "capprops": line, "medianprops": line | {"linewidth": 1.7}}
        looks["boxprops"] = {"facecolor": colour, "alpha": 0.30, "edgecolor": style.INK, "linewidth": 0.9}
        place_of = {"positions": [place], "widths": 0.56, "orientation": "horizontal", "manage_ticks": False}
        ax.boxplot(values, whis=(0, 100), patch_artist=True, **place_of, **looks)
    lift = 0.15 * np.sin(2.4 * np.arange(len(values))) if len(values) > 1 else np.zeros(len(values))
    ax.plot(values, place + lift, "o", color=colour, markersize=3.6, alpha=0.8, markeredgewidth=0, zorder=3)
    good = row.run is not None and row.run.metrics is not None and not row.failed
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
    axes = figure.subplots(1, 2)
    for ax, merit, name, unit in ((axes[0], table.merit, table.merit.upper(), table.unit), (axes[1], "cc", "CC", "")):
        style.quiet(ax, x=_amount(table, paper), y=style.label(f"test {name}", unit))
        ax.set_xticks(table.sizes)
        for series, look in _looks(table).items():
            _draw_series(ax, [row for row in table.rows if row.series == series], merit, look)
        if not ax.lines:
            style.note(ax, "no member finished")
    handles = [
        style.key(style.plain(series), colour, linestyle=dash, marker=marker, markersize=5)
        for series, (colour, dash, marker) in _looks(table).items()
    ]
    look = {**PUBLISHED, "markeredgecolor": style.INK}
    published = Line2D([], [], linewidth=0, label="published mean, in the colour of its model", **look)
    style.legend(figure, [*handles, published])
    return figure


def _amount(table: EvidenceTable, paper: Paper) -> str:
    """Of the arms n_train counts sequences, of other data what their loader says."""
    known = paper.systems.get(table.system)
    return "training samples" if known and known.n_train is not None else "n_train"


def _looks(table: EvidenceTable) -> dict[str, tuple[Any, ...]]:
    series = dict.fromkeys(row.series for row in table.rows if row.state != "quoted")
    return {name: LOOKS[k % len(LOOKS)] for k, name in enumerate(series)}


def _draw_series(ax: Axes, rows: Sequence[Row], merit: str, look: tuple[Any, ...]) -> None:
    colour, dash, marker = look
    points = []
    for row in rows:
        n, values = row.variant.n_train, row.finite(merit)
        if n is not None and len(values):
            points.append((n, values.mean(), values.min(), values.max()))
            if len(values) > 1:
                ax.plot(np.full(len(values), n), values, ".", color=colour, alpha=0.35, markersize=5)
        if n is not None and merit != "cc" and row.published and row.published.mean is not None:
            ax.plot(n, row.published.mean, zorder=5, gid="published", **{**PUBLISHED, "markeredgecolor": colour})
    if points:
        n, mean, least, greatest = np.array(sorted(points)).T
        ax.fill_between(n, least, greatest, color=colour, alpha=0.13, linewidth=0)
        ax.plot(n, mean, color=colour, linestyle=dash, marker=marker, markersize=5, linewidth=1.6, gid="mean")


def overlay_figure(table: EvidenceTable, paper: Paper) -> Figure:
    """Measured and predicted with the fewest training samples: a stretch from the middle, and the whole test record.

    The prediction of a model is the mean over its finished members. Runs whose predictions cannot be read, or belong to
    another test record, are named as left out.
    """
    curves: list[tuple[str, np.ndarray, tuple[Any, ...]]] = []  # title, prediction [time], look
    measured, metrics, left_out = np.zeros(0), None, []
    for row in table.rows:
        if row.variant.n_train != table.sizes[0]:
            continue
        found = _prediction(row)
        if found is None or (metrics is not None and not np.array_equal(found[0], measured, equal_nan=True)):
            left_out.append(row.series)
            continue
        measured, metrics = found[0], row.run.metrics if row.run else None
        title = f"{row.series}: {number(row.figures.ensemble, table.unit)}"
        curves.append((title, found[1], _looks(table)[row.series]))
    what = f"beside its name the {table.merit.upper()} of the curve"
    lines = [f"free run over the test record; a curve is the mean prediction of the finished members, {what}"]
    lines += [f"left out, no prediction: {', '.join(left_out)}"] if left_out else []
    figure = style.headed(5.4, f"{table.title} · {_amount(table, paper)}: {table.sizes[0]}", lines, loud(table))
    top, under = figure.subplots(2, 1)
    if metrics is None:
        for ax in (top, under):
            style.note(style.quiet(ax), "no member finished")
        return figure
    output, time = metrics["outputs"][0], len(measured)
    start = max(0, (time - STRETCH) // 2)
    stop = min(time, start + STRETCH)
    t = metrics["dt"] * np.arange(time)
    whole = f"whole test record, {time} samples; shaded: the stretch above"
    for ax, a, b, wide, title in (
        (top, start, stop, 1.5, f"samples {start} to {stop - 1}"),
        (under, 0, time, 1.0, whole),
    ):
        style.quiet(ax, title=title, y=style.label(output["name"], output.get("unit", "")), x="time (s)")
        ax.plot(t[a:b], measured[a:b], color=style.TRUTH, linewidth=2 * wide, alpha=0.8)
        for _, y_hat, (colour, dash, _) in curves:
            ax.plot(t[a:b], y_hat[a:b], color=colour, linestyle=dash, linewidth=wide)
        limit(ax, measured[a:b], np.concatenate([y_hat[a:b] for _, y_hat, _ in curves]))
        ax.margins(x=0.01)
    under.axvspan(t[start], t[stop - 1], color=style.YELLOW, alpha=0.15, linewidth=0)
    handles = [style.key(style.plain(name), c, linestyle=dash, linewidth=1.6) for name, _, (c, dash, _) in curves]
    style.legend(figure, [style.key("measured", style.TRUTH, linewidth=3.0), *handles])
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
