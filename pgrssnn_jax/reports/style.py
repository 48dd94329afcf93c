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

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import Metrics

INK, QUIET, GRID, TRUTH = "#1b1f24", "#5f6873", "#e6e8eb", "#8b939d"
BLUE, SKY, GREEN, VERMILLION, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00"

WIDTH, HEADER = 11.0, 1.12  # inches
MARGIN = 0.16


def plain(text: str) -> str:
    """Text as it stands: a dollar sign in a name opens no formula."""
    return text.replace("$", r"\$")


def label(name: str, unit: str) -> str:
    return plain(f"{name} ({unit})" if unit else f"{name} (–)")


def page(body: float, metrics: Metrics, lines: Sequence[str]) -> Figure:
    """The empty figure of a run; simulated data and missing members are said loudly."""
    loud = ["SIMULATED DATA" if content.simulated(metrics) else "", content.incomplete(metrics).upper()]
    return headed(body, content.heading(metrics), lines, list(filter(None, loud)))


def headed(body: float, title: str, lines: Sequence[str], loud: Sequence[str]) -> Figure:
    """An empty white figure, `body` inches high below its header: title, up to two `lines`, room for a legend.

    loud: phrases at the top right that nobody may overlook.
    """
    width, height = WIDTH, HEADER + body
    figure = Figure((width, height), dpi=150, facecolor="white")
    inset = MARGIN / 2 / height
    figure.set_layout_engine(
        "constrained", rect=(0.005, inset, 0.99, 1 - HEADER / height - inset), w_pad=0.06, h_pad=0.055
    )

    def write(right: bool, down: float, text: str, **look: Any) -> None:
        x = 1 - MARGIN / width if right else MARGIN / width
        figure.text(x, 1 - down / height, plain(text), ha="right" if right else "left", va="top", **look)

    write(False, 0.14, title, fontsize=13, fontweight="bold", color=INK)
    letters = int((width - 2 * MARGIN) * 14.5)
    for row, line in enumerate(lines[:2]):
        write(False, 0.44 + 0.19 * row, textwrap.shorten(line, letters, placeholder=" …"), fontsize=8.5, color=QUIET)
    if loud:
        box = {"boxstyle": "round,pad=0.35", "facecolor": VERMILLION, "edgecolor": "none"}
        write(True, 0.16, "   ·   ".join(loud), fontsize=8.5, fontweight="bold", color="white", bbox=box)
    return figure


def key(label: str, colour: str, **look: Any) -> Line2D:
    """An entry of a legend."""
    return Line2D([], [], color=colour, label=label, **look)


def dots(label: str, colour: str, marker: str = "o", **look: Any) -> Line2D:
    return key(label, colour, marker=marker, linewidth=0, **look)


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """One row of legend entries at the foot of the header."""
    width, height = figure.get_size_inches()
    figure.legend(
        handles=list(handles),
        loc="upper left",
        bbox_to_anchor=((MARGIN + 0.01) / width, 1 - 0.82 / height),
        ncols=max(len(handles), 1),
        frameon=False,
        fontsize=8.5,
        borderpad=0.1,
        borderaxespad=0.0,
        handlelength=1.8,
        columnspacing=1.8,
        labelcolor=INK,
    )


def quiet(ax: Axes, *, title: str = "", x: str = "", y: str = "") -> Axes:
    """Left and bottom spine, a faint grid behind the data, small grey ticks, labels as given."""
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color("#b4bac2")
        ax.spines[side].set_linewidth(0.8)
    ax.set_facecolor("white")
    ax.grid(True, which="major", color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(which="both", colors="#b4bac2", labelcolor=QUIET, labelsize=8, length=3, width=0.8)
    ax.set_title(title, loc="left", fontsize=9, color=INK, pad=5)
    ax.set_xlabel(x, fontsize=8.5, color=INK)
    ax.set_ylabel(y, fontsize=8.5, color=INK)
    return ax


def note(ax: Axes, text: str, *, blank: bool = False) -> None:
    """One sentence in the middle of the panel, for what cannot be drawn; blank: the panel has no scale either."""
    box = {"boxstyle": "round,pad=0.4", "facecolor": "white", "edgecolor": GRID}
    place = {"transform": ax.transAxes, "ha": "center", "va": "center"}
    ax.text(0.5, 0.5, plain(text), fontsize=9, color=VERMILLION, bbox=box, **place)
    if blank:
        ax.set(xticks=[], yticks=[])
