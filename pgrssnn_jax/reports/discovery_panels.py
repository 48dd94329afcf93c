"""The panels of the discovery figures and the signals in them: the estimated correction, and a map of it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from pgrssnn_jax.reports import style
from pgrssnn_jax.reports.content import Number
from pgrssnn_jax.reports.discovery_facts import STAGES, Discovery
from pgrssnn_jax.reports.panels import READABLE, WINDOW, Curve, Signals, finite

COLOURS = {"before": style.VERMILLION, "recalibrated": style.YELLOW, "after": style.BLUE}
UNVISITED = "#c3c9d0"
FEWEST_VISITS = 8

Arrays = Mapping[str, np.ndarray]


def record(discovery: Discovery, arrays: Arrays, part: str, stages: Iterable[str]) -> tuple[Signals | None, int]:
    """The first sequence of the record `part` (train or test), NaN where nothing was measured, with a curve for each of
    these stages of the physics; and how many sequences there are. None where there is no such record."""
    y = np.asarray(arrays.get(f"y_{part}", np.zeros((0, 0, 0))))
    if not y.size:
        return None, 0
    nothing = np.full(y.shape, np.nan)
    curves = [
        Curve(f"{s}: {STAGES[s]}", s, finite(arrays.get(f"y_{s}_{part}", nothing)[0]), COLOURS[s]) for s in stages
    ]
    measured = finite(np.where(arrays.get(f"mask_{part}", True), y, np.nan))[0]
    time = np.asarray(arrays[f"time_{part}"], np.float64)
    return Signals(discovery.get("outputs") or (), time, measured, curves, nothing[:0], nothing[0]), len(y)


def window(signals: Signals) -> tuple[int, int]:
    """The samples to show: all of a readable record, else those around the largest residual of the first curve."""
    time = len(signals.time)
    if time <= READABLE:
        return 0, time
    span = np.ptp(np.nan_to_num(signals.measured), axis=0)
    errors = np.nan_to_num(np.abs(signals.measured - signals.curves[0].values)) / np.where(span, span, 1.0)
    start = int(np.clip(int(np.argmax(errors.max(1))) - WINDOW // 2, 0, time - WINDOW))
    return start, start + WINDOW


def worst(discovery: Discovery, arrays: Arrays) -> tuple[int | None, list[Sequence[Number]]]:
    """The state equation with the largest share of the error among those with a correction; and when it is wrong."""
    rows: list[Mapping[str, Any]] = list(discovery.get("disagreement") or ())
    rows.sort(key=lambda row: -(row.get("share_of_error") or 0.0))
    names = [str(state["name"]) for state in discovery.get("states") or ()]
    correction = np.asarray(arrays.get("correction", np.zeros((0, 1, 1))), np.float64)[:, 0]
    size = {k: np.nanmean(values**2) for k, values in enumerate(correction) if np.isfinite(values).any()}
    listed = (names.index(row["equation"]) for row in rows if row["equation"] in names)
    state = next((k for k in listed if k in size), max(size, key=size.__getitem__, default=None))
    own = [row for row in rows if state is not None and row["equation"] == names[state]] or rows[:1]
    return state, [span for row in own if row.get("sequence", 1) == 1 for span in row.get("intervals_s") or ()]


def rate(unit: str) -> str:
    """The unit of a change per second of what has this unit."""
    return f"{unit}²" if unit.endswith("/s") else f"{unit or '1'}/s"


def shade(ax: Axes, intervals: Sequence[Sequence[Number]]) -> None:
    """Spans of time behind the data."""
    spans = [(start, stop - start) for start, stop in intervals]
    if spans:
        look: dict[str, Any] = {"facecolor": style.YELLOW, "alpha": 0.22, "linewidth": 0, "zorder": 0.6}
        look |= {"label": "where most of the error arises", "gid": "interval"}
        ax.broken_barh(spans, (0.0, 1.0), transform=ax.get_xaxis_transform(), **look)


def draw_correction(ax: Axes, t: np.ndarray, mean: np.ndarray, std: np.ndarray, state: Mapping[str, Any]) -> None:
    """What is missing in the equation of one state, with a band of two std, which may leave the axis."""
    title = f"missing in the equation of {state['name']}: estimated correction ± 2 std"
    label = style.label("correction", rate(str(state.get("unit") or "")))
    style.quiet(ax, title=style.plain(title), x="time (s)", y=label)
    band = 2 * np.where(np.isfinite(std), std, 0.0)
    ax.fill_between(t, mean - band, mean + band, color=style.GREEN, alpha=0.22, linewidth=0)
    look: dict[str, Any] = {"color": style.GREEN, "linewidth": 1.3, "gid": "correction", "label": "correction ± 2 std"}
    ax.plot(t, mean, marker=style.marker(len(t)), **look)
    ax.axhline(0.0, color=style.INK, linewidth=0.8)
    finite = np.isfinite(mean)
    reach = float(np.median(band[finite]))
    low, high = min(mean[finite].min(), 0.0) - 1.6 * reach, max(mean[finite].max(), 0.0) + 1.6 * reach
    room = 0.06 * (high - low) or 1.0
    ax.set_ylim(low - room, high + room)
    ax.margins(x=0.01)


def draw_map(
    ax: Axes, arrays: Arrays, values: np.ndarray, *, diverging: bool, labels: tuple[str, str], title: str
) -> QuadMesh:
    """One value per cell of two signals; grey where the data came too seldom. Zero is amid diverging colours."""
    style.quiet(ax, title=title, x=labels[0], y=labels[1]).grid(False)
    hidden = np.ma.masked_invalid(np.where(seen(arrays), values, np.nan))
    shown = np.abs(hidden.compressed())
    top = float(np.percentile(shown, 98 if len(shown) > 50 else 100)) if len(shown) else 1.0
    colours = colormaps["RdBu_r" if diverging else "viridis"].with_extremes(bad=UNVISITED)
    norm = Normalize(-(top or 1.0) if diverging else 0.0, top or 1.0)
    edges = (np.asarray(arrays[name], np.float64) for name in ("map_x_edges", "map_u_edges"))
    mesh = ax.pcolormesh(*edges, hidden.T, cmap=colours, norm=norm, edgecolors="white", linewidth=0.3)
    if not len(shown):
        style.note(ax, f"no cell was visited {FEWEST_VISITS} times")
    return mesh


def seen(arrays: Arrays) -> np.ndarray:
    """The cells of the map `[a, b]` with enough visits and a value."""
    return (arrays["map_count"] >= FEWEST_VISITS) & np.isfinite(arrays["map_mean"])


def draw_certain(ax: Axes, arrays: Arrays) -> None:
    """A dot in every cell whose value is more than two standard errors from zero."""
    mean, error = np.asarray(arrays["map_mean"], np.float64), np.asarray(arrays["map_std_error"], np.float64)
    a, b = np.nonzero(seen(arrays) & (np.abs(mean) > 2 * np.where(np.isfinite(error), error, np.inf)))
    middle = [(e[:-1] + e[1:]) / 2 for e in (arrays["map_x_edges"], arrays["map_u_edges"])]
    look: dict[str, Any] = {"color": style.INK, "markersize": 3, "markeredgecolor": "white", "markeredgewidth": 0.5}
    ax.plot(middle[0][a], middle[1][b], "o", label="2 standard errors or more from 0", gid="certain", **look)


def draw_region(ax: Axes, arrays: Arrays, region: Mapping[str, Sequence[Number | None]]) -> None:
    """The outline of a region that names one or both signals of the map; an open bound ends at the edge of the map."""
    names = [str(arrays[name]) for name in ("map_a", "map_b")]
    if not region or set(region) - set(names):
        return
    spans = []
    for name, edges in zip(names, (arrays["map_x_edges"], arrays["map_u_edges"]), strict=True):
        ends = edges[[0, -1]].astype(float)
        bounds = np.array(region.get(name) or (None, None), float)
        spans.append(np.where(np.isfinite(bounds), np.clip(bounds, *ends), ends))
    (left, right), (bottom, top) = spans
    look: dict[str, Any] = {"fill": False, "edgecolor": style.INK, "linewidth": 1.8, "label": "region of disagreement"}
    ax.add_patch(Rectangle((left, bottom), right - left, top - bottom, gid="region", clip_on=False, zorder=4, **look))
