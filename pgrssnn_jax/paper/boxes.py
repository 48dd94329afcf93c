"""How the seeds of every variant spread: one box per row of a table, beside the published figure."""

from collections.abc import Sequence

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
    places = [value for row in rows for value in row.values(table.merit) if np.isfinite(value)]
    published = [row.published.mean if row.published and row.published.mean is not None else None for row in rows]
    shown = np.array([*places, *(mean for mean in published if mean is not None)])
    if len(shown) and shown.min() > 0 and shown.max() > FAR * shown.min():
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter(NullFormatter())
    for place, row in enumerate(rows):
        _draw_row(ax, place, row, _colour(row, paper), table.merit)
    for place, mean in enumerate(published):
        if mean is not None:
            look = {"markerfacecolor": "white", "markeredgecolor": style.VERMILLION, "markeredgewidth": 1.5}
            ax.plot(mean, place, "D", markersize=6, zorder=4, gid="published", **look)
    physics = [row for row in table.measured if _kind(row, paper) == "physics"]
    if len(physics) == 1:
        ax.axvline(
            physics[0].figures.mean, color=style.QUIET, linestyle=(0, (4, 2)), linewidth=1.1, zorder=1, gid="physics"
        )
    if not len(shown):
        ax.set_xticks([])
        style.note(ax, "no member finished")
    style.legend(figure, _handles(rows, paper, any(m is not None for m in published), len(physics) == 1))
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


def _colour(row: Row, paper: Paper) -> str:
    return COLOURS[_kind(row, paper)]


def _draw_row(ax: Axes, place: int, row: Row, colour: str, merit: str) -> None:
    values = np.array([value for value in row.values(merit) if np.isfinite(value)])
    if len(values) > 1:
        line = {"color": style.INK, "linewidth": 0.9}
        ax.boxplot(
            values,
            positions=[place],
            widths=0.56,
            orientation="horizontal",
            manage_ticks=False,
            whis=(0, 100),
            patch_artist=True,
            boxprops={"facecolor": colour, "alpha": 0.30, "edgecolor": style.INK, "linewidth": 0.9},
            medianprops={"color": style.INK, "linewidth": 1.7},
            whiskerprops=line,
            capprops=line,
        )
    lift = 0.15 * np.sin(2.4 * np.arange(len(values))) if len(values) > 1 else np.zeros(len(values))
    ax.plot(values, place + lift, "o", color=colour, markersize=3.6, alpha=0.8, markeredgewidth=0, zorder=3)
    at = {"transform": ax.get_yaxis_transform(), "va": "center", "fontsize": 8}
    if row.run is None or row.run.metrics is None:
        ax.text(1.01, place, row.state, color=style.VERMILLION, **at)
    elif row.failed:
        text = f"{len(row.failed)} of {row.planned} failed: {who(row, row.failed[:4])}"
        text += f" and {len(row.failed) - 4} more" if len(row.failed) > 4 else ""
        ax.text(1.01, place, text, color=style.VERMILLION, **at)
    else:
        ax.text(1.01, place, f"{len(row.finished)} of {row.planned}", color=style.QUIET, **at)


def _handles(rows: Sequence[Row], paper: Paper, published: bool, alone: bool) -> list[Artist]:
    kinds = {_kind(row, paper) for row in rows}
    boxed = kinds - {"physics"} if alone else kinds
    handles: list[Artist] = [Patch(facecolor=COLOURS[k], alpha=0.45, label=KINDS[k]) for k in KINDS if k in boxed]
    if alone:
        handles.append(Line2D([], [], color=style.QUIET, linestyle=(0, (4, 2)), label="physics only"))
    if published:
        look = {"marker": "D", "markerfacecolor": "white", "markeredgecolor": style.VERMILLION, "markeredgewidth": 1.5}
        handles.append(Line2D([], [], linewidth=0, markersize=6, label="published mean", **look))
    return handles
