"""The stick figure of an arm, measured against predicted: at moments of the first test sequence, and in motion.

The motion is inline SVG without script, for a page that may load and run nothing: a picture of what stands still, and
lines above it whose `animate` elements (SMIL) hold the values of one attribute at the frames.
"""

import io
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import Metrics
from pgrssnn_jax.reports.poses import Poses, Stage, circle, floor_lines, project, read_poses, set_stage
from pgrssnn_jax.reports.prediction import shade_uncounted
from pgrssnn_jax.reports.rendering import rendered

FLOOR, SHADOW = "#f3f4f6", "#dcdfe3"
SHOTS, COLUMNS = 8, 4
FRAMES, SECONDS = 120, 10.0
LOOKS = {"measured": (style.TRUTH, 4.6, 6.4), "predicted": (style.BLUE, 1.6, 3.2)}  # colour, line, joints
ROUND: dict[str, Any] = {"solid_capstyle": "round", "solid_joinstyle": "round"}
ON_FLOOR = (1.0, 1.0, 0.0)


def stick_figure(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> Figure:
    """Up to 8 poses at evenly spaced times, all to one scale, and the tip's error. `predictions`: as `read_poses`."""
    poses = read_poses(predictions)
    stage, shown = set_stage(poses), _evenly(len(poses.measured), SHOTS)
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    width, height = stage.high - stage.low
    cell = float(np.clip(10.6 / columns * height / width, 1.2, 3.4)) + 0.3
    figure = style.page(rows * cell + 1.9, metrics, _lines(poses, predictions, metrics))
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[*[cell] * rows, 1.9])
    for k, sample in enumerate(shown):
        ax = figure.add_subplot(grid[k // columns, k % columns])
        off = float(poses.tip_distance[sample])
        title = f"tip {distance_text(off)} off" if math.isfinite(off) else "no prediction"
        title = f"{k + 1} · {metrics['dt'] * sample:.4g} s · {title}"
        ax.set_title(title, loc="left", fontsize=9, color=style.INK, pad=3)
        _draw_stage(ax, stage)
        _draw_arms(ax, poses, int(sample))
    _draw_scale(figure.axes[0], stage)
    ax = figure.add_subplot(grid[rows, :])
    _draw_distance(ax, poses, metrics)
    for k, sample in enumerate(shown, 1):
        ax.axvline(metrics["dt"] * sample, color=style.QUIET, linewidth=0.8, alpha=0.6, zorder=1.5)
        place = {"textcoords": "offset points", "xycoords": ax.get_xaxis_transform(), "ha": "center"}
        ax.annotate(str(k), (metrics["dt"] * sample, 1.0), (0, 2), fontsize=8.5, color=style.INK, **place)
    times, distances = metrics["dt"] * shown, poses.tip_distance[shown]
    ax.plot(times, distances, "o", color=style.VERMILLION, markersize=4.5, zorder=3, gid="shots")
    style.legend(figure, *_keys())
    return figure


def stick_animation(predictions: Mapping[str, np.ndarray], metrics: Metrics) -> str:
    """The sequence over about ten seconds, again and again: an `svg` element. `predictions`: as `read_poses`.

    Where a pose is missing its arm is not seen. A mark runs along the distance between the tips.
    """
    poses = read_poses(predictions)
    time, stage = len(poses.measured), set_stage(poses)
    seconds = metrics["dt"] * (time - 1)
    speed = float(f"{seconds / SECONDS:.1g}") or 1.0
    pace = "real time" if speed == 1 else f"{speed:g} times real time"
    result, source = _lines(poses, predictions, metrics)
    figure = style.page(5.4, metrics, [result, f"{pace} · {source}"])
    arm, curve = figure.subplots(2, 1, height_ratios=[4.0, 1.0])
    _draw_stage(arm, stage)
    _draw_scale(arm, stage)
    for name, points in poses._asdict().items():
        arm.plot(*project(points[:, -1]).T, color=LOOKS[name][0], linewidth=0.8, alpha=0.4)
    _draw_distance(curve, poses, metrics)
    style.legend(figure, *_keys())
    picture = io.BytesIO()
    figure.savefig(picture, dpi=figure.dpi)
    width, height = figure.get_size_inches() * figure.dpi
    shown = _evenly(time, FRAMES)

    def places(ax: Axes, points: np.ndarray) -> np.ndarray:
        """Data `[frame, point, 2]` in pixels of the picture, downwards; what runs away stays near its edge."""
        pixels = ax.transData.transform(points.reshape(-1, 2)).reshape(points.shape)
        return np.clip(np.array([0.0, height]) + pixels * (1, -1), -width, 2 * width)

    arms = [("measured", SHADOW, 2.6, 0.0, ON_FLOOR), *((name, *look, 1.0) for name, look in LOOKS.items())]
    lines = [(places(arm, project(getattr(poses, name)[shown] * lift)), *look) for name, *look, lift in arms]
    now = np.stack(np.broadcast_arrays(metrics["dt"] * shown[:, None], curve.get_ylim()), -1)
    lines.append((places(curve, now), style.INK, 1.0, 0.0))
    return rendered(
        "stick.svg.j2",
        title=f"{content.heading(metrics)}: the arm, measured and predicted",
        description=f"Stick figure of the arm from the side, {pace}. {result}; {source}.",
        picture=picture.getvalue(),
        width=f"{width:g}",
        height=f"{height:g}",
        seconds=f"{seconds / speed:.4g}",
        lines=[
            {"colour": colour, "wide": f"{figure.dpi / 72 * wide:.3g}", "dot": f"{figure.dpi / 72 * dot:.3g}", **moving}
            for points, colour, wide, dot in lines
            if (moving := _moving(points))
        ],
    )


def _moving(places: np.ndarray) -> dict[str, list[str]]:
    """A line `[frame, point, 2]` and the dots on it, at every frame; a missing pose holds the last one, unseen. Empty
    where none is known."""
    known = np.atleast_1d(np.isfinite(places).all((1, 2)))
    if not known.any():
        return {}
    held = places[np.maximum.accumulate(np.where(known, np.arange(len(known)), np.argmax(known)))].round(1).tolist()
    return {
        "seen": ["1" if one else "0" for one in known],
        "points": [" ".join(f"{x:g},{y:g}" for x, y in pose) for pose in held],
        # A line of no length with round ends is a dot: one element moves all joints.
        "dots": ["".join(f"M{x:g} {y:g}h0" for x, y in pose) for pose in held],
    }


def _lines(poses: Poses, predictions: Mapping[str, np.ndarray], metrics: Metrics) -> tuple[str, str]:
    """The tip's error over the samples that count, and where the poses are from."""
    counted = poses.tip_distance.copy()
    counted[: metrics["n_init"]] = np.nan
    known = counted[np.isfinite(counted)]
    result = "tip of the arm: no prediction to compare with the measurement"
    if len(known):
        middle, root, worst = np.median(known), np.sqrt(np.mean(known**2)), known.max()
        found = f"median {distance_text(middle)}, RMS {distance_text(root)}, most {distance_text(worst)}"
        when = f"{metrics['dt'] * int(np.nanargmax(counted)):.4g} s"
        samples = "1 sample" if len(known) == 1 else f"{len(known)} samples"
        result = f"tip of the arm, measured to predicted: {found} at {when} · {samples}"
    sequences = len(predictions["skeleton_measured"])
    of_which = f"sequence 1 of {sequences} · " if sequences > 1 else ""
    return f"{result} · n_init {metrics['n_init']}", f"{of_which}{content.source(metrics)}"


def _evenly(time: int, most: int) -> np.ndarray:
    """At most so many samples, from the first to the last."""
    return np.unique(np.linspace(0, time - 1, min(most, time)).round().astype(int))


def distance_text(metres: float) -> str:
    """Three digits, in millimetres below one metre."""
    return f"{1000 * metres:.3g} mm" if metres < 0.9995 else f"{metres:.3g} m"


def _draw_stage(ax: Axes, stage: Stage) -> None:
    ax.set_axis_off()
    ax.set_aspect("equal")
    ax.set_xlim(stage.low[0], stage.high[0])
    ax.set_ylim(stage.low[1], stage.high[1])
    ax.fill(*project(circle(stage.radius)).T, color=FLOOR, linewidth=0)
    ax.plot(*project(floor_lines(stage)).transpose(2, 1, 0), color="white", linewidth=1.0, zorder=1.1)
    ax.fill(*project(circle(0.09 * stage.radius)).T, color=style.QUIET, linewidth=0, zorder=1.2)


def _draw_arms(ax: Axes, poses: Poses, sample: int) -> None:
    """Both arms with the paths of their tips so far, the measured one from above on the floor, and how far they are
    apart."""
    ax.plot(*project(poses.measured[sample] * ON_FLOOR).T, color=SHADOW, linewidth=2.6, gid="shadow", **ROUND)
    for name, points in poses._asdict().items():
        ax.plot(*project(points[: sample + 1, -1]).T, color=LOOKS[name][0], linewidth=0.6, alpha=0.45, gid="path")
    for name, points in poses._asdict().items():
        colour, wide, dot = LOOKS[name]
        look = {"linewidth": wide, "marker": "o", "markersize": dot, "markeredgewidth": 0, **ROUND}
        ax.plot(*project(points[sample]).T, color=colour, gid=name, **look)
    apart = project(np.stack([points[sample, -1] for points in poses]))
    ax.plot(*apart.T, color=style.VERMILLION, linewidth=1.4, gid="apart", **ROUND)


def _draw_scale(ax: Axes, stage: Stage) -> None:
    """The side of a square as a bar; it holds for all panels."""
    x, y = stage.low
    ax.plot([x, x + stage.square], [y, y], color=style.INK, linewidth=2.0, solid_capstyle="butt", clip_on=False)
    text = f"{stage.square:g} m"
    ax.annotate(text, (x, y), (0, 3), textcoords="offset points", fontsize=8, color=style.INK, va="bottom")


def _draw_distance(ax: Axes, poses: Poses, metrics: Metrics) -> None:
    distance, dt = poses.tip_distance, metrics["dt"]
    style.quiet(ax, x="time (s)", y=style.label("tip, measured\nto predicted", "m"))
    marker = style.marker(len(distance))
    ax.plot(dt * np.arange(len(distance)), distance, color=style.VERMILLION, linewidth=1.1, marker=marker)
    shade_uncounted(ax, metrics, len(distance))
    ax.margins(x=0.01)
    if np.isfinite(distance).any():
        ax.set_ylim(0.0, 1.1 * float(np.nanmax(distance)) or 1.0)
    else:
        style.note(ax, "no prediction to compare with the measurement", blank=True)


def _keys() -> list[Artist]:
    """What the colours mean; of the animation nothing that moves is drawn yet."""
    others = {
        "distance of the tips": (style.VERMILLION, 1.4, 0.0),
        "path of the tip": (style.QUIET, 0.7, 0.0),
        "measured arm from above, on the floor": (SHADOW, 2.6, 0.0),
    }
    return [
        Line2D([], [], label=name, color=colour, linewidth=wide, marker="o" if dot else "", markersize=dot)
        for name, (colour, wide, dot) in {**LOOKS, **others}.items()
    ]
