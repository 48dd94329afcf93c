"""The stick figure of an arm: its pose at moments of a test sequence, measured against predicted, and the tip's error.

The arm is seen from the side that shows most of it, a little from above, without perspective: lengths across the
picture are true. The animation draws the same `Poses` on the same `Stage`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pgrssnn_jax.reports import content, style
from pgrssnn_jax.reports.content import MISSING, Metrics, Number

ELEVATION = math.radians(20.0)
FLOOR, SHADOW = "#f3f4f6", "#dcdfe3"
FOOT = 0.09
COLUMNS = 4


class Poses(NamedTuple):
    """One sequence, `[time, point, 3]` in metres from the base: to the right, away from the reader, up.

    A pose that lacks a coordinate is NaN as a whole.
    """

    measured: np.ndarray
    predicted: np.ndarray


class Stage(NamedTuple):
    """What every picture of a sequence shares: a round floor, the squares on it, and the corners in view, in metres."""

    centre: np.ndarray
    radius: float
    square: float
    low: np.ndarray
    high: np.ndarray


def stick_figure(
    predictions: Mapping[str, np.ndarray],
    metrics: Metrics,
    *,
    sequence: int = 0,
    shots: int = 8,
    up: Sequence[Number] | None = None,
) -> Figure:
    """Up to `shots` poses at evenly spaced times of test sequence `sequence`, all to one scale, and the tip's error.

    predictions: `skeleton_measured` and `skeleton_predicted` `[seq, time, point, 3]` in metres, points from the base to
    the tip; up: the direction that is up, else `skeleton_up`, else +z. Raises `ValueError` where these do not fit.
    """
    if shots < 1:
        raise ValueError(f"stick_figure: shots: expected at least 1, found {shots}")
    poses = read_poses(predictions, sequence, up)
    time, stage = len(poses.measured), set_stage(poses)
    shown = np.unique(np.linspace(0, time - 1, min(shots, time)).round().astype(int))
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    width, height = stage.high - stage.low
    cell = float(np.clip(10.6 / columns * height / width, 1.2, 3.4))

    n_seq = len(predictions["skeleton_measured"])
    of_which = f"sequence {sequence + 1} of {n_seq} · " if n_seq > 1 else ""
    lines = [f"{tip_result(poses, metrics)} · n_init {metrics['n_init']}", f"{of_which}{content.source(metrics)}"]
    figure = style.page(11.0, rows * (cell + 0.3) + 1.9, metrics, lines)
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[*[cell + 0.3] * rows, 1.9])
    for k, sample in enumerate(shown):
        ax = figure.add_subplot(grid[k // columns, k % columns])
        _draw_shot(ax, poses, stage, int(sample), f"{k + 1} · {metrics['dt'] * sample:.4g} s")
    _draw_scale(figure.axes[0], stage)
    _draw_distance(figure.add_subplot(grid[rows, :]), poses, metrics, shown)
    style.legend(figure, _handles())
    return figure


def read_poses(predictions: Mapping[str, np.ndarray], sequence: int, up: Sequence[Number] | None = None) -> Poses:
    """The poses of one sequence, turned so that the vertical plane in which the arm mostly lies faces the reader."""
    measured, predicted = predictions["skeleton_measured"], predictions["skeleton_predicted"]
    if measured.ndim != 4 or measured.shape[3] != 3 or 0 in measured.shape:
        expected = "expected [sequence, time, point, 3], none of them empty"
        raise ValueError(f"read_poses: skeleton_measured: {expected}, found {measured.shape}")
    if predicted.shape != measured.shape:
        raise ValueError(f"read_poses: skeleton_predicted: expected {measured.shape}, found {predicted.shape}")
    if not 0 <= sequence < len(measured):
        raise ValueError(f"read_poses: sequence: expected 0 to {len(measured) - 1}, found {sequence}")
    vertical = np.asarray(predictions.get("skeleton_up", (0.0, 0.0, 1.0)) if up is None else up, np.float64)
    length = np.linalg.norm(vertical) if vertical.shape == (3,) else math.nan
    if not (np.isfinite(length) and length > 0):
        raise ValueError(f"read_poses: up: expected three numbers that are not all zero, found {vertical.tolist()}")

    both = np.stack([measured[sequence], predicted[sequence]]).astype(np.float64)
    both = np.where(np.isfinite(both).all((2, 3), keepdims=True), both, np.nan)
    known = next((points[np.isfinite(points[:, 0, 0])] for points in both if np.isfinite(points).any()), both[0, :0])
    if not len(known):
        return Poses(*both)
    vertical /= length
    helper = np.eye(3)[np.argmin(np.abs(vertical))]
    first = np.cross(helper, vertical) / np.linalg.norm(np.cross(helper, vertical))
    horizontal = np.stack([first, np.cross(vertical, first)])
    across = (known - known[0, 0]).reshape(-1, 3) @ horizontal.T
    main = np.linalg.eigh(across.T @ across)[1][:, -1]
    right = (main if across.mean(0) @ main >= 0 else -main) @ horizontal
    axes = np.stack([right, np.cross(vertical, right), vertical])
    return Poses(*((both - known[0, 0]) @ axes.T))


def project(points: np.ndarray) -> np.ndarray:
    """Where points `[..., 3]` of `Poses` lie in the picture `[..., 2]`."""
    lifted = points[..., 2] * math.cos(ELEVATION) + points[..., 1] * math.sin(ELEVATION)
    return np.stack([points[..., 0], lifted], -1)


def set_stage(poses: Poses) -> Stage:
    """A floor below all places of the measured arm; a prediction that runs away is not followed further than twice."""
    both = np.concatenate([points[np.isfinite(points)].reshape(-1, 3) for points in poses])
    trusted = poses.measured[np.isfinite(poses.measured)].reshape(-1, 3)
    trusted = np.concatenate([np.zeros((1, 3)), trusted if len(trusted) else both])
    reach = float(np.linalg.norm(trusted, axis=-1).max()) or 1.0
    corners = np.stack([trusted[:, :2].min(0), trusted[:, :2].max(0)])
    centre = corners.mean(0)
    radius = max((1 + FOOT) * float(np.linalg.norm(trusted[:, :2] - centre, axis=-1).max()), 0.3 * reach)
    power = 10.0 ** math.floor(math.log10(radius))
    square = max(size * power for size in (0.2, 0.5, 1.0, 2.0, 5.0) if size * power <= 0.6 * radius)
    seen = project(np.concatenate([np.clip(both, -2 * reach, 2 * reach), floor_edge(centre, radius)]))
    pad = 0.02 * np.ptp(seen, axis=0).max()
    return Stage(centre, radius, square, seen.min(0) - pad, seen.max(0) + pad)


def floor_edge(centre: np.ndarray, radius: float) -> np.ndarray:
    """A circle on the floor, `[corner, 3]`."""
    angle = np.linspace(0.0, 2 * np.pi, 73)
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.stack([x, y, np.zeros_like(x)], -1)


def floor_lines(stage: Stage) -> np.ndarray:
    """The sides of the squares on the floor, `[line, end, 3]`, from edge to edge; the base is one of their corners.

    They stand aslant to the reader, or they would look like a flat grid.
    """
    lines = []
    for turn in (math.radians(32.0), math.radians(122.0)):
        along, aside = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
        middle = float(stage.centre @ aside)
        first, last = (middle + sign * stage.radius for sign in (-1, 1))
        for k in range(math.ceil(first / stage.square), math.floor(last / stage.square) + 1):
            off = k * stage.square - middle
            half = math.sqrt(max(stage.radius**2 - off**2, 0.0))
            lines.append([stage.centre + off * aside + sign * half * along for sign in (-1, 1)])
    return np.pad(np.array(lines), ((0, 0), (0, 0), (0, 1)))


def tip_distance(poses: Poses) -> np.ndarray:
    """Metres between the measured and the predicted tip at every sample; NaN where one is missing."""
    return np.linalg.norm(poses.measured[:, -1] - poses.predicted[:, -1], axis=-1)


def tip_result(poses: Poses, metrics: Metrics) -> str:
    """The tip's error over the samples that count, in one phrase."""
    distance = tip_distance(poses)
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
    off = float(tip_distance(poses)[sample])
    title += f" · tip {distance_text(off)} off" if math.isfinite(off) else " · no prediction"
    ax.set_title(title, loc="left", fontsize=9, color=style.INK, pad=3)
    ax.set_axis_off()
    ax.set_aspect("equal")
    ax.set_xlim(stage.low[0], stage.high[0])
    ax.set_ylim(stage.low[1], stage.high[1])
    ax.fill(*project(floor_edge(stage.centre, stage.radius)).T, color=FLOOR, linewidth=0)
    for line in floor_lines(stage):
        ax.plot(*project(line).T, color="white", linewidth=1.0, zorder=1.1)
    ax.fill(*project(floor_edge(np.zeros(2), FOOT * stage.radius)).T, color=style.QUIET, linewidth=0, zorder=1.2)

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
    distance, dt = tip_distance(poses), metrics["dt"]
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
        Line2D([], [], color=style.TRUTH, linewidth=4.6, marker="o", markersize=6.4, label="measured"),
        Line2D([], [], color=style.BLUE, linewidth=1.6, marker="o", markersize=3.2, label="predicted"),
        Line2D([], [], color=style.VERMILLION, linewidth=1.4, label="distance of the tips"),
        Line2D([], [], color=style.QUIET, linewidth=0.7, label="path of the tip so far"),
        Line2D([], [], color=SHADOW, linewidth=2.6, label="measured arm from above, on the floor"),
    ]
