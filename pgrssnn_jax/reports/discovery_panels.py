"""The panels of the discovery figures and the signals in them: residuals, the estimated correction, a map of it."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from pgrssnn_jax.reports import style
from pgrssnn_jax.reports.content import Number
from pgrssnn_jax.reports.discovery_summary import Discovery, real
from pgrssnn_jax.reports.panels import limit
from pgrssnn_jax.reports.prediction import READABLE, WINDOW

COLOURS = {"before": style.VERMILLION, "recalibrated": style.YELLOW, "after": style.BLUE}
UNVISITED = "#c3c9d0"
FEWEST_VISITS = 8
_THINNED_BINS = 1500

Arrays = Mapping[str, np.ndarray]


class Output(NamedTuple):
    """One output over the time of one sequence, NaN where there is nothing; simulated: by stage of the physics."""

    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    simulated: Mapping[str, np.ndarray]

    def residual(self, stage: str) -> np.ndarray:
        return self.measured - self.simulated[stage]


def output(arrays: Arrays, channel: Mapping[str, Any], part: str, sequence: int, k: int) -> Output:
    """Output k of the record `part` (train or test); a stage that is not in the arrays is NaN throughout."""
    shape = arrays[f"y_{part}"].shape[:2]

    def signal(name: str) -> np.ndarray:
        found = arrays.get(f"{name}_{part}")
        column = np.full(shape[1], np.nan) if found is None else np.asarray(found[sequence, :, k], np.float64)
        return np.where(np.isfinite(column), column, np.nan)

    mask = arrays.get(f"mask_{part}")
    measured = signal("y") if mask is None else np.where(mask[sequence, :, k].astype(bool), signal("y"), np.nan)
    simulated = {stage: signal(f"y_{stage}") for stage in COLOURS}
    time = np.asarray(arrays[f"time_{part}"], np.float64)
    return Output(str(channel["name"]), str(channel.get("unit") or ""), time, measured, simulated)


def output_signals(discovery: Discovery, arrays: Arrays, part: str, sequence: int) -> list[Output]:
    """Every output of one sequence; none where the record is empty."""
    if not np.size(arrays.get(f"y_{part}", ())):
        return []
    channels = enumerate(discovery.get("outputs") or ())
    return [output(arrays, channel, part, sequence, k) for k, channel in channels]


def window(signals: Sequence[Output]) -> tuple[int, int]:
    """The samples to show: all of a readable record, else those around the largest residual before."""
    time = len(signals[0].time)
    if time <= READABLE:
        return 0, time
    errors = [np.nan_to_num(np.abs(signal.residual("before"))) for signal in signals]
    spans = [np.ptp(np.nan_to_num(signal.measured)) or 1.0 for signal in signals]
    middle = int(np.argmax(np.max([error / span for error, span in zip(errors, spans, strict=True)], axis=0)))
    start = int(np.clip(middle - WINDOW // 2, 0, time - WINDOW))
    return start, start + WINDOW


def cut(signal: Output, start: int, stop: int) -> Output:
    simulated = {stage: values[start:stop] for stage, values in signal.simulated.items()}
    return signal._replace(time=signal.time[start:stop], measured=signal.measured[start:stop], simulated=simulated)


def worst(discovery: Discovery, arrays: Arrays, sequence: int) -> tuple[int | None, list[Sequence[Number]]]:
    """The state equation with the largest share of the error among those with a correction; and when it is wrong."""
    rows: list[Mapping[str, Any]] = list(discovery.get("disagreement") or ())
    rows.sort(key=lambda row: -np.nan_to_num(real(row.get("share_of_error"))))
    names = [str(state["name"]) for state in discovery.get("states") or ()]
    correction = np.asarray(arrays.get("correction", np.full((len(names), sequence + 1, 1), np.nan)), np.float64)
    kept = {k: correction[k, sequence][np.isfinite(correction[k, sequence])] for k in range(len(names))}
    size = {k: float(np.sqrt(np.mean(values**2))) for k, values in kept.items() if len(values)}
    listed = (names.index(row["equation"]) for row in rows if row.get("equation") in names)
    state = next((k for k in listed if k in size), max(size, key=size.__getitem__, default=None))
    own = [row for row in rows if state is not None and row.get("equation") == names[state]] or rows[:1]
    drawn = [row for row in own if row.get("sequence", 1) == sequence + 1]
    return state, [span for row in drawn for span in row.get("intervals_s") or ()]


def rate(unit: str) -> str:
    """The unit of a change per second of what has this unit."""
    return f"{unit}²" if unit.endswith("/s") else f"{unit or '1'}/s"


def units(discovery: Discovery) -> dict[str, str]:
    signals = [signal for kind in ("inputs", "outputs", "states") for signal in discovery.get(kind) or ()]
    return {str(signal["name"]): str(signal.get("unit") or "") for signal in signals}


def thinned(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A long signal as the least and the greatest value of each of 1500 bins, in order; a short one whole."""
    if len(values) <= 2 * _THINNED_BINS:
        return t, values
    edges = np.linspace(0, len(values), _THINNED_BINS + 1).astype(int)
    picked = []
    for start, stop in pairwise(edges):
        part = values[start:stop]
        found = {int(np.nanargmin(part)), int(np.nanargmax(part))} if np.isfinite(part).any() else {0}
        picked += [start + place for place in sorted(found)]
    return t[picked], values[picked]


