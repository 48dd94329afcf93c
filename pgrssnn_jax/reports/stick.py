"""The stick figure of an arm: its pose at moments of a test sequence, measured against predicted, and the tip's error.

The animation draws the same `Poses` on the same `Stage`.
"""

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import MISSING, Metrics
from pgrssnn_jax.reports.poses import BASE, Poses, Stage, floor_edge, floor_lines, project, read_poses, set_stage

FLOOR, SHADOW = "#f3f4f6", "#dcdfe3"
COLUMNS = 4


def stick_figure(
    predictions: Mapping[str, np.ndarray], metrics: Metrics, *, sequence: int = 0, shots: int = 8
) -> Figure:
    """Up to `shots` poses at evenly spaced times of test sequence `sequence`, all to one scale, and the tip's error.

    predictions: `skeleton_measured` and `skeleton_predicted` `[seq, time, point, 3]` in metres, points from the base to
    the tip, z up. Raises `ValueError` where these do not fit.
    """
    if shots < 1:
        raise ValueError(f"stick_figure: shots: expected at least 1, found {shots}")
    poses = read_poses(predictions, sequence)
    time, stage = len(poses.measured), set_stage(poses)
    shown = evenly(time, shots)
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    width, height = stage.high - stage.low
    cell = float(np.clip(10.6 / columns * height / width, 1.2, 3.4))

    n_seq = len(predictions["skeleton_measured"])
    of_which = f"sequence {sequence + 1} of {n_seq} · " if n_seq > 1 else ""
    lines = [f"{tip_result(poses, metrics)} · n_init {metrics['n_init']}", f"{of_which}{content.source(metrics)}"]
    figure = style.page(rows * (cell + 0.3) + 1.9, metrics, lines)
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[*[cell + 0.3] * rows, 1.9])
    for k, sample in enumerate(shown):
        ax = figure.add_subplot(grid[k // columns, k % columns])
        _draw_shot(ax, poses, stage, int(sample), f"{k + 1} · {metrics['dt'] * sample:.4g} s")
    _draw_scale(figure.axes[0], stage)
    _draw_distance(figure.add_subplot(grid[rows, :]), poses, metrics, shown)
    style.legend(figure, _handles())
    return figure


def evenly(time: int, most: int) -> np.ndarray:
    """At most so many samples, from the first to the last."""
    return np.unique(np.linspace(0, time - 1, min(most, time)).round().astype(int))


def tip_result(poses: Poses, metrics: Metrics) -> str:
    """The tip's error over the samples that count, in one phrase."""
    distance = poses.tip_distance
    counted = np.where(np.arange(len(distance)) >= metrics["n_init"], distance, np.nan)
    known = counted[np.isfinite(counted)]
    if not len(known):
        return "tip of the arm: no prediction to compare with the measurement"
    middle, root, worst = float(np.median(known)), float(np.sqrt(np.mean(known**2))), float(known.max())
    when = metrics["dt"] * int(np.nanargmax(counted))
    samples = "1 sample" if len(known) == 1 else f"{len(known)} samples"
    found = f"median {distance_text(middle)}, RMS {distance_text(root)}, most {distance_text(worst)} at {when:.4g} s"
    return f"tip of the arm, measured to predicted: {found} · {samples}"


def distance_text(metres: float) -> str:
    """Three digits, in millimetres below one metre."""
    if not math.isfinite(metres):
        return MISSING
    return f"{1000 * metres:.3g} mm" if metres < 0.9995 else f"{metres:.3g} m"


def _draw_shot(ax: Axes, poses: Poses, stage: Stage, sample: int, title: str) -> None:
    off = float(poses.tip_distance[sample])
    title += f" · tip {distance_text(off)} off" if math.isfinite(off) else " · no prediction"
    ax.set_title(title, loc="left", fontsize=9, color=style.INK, pad=3)
    ax.set_axis_off()
    ax.set_aspect("equal")
    ax.set_xlim(stage.low[0], stage.high[0])
    ax.set_ylim(stage.low[1], stage.high[1])
    ax.fill(*project(floor_edge(stage.centre, stage.radius)).T, color=FLOOR, linewidth=0)
    for line in floor_lines(stage):
        ax.plot(*project(line).T, color="white", linewidth=1.0, zorder=1.1)
    ax.fill(*project(floor_edge(np.zeros(2), BASE * stage.radius)).T, color=style.QUIET, linewidth=0, zorder=1.2)

    measured, predicted = poses
    on_floor = {"color": SHADOW, "linewidth": 2.6, "solid_capstyle": "round", "solid_joinstyle": "round"}
    ax.plot(*project(measured[sample] * (1.0, 1.0, 0.0)).T, gid="shadow", **on_floor)
    for points, colour in ((measured, style.TRUTH), (predicted, style.BLUE)):
        ax.plot(*project(points[: sample + 1, -1]).T, color=colour, linewidth=0.6, alpha=0.45, gid="path")
    looks = ((measured, "measured", style.TRUTH, 4.6, 6.4), (predicted, "predicted", style.BLUE, 1.6, 3.2))
    for points, name, colour, wide, dot in looks:
        look = {"linewidth": wide, "markersize": dot, "solid_capstyle": "round", "solid_joinstyle": "round"}
        ax.plot(*project(points[sample]).T, color=colour, marker="o", markeredgewidth=0, gid=name, **look)
    apart = project(np.stack([measured[sample, -1], predicted[sample, -1]]))
    ax.plot(*apart.T, color=style.VERMILLION, linewidth=1.4, solid_capstyle="round", gid="apart")


def _draw_scale(ax: Axes, stage: Stage) -> None:
    """The side of a square as a bar; it holds for all panels."""
    x, y = stage.low
    ax.plot([x, x + stage.square], [y, y], color=style.INK, linewidth=2.0, solid_capstyle="butt", clip_on=False)
    text = f"{stage.square:g} m"
    ax.annotate(text, (x, y), (0, 3), textcoords="offset points", fontsize=8, color=style.INK, va="bottom")


def _draw_distance(ax: Axes, poses: Poses, metrics: Metrics, shown: np.ndarray) -> None:
    distance, dt = poses.tip_distance, metrics["dt"]
    style.quiet(ax, x="time (s)", y=style.label("tip, measured\nto predicted", "m"))
    marker = "." if len(distance) <= 60 else ""
    ax.plot(dt * np.arange(len(distance)), distance, color=style.VERMILLION, linewidth=1.1, marker=marker)
    for k, sample in enumerate(shown, 1):
        ax.axvline(dt * sample, color=style.QUIET, linewidth=0.8, alpha=0.6, zorder=1.5)
        place = {"textcoords": "offset points", "xycoords": ax.get_xaxis_transform(), "ha": "center"}
        ax.annotate(str(k), (dt * sample, 1.0), (0, 2), fontsize=8.5, color=style.INK, **place)
    ax.plot(dt * shown, distance[shown], "o", color=style.VERMILLION, markersize=4.5, zorder=3, gid="shots")
    if metrics["n_init"]:
        ax.axvspan(0.0, dt * min(metrics["n_init"], len(distance)), color=style.QUIET, alpha=0.12, linewidth=0)
    ax.margins(x=0.01)
    if np.isfinite(distance).any():
        ax.set_ylim(0.0, 1.1 * float(np.nanmax(distance)) or 1.0)
    else:
        ax.set_yticks([])
        style.note(ax, "no prediction to compare with the measurement")


def _handles() -> list[Artist]:
    return [
        style.key("measured", style.TRUTH, linewidth=4.6, marker="o", markersize=6.4),
        style.key("predicted", style.BLUE, linewidth=1.6, marker="o", markersize=3.2),
        style.key("distance of the tips", style.VERMILLION, linewidth=1.4),
        style.key("path of the tip so far", style.QUIET, linewidth=0.7),
        style.key("measured arm from above, on the floor", SHADOW, linewidth=2.6),
    ]
