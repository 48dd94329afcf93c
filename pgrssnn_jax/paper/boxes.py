"""How the seeds of every variant spread: one box per row of a table, beside the published figure."""

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

COLOURS = {"guided": style.BLUE, "black_box": style.YELLOW, "baseline": style.GREEN, "physics": style.QUIET}
KINDS = {"guided": "physics-guided", "black_box": "black box", "baseline": "other baseline", "physics": "physics only"}
PUBLISHED: dict[str, Any] = {"marker": "D", "markersize": 6, "markerfacecolor": "white", "markeredgewidth": 1.5}
PUBLISHED["markeredgecolor"] = style.VERMILLION
ALONE: dict[str, Any] = {"color": style.QUIET, "linestyle": (0, (4, 2))}
ROW = 0.34  # inches
FAR = 12.0  # largest over smallest figure, from which on the axis is logarithmic


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