def shade(ax: Axes, intervals: Sequence[Sequence[Number]]) -> None:
    """Spans of time behind the data."""
    spans = [(start, stop - start) for start, stop in intervals]
    if spans:
        look = {"facecolor": style.YELLOW, "alpha": 0.22, "linewidth": 0, "zorder": 0.6}
        ax.broken_barh(spans, (0.0, 1.0), transform=ax.get_xaxis_transform(), gid="interval", **look)


def blank(ax: Axes, text: str) -> None:
    """A panel with a sentence and no scale."""
    ax.set_xticks([])
    ax.set_yticks([])
    style.note(ax, text)


def draw_signal(ax: Axes, signal: Output, stages: Sequence[str]) -> None:
    """The measured output below the simulated ones; of one that runs away only the near part shows."""
    style.quiet(ax, y=style.label(signal.name, signal.unit)).tick_params(labelbottom=False)
    marker = "." if len(signal.time) <= 60 else ""
    look = {"color": style.TRUTH, "linewidth": 2.8, "marker": marker, "markersize": 9, "gid": "measured"}
    ax.plot(signal.time, signal.measured, **look)
    for stage in stages:
        look = {"color": COLOURS[stage], "linewidth": 1.3, "marker": marker, "gid": stage}
        ax.plot(signal.time, signal.simulated[stage], **look)
    limit(ax, signal.measured, np.concatenate([signal.simulated[stage] for stage in stages]))


def draw_residuals(ax: Axes, signal: Output, stages: Sequence[str], *, x: str = "time (s)") -> None:
    """Measured minus simulated, one line per stage, the later ones on top."""
    style.quiet(ax, x=x, y=style.label("residual", signal.unit))
    ax.axhline(0.0, color=style.INK, linewidth=0.8)
    drawn = [stage for stage in stages if np.isfinite(signal.residual(stage)).any()]
    marker = "." if len(signal.time) <= 60 else ""
    for stage in drawn:
        t, values = thinned(signal.time, signal.residual(stage))
        ax.plot(t, values, color=COLOURS[stage], linewidth=1.0, marker=marker, gid=stage)
    ax.margins(x=0.01)
    if not drawn:
        blank(ax, "no residual to show: nothing was measured or simulated here")
        return
    span = np.ptp(signal.measured[np.isfinite(signal.measured)]) or 1.0
    limit(ax, np.array([-span / 2, span / 2]), np.concatenate([signal.residual(stage) for stage in drawn]))


def draw_correction(ax: Axes, t: np.ndarray, mean: np.ndarray, std: np.ndarray, name: str, unit: str) -> None:
    """What the equation of one state lacks, with a band of two standard deviations; the band may leave the axis."""
    title = f"what the equation of {name} lacks: estimated correction ± 2 std"
    style.quiet(ax, title=style.plain(title), x="time (s)", y=style.label("correction", unit))
    band = 2 * np.where(np.isfinite(std), std, 0.0)
    (places, middle), (_, low), (_, high) = (thinned(t, mean), thinned(t, mean - band), thinned(t, mean + band))
    if len(low) == len(high) == len(middle) == len(t):
        ax.fill_between(t, low, high, color=style.GREEN, alpha=0.22, linewidth=0)
    else:
        for edge in (mean - band, mean + band):
            ax.plot(*thinned(t, edge), color=style.GREEN, linewidth=0.6, alpha=0.4)
    ax.plot(places, middle, color=style.GREEN, linewidth=1.3, marker="." if len(t) <= 60 else "", gid="correction")
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
    style.quiet(ax, title=title, x=labels[0], y=labels[1])
    ax.grid(False)
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
    look = {"color": style.INK, "markersize": 3, "markeredgecolor": "white", "markeredgewidth": 0.5, "gid": "certain"}
    ax.plot(middle[0][a], middle[1][b], "o", **look)


def draw_region(ax: Axes, arrays: Arrays, region: Mapping[str, Sequence[Number | None]]) -> None:
    """The outline of a region that names one or both signals of the map; an open bound ends at the edge of the map."""
    names = [str(arrays[name]) for name in ("map_a", "map_b")]
    if not set(names) & set(region) or set(region) - set(names):
        return
    corners = []
    for name, edges in zip(names, (arrays["map_x_edges"], arrays["map_u_edges"]), strict=True):
        low, high = (real(bound) for bound in region.get(name) or (None, None))
        ends = float(edges[0]), float(edges[-1])
        corners.append(
            [float(np.clip(v, *ends)) if np.isfinite(v) else end for v, end in zip((low, high), ends, strict=True)]
        )
    (left, right), (bottom, top) = corners
    box = Rectangle((left, bottom), right - left, top - bottom, fill=False, edgecolor=style.INK, linewidth=1.8)
    box.set(gid="region", clip_on=False, zorder=4)
    ax.add_patch(box)
