"""The look that all figures share: colour-blind-safe colours (Okabe and Ito), quiet axes, a header that states facts.

Everything is set on the objects themselves; matplotlib's global settings are neither read for style nor changed.
"""

import textwrap
from collections.abc import Sequence
from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgrssnn_jax.records.units import with_unit
from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import Metrics

INK, QUIET, GRID, TRUTH, FAINT = "#1b1f24", "#5f6873", "#e6e8eb", "#8b939d", "#b4bac2"
BLUE, SKY, GREEN, VERMILLION, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00"
DASHED, DOTTED = (0, (4, 2)), (0, (1, 1.5))

WIDTH, HEADER, MARGIN = 11.0, 1.12, 0.16  # inches


def plain(text: str) -> str:
    """Text as it stands: a dollar sign in a name opens no formula."""
    return text.replace("$", r"\$")


def marker(samples: int) -> str:
    """Of a line with so few samples that each should be seen."""
    return "." if samples <= 60 else ""


def label(name: str, unit: str | None) -> str:
    return plain(with_unit(name, unit))


def page(body: float, metrics: Metrics, lines: Sequence[str]) -> Figure:
    """The empty figure of a run; simulated data and missing members are said loudly."""
    loud = ["SIMULATED DATA" if content.simulated(metrics) else "", content.incomplete(metrics).upper()]
    return headed(body, content.heading(metrics), lines, list(filter(None, loud)))


def headed(body: float, title: str, lines: Sequence[str], loud: Sequence[str]) -> Figure:
    """An empty white figure, `body` inches high below its header: title, up to two `lines`, room for a legend.

    loud: phrases at the top right that nobody may overlook.
    """
    height = HEADER + body
    figure = Figure((WIDTH, height), dpi=150, facecolor="white")
    inset = MARGIN / 2 / height
    area = (0.005, inset, 0.99, 1 - HEADER / height - inset)
    figure.set_layout_engine("constrained", rect=area, w_pad=0.06, h_pad=0.055)
    left, right = MARGIN / WIDTH, 1 - MARGIN / WIDTH
    figure.text(left, 1 - 0.14 / height, plain(title), va="top", fontsize=13, fontweight="bold", color=INK)
    for row, line in enumerate(lines[:2]):
        text = plain(textwrap.shorten(line, int((WIDTH - 2 * MARGIN) * 14.5), placeholder=" …"))
        figure.text(left, 1 - (0.44 + 0.19 * row) / height, text, va="top", fontsize=8.5, color=QUIET)
    if loud:
        look: dict[str, Any] = {"fontsize": 8.5, "fontweight": "bold", "color": "white", "ha": "right", "va": "top"}
        look["bbox"] = {"boxstyle": "round,pad=0.35", "facecolor": VERMILLION, "edgecolor": "none"}
        figure.text(right, 1 - 0.16 / height, plain("   ·   ".join(loud)), **look)
    return figure


def legend(figure: Figure, *more: Artist) -> None:
    """One row at the foot of the header: every label of the panels once, then what no panel draws."""
    found: dict[str, Any] = {}
    for ax in figure.axes:
        for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    found |= {str(one.get_label()): one for one in more}
    if not found:
        return
    shown = figure.legend(
        handles=list(found.values()),
        labels=list(found),
        loc="upper left",
        bbox_to_anchor=((MARGIN + 0.01) / WIDTH, 1 - 0.82 / figure.get_size_inches()[1]),
        ncols=len(found),
        frameon=False,
        fontsize=8.5,
        borderpad=0.1,
        borderaxespad=0.0,
        handlelength=1.8,
        columnspacing=1.8,
        labelcolor=INK,
    )
    for handle in shown.legend_handles:
        if isinstance(handle, Line2D):  # many members are drawn faint
            handle.set_alpha(max(handle.get_alpha() or 1.0, 0.5))


def quiet(ax: Axes, *, title: str = "", x: str = "", y: str = "") -> Axes:
    """Left and bottom spine, a faint grid behind the data, small grey ticks, labels as given."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set(color=FAINT, linewidth=0.8)
    ax.set_facecolor("white")
    ax.grid(True, which="major", color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(which="both", colors=FAINT, labelcolor=QUIET, labelsize=8, length=3, width=0.8)
    ax.set_title(title, loc="left", fontsize=9, color=INK, pad=5)
    ax.set_xlabel(x, fontsize=8.5, color=INK)
    ax.set_ylabel(y, fontsize=8.5, color=INK)
    return ax


def rows(ax: Axes, names: Sequence[str]) -> None:
    """A row for each name, from the top."""
    ax.set_yticks(range(len(names)), list(map(plain, names)))
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.grid(False, axis="y")


def note(ax: Axes, text: str, *, blank: bool = False) -> None:
    """One sentence in the middle of the panel, for what cannot be drawn; blank: the panel has no scale either."""
    box = {"boxstyle": "round,pad=0.4", "facecolor": "white", "edgecolor": GRID}
    place = {"transform": ax.transAxes, "ha": "center", "va": "center"}
    ax.text(0.5, 0.5, plain(text), fontsize=9, color=VERMILLION, bbox=box, **place)
    if blank:
        ax.set(xticks=[], yticks=[])
