"""The motion of an arm as a moving picture: inline SVG without script, for a page that may load and run nothing.

Browsers move it by SMIL: every `animate` element holds the values of one attribute at the frames, in step with the
others. There is no namespace declaration, since inside HTML an `svg` element needs none.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.reports import content, stick, style
from pgrssnn_jax.reports.content import Metrics, Number
from pgrssnn_jax.reports.poses import (
    BASE,
    Poses,
    Stage,
    floor_edge,
    floor_lines,
    project,
    read_poses,
    set_stage,
    tip_distance,
)

WIDTH, TOP, ARM, STRIP, FOOT, MARGIN = 900.0, 96.0, 430.0, 84.0, 34.0, 24.0
FONT = "system-ui, 'Segoe UI', 'Liberation Sans', Arial, sans-serif"
MIDDLE, END = 'text-anchor="middle"', 'text-anchor="end"'
SECONDS, CURVE = 10.0, 700


class _Clock(NamedTuple):
    """Seconds that one run takes, how many times real time that is, and when each frame comes, from 0 to 1."""

    seconds: float
    speed: float
    key_times: str

    def animate(self, name: str, values: Sequence[str], calc_mode: str = "linear") -> str:
        """Gives the attribute `name` of the element around it one value per frame; nothing where nothing changes."""
        if len(set(values)) < 2:
            return ""
        how = "" if calc_mode == "linear" else f' calcMode="{calc_mode}"'
        return (
            f'<animate attributeName="{name}" dur="{self.seconds:.4g}s" repeatCount="indefinite"{how}'
            f' keyTimes="{self.key_times}" values="{";".join(values)}"/>'
        )


def stick_animation(
    predictions: Mapping[str, np.ndarray],
    metrics: Metrics,
    *,
    sequence: int = 0,
    frames: int = 120,
) -> str:
    """The test sequence `sequence` in at most `frames` poses over about ten seconds, again and again: an `svg` element.

    The arrays are those of `stick_figure`. Where a pose is missing its arm is not seen. Below the arm a mark runs
    along the distance between the tips.
    """
    if frames < 2:
        raise ValueError(f"stick_animation: frames: expected at least 2, found {frames}")
    poses = read_poses(predictions, sequence)
    stage, time = set_stage(poses), len(poses.measured)
    shown = _evenly(time, frames)
    clock = _clock(metrics["dt"] * (time - 1), shown / max(time - 1, 1))
    height = TOP + ARM + STRIP + FOOT
    n_seq = len(predictions["skeleton_measured"])
    of_which = f" · sequence {sequence + 1} of {n_seq}" if n_seq > 1 else ""
    speed = speed_text(clock.speed) if time > 1 else "one sample, nothing moves"
    loud = " · SIMULATED DATA" if content.simulated(metrics) else ""
    title = f"{content.heading(metrics)}: the arm, measured and predicted"
    result = stick.tip_result(poses, metrics)
    heading = f"{content.heading(metrics)}{of_which}{loud}"
    described = f"Stick figure of the arm from the side, {speed}. {result}; {content.source(metrics)}."
    parts = [
        _text(MARGIN, 30, heading, style.INK, 20, 'font-weight="700"'),
        _text(MARGIN, 53, result, style.QUIET, 14),
        _legend(),
        _text(WIDTH - MARGIN, 80, speed, style.INK, 14, END),
        _arm(poses, stage, shown, clock),
        _distance(poses, metrics, shown, clock),
    ]
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {height:g}" role="img" font-family="{FONT}" stroke-linecap="round"'
        f' stroke-linejoin="round"><title>{_escaped(title)}</title><desc>{_escaped(described)}</desc>\n'
        f"{''.join(parts)}</svg>"
    )


def speed_text(speed: float) -> str:
    return "real time" if speed == 1 else f"{speed:g} times real time"


def _clock(duration: Number, when: np.ndarray) -> _Clock:
    """Real time if that takes 8 to 12 seconds, else the roundest multiple that does."""
    speeds = [1.0] + [float(f"{duration / SECONDS:.{digits}g}") for digits in (1, 2)]
    speed = next((s for s in speeds if s > 0 and 8.0 <= duration / s <= 12.0), 1.0)
    return _Clock(duration / speed, speed, ";".join(_shortest(t, 4) for t in when))


def _arm(poses: Poses, stage: Stage, shown: np.ndarray, clock: _Clock) -> str:
    """The floor, the base, a scale, and both arms with their shadow and the whole paths of their tips."""
    scale = min((WIDTH - 2 * MARGIN) / (stage.high - stage.low)[0], ARM / (stage.high - stage.low)[1])
    corner = (np.array([WIDTH, 2 * TOP + ARM]) - scale * (stage.high - stage.low) * (1, -1)) / 2

    def place(points: np.ndarray) -> np.ndarray:
        return np.clip((project(points) - stage.low) * (scale, -scale) + corner, -WIDTH, 2 * WIDTH)

    found = f'<polygon points="{_points(place(floor_edge(stage.centre, stage.radius)))}" fill="{stick.FLOOR}"/>\n'
    grid = "".join("M{}L{}".format(*map(_pair, place(line))) for line in floor_lines(stage))
    found += f'<path d="{grid}" stroke="#ffffff" stroke-width="2"/>\n'
    foot = _points(place(floor_edge(np.zeros(2), BASE * stage.radius)))
    found += f'<polygon points="{foot}" fill="{style.QUIET}"/>\n'
    x, y, bar = MARGIN, TOP + ARM - 6, scale * stage.square
    found += f'<path d="M{x:g} {y:g}h{bar:.1f}" stroke="{style.INK}" stroke-width="3" stroke-linecap="butt"/>\n'
    found += _text(x, y - 8, f"{stage.square:g} m", style.INK, 14)
    arms = ((poses.measured, style.TRUTH, 9.0), (poses.predicted, style.BLUE, 3.2))
    for points, colour, _ in arms:
        found += _curve(place(points[_evenly(len(points), CURVE), -1]), f'stroke="{colour}" opacity="0.4"')
    found += _limbs(place(poses.measured[shown] * (1.0, 1.0, 0.0)), stick.SHADOW, 6.0, clock, joints=False)
    return found + "".join(_limbs(place(points[shown]), colour, wide, clock) for points, colour, wide in arms)


def _limbs(places: np.ndarray, colour: str, wide: float, clock: _Clock, joints: bool = True) -> str:
    """One arm, `[frame, point, 2]`: a line that moves, and dots on it; a missing pose holds the last one, unseen."""
    known = np.atleast_1d(np.isfinite(places).all((1, 2)))
    if not known.any():
        return ""
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), np.argmax(known)))
    held = places[last]
    lines = [_points(pose) for pose in held]
    seen = ["1" if one else "0" for one in known]
    look = f'fill="none" stroke="{colour}"'
    found = f'<g opacity="{seen[0]}">{clock.animate("opacity", seen, "discrete")}'
    found += f'<polyline points="{lines[0]}" {look} stroke-width="{wide:g}">{clock.animate("points", lines)}</polyline>'
    if joints:
        # A line of no length with round ends is a dot: one element moves all joints.
        dots = ["".join(f"M{_pair(point)}h0" for point in pose) for pose in held]
        found += f'<path d="{dots[0]}" {look} stroke-width="{2 * wide:g}">{clock.animate("d", dots)}</path>'
    return f"{found}</g>\n"


def _distance(poses: Poses, metrics: Metrics, shown: np.ndarray, clock: _Clock) -> str:
    """The distance between the tips against time, and where the arm above is on it."""
    distance, time = tip_distance(poses), len(poses.measured)
    left, bottom, wide = MARGIN, TOP + ARM + STRIP, WIDTH - 2 * MARGIN
    most = float(np.max(distance, initial=0.0, where=np.isfinite(distance))) or 1.0
    drawn = _evenly(time, CURVE)
    height = (STRIP - 24) * distance[drawn] / most
    curve = np.stack([left + wide * drawn / max(time - 1, 1), bottom - height], -1)
    end = f"{metrics['dt'] * (time - 1):.4g} s"
    found = f'<path d="M{left:g} {bottom:g}h{wide:g}" stroke="#b4bac2"/>\n'
    found += _text(left, bottom + 20, "0 s", style.QUIET, 13)
    found += _text(left + wide, bottom + 20, end, style.QUIET, 13, END)
    label = f"distance of the tips, up to {stick.distance_text(most)}" if np.isfinite(height).any() else "no prediction"
    found += _text(left + wide / 2, bottom + 20, label, style.VERMILLION, 13, MIDDLE)
    found += _curve(curve, f'stroke="{style.VERMILLION}" stroke-width="1.6"')
    at = [_shortest(left + wide * sample / max(time - 1, 1), 1) for sample in shown]
    moving = clock.animate("x1", at) + clock.animate("x2", at)
    look = f'stroke="{style.INK}" stroke-width="1.4"'
    high = bottom - STRIP + 14
    return f'{found}<line x1="{at[0]}" x2="{at[0]}" y1="{high:g}" y2="{bottom:g}" {look}>{moving}</line>\n'


def _curve(places: np.ndarray, look: str) -> str:
    """A line through places `[sample, 2]` that leaves out what is missing; a place on its own is a dot."""
    known = np.atleast_1d(np.isfinite(places).all(-1))
    runs = np.split(np.arange(len(places)), np.flatnonzero(np.diff(known.astype(int))) + 1)
    line = "".join(f"M{'L'.join(map(_pair, places[run]))}h0" for run in runs if known[run[0]])
    return f'<path d="{line}" fill="none" {look}/>\n' if line else ""


def _evenly(time: int, most: int) -> np.ndarray:
    """At most so many samples, from the first to the last."""
    return np.unique(np.linspace(0, time - 1, min(most, time)).round().astype(int))


def _legend() -> str:
    entries = ((0, "measured", style.TRUTH, 9), (122, "predicted", style.BLUE, 3.2))
    found = ""
    for x, name, colour, wide in (*entries, (244, "measured, from above on the floor", stick.SHADOW, 6)):
        found += f'<path d="M{MARGIN + x + 4:g} 75h26" stroke="{colour}" stroke-width="{wide}"/>'
        found += _text(MARGIN + x + 40, 80, name, style.INK, 14)
    return found


def _text(x: Number, y: Number, text: str, colour: str, size: int, more: str = "") -> str:
    more = f" {more}" if more else ""
    return f'<text x="{x:g}" y="{y:g}" fill="{colour}" font-size="{size}"{more}>{_escaped(text)}</text>\n'


def _escaped(text: str) -> str:
    """Text for XML, which knows no control characters."""
    return escape("".join(c if c.isprintable() else " " for c in text))


def _points(places: np.ndarray) -> str:
    return " ".join(_pair(place) for place in places)


def _pair(place: np.ndarray) -> str:
    return f"{_shortest(place[0], 1)} {_shortest(place[1], 1)}"


def _shortest(value: float, decimals: int) -> str:
    """A number without the zeros that say nothing."""
    if not math.isfinite(value):
        raise ValueError(f"stick_animation: expected a finite number, found {value}")
    return f"{value:.{decimals}f}".rstrip("0").rstrip(".")
