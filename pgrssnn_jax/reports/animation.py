"""The motion of an arm as a moving picture: inline SVG without script, for a page that may load and run nothing.

Browsers move it by SMIL: every `animate` element holds the values of one attribute at the frames, in step with the
others. There is no namespace declaration, since inside HTML an `svg` element needs none.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.reports import content, stick, style
from pgrssnn_jax.reports.content import Content, Metrics, Number
from pgrssnn_jax.reports.markup import Markup, html, tag
from pgrssnn_jax.reports.poses import BASE, Poses, Stage, floor_edge, floor_lines, project, read_poses, set_stage

WIDTH, TOP, ARM, STRIP, FOOT, MARGIN = 900.0, 96.0, 430.0, 84.0, 34.0, 24.0
FONT = "system-ui, 'Segoe UI', 'Liberation Sans', Arial, sans-serif"
SECONDS, CURVE = 10.0, 700


class _Clock(NamedTuple):
    """Seconds that one run takes, and when each frame comes, from 0 to 1."""

    seconds: Number
    key_times: str

    def animate(self, name: str, values: Sequence[str], mode: str = "") -> Markup:
        """Gives the attribute `name` of the element around it one value per frame; nothing where nothing changes."""
        if len(set(values)) < 2:
            return Markup()
        steps = {"keyTimes": self.key_times, "values": ";".join(values)}
        return tag(
            "animate", attributeName=name, dur=f"{self.seconds:.4g}s", repeatCount="indefinite", calcMode=mode, **steps
        )


def stick_animation(
    predictions: Mapping[str, np.ndarray], metrics: Metrics, *, sequence: int = 0, frames: int = 120
) -> Markup:
    """The test sequence `sequence` in at most `frames` poses over about ten seconds, again and again: an `svg` element.

    The arrays are those of `stick_figure`. Where a pose is missing its arm is not seen. Below the arm a mark runs
    along the distance between the tips.
    """
    if frames < 2:
        raise ValueError(f"stick_animation: frames: expected at least 2, found {frames}")
    poses = read_poses(predictions, sequence)
    time, n_seq = len(poses.measured), len(predictions["skeleton_measured"])
    shown, duration = stick.evenly(time, frames), metrics["dt"] * (time - 1)
    speed = _speed(duration)
    clock = _Clock(duration / speed, ";".join(_shortest(t, 4) for t in shown / max(time - 1, 1)))
    pace = "real time" if speed == 1 else f"{speed:g} times real time"
    pace = pace if time > 1 else "one sample, nothing moves"
    loud = " · SIMULATED DATA" if content.simulated(metrics) else ""
    of_which = f" · sequence {sequence + 1} of {n_seq}" if n_seq > 1 else ""
    result = stick.tip_result(poses, metrics)
    described = f"Stick figure of the arm from the side, {pace}. {result}; {content.source(metrics)}."
    return tag(
        "svg",
        tag("title", _printable(f"{content.heading(metrics)}: the arm, measured and predicted")),
        tag("desc", _printable(described)),
        _text(MARGIN, 30, f"{content.heading(metrics)}{of_which}{loud}", style.INK, 20, font_weight="700"),
        _text(MARGIN, 53, result, style.QUIET, 14),
        _legend(),
        _text(WIDTH - MARGIN, 80, pace, style.INK, 14, text_anchor="end"),
        _arm(poses, set_stage(poses), shown, clock),
        _distance(poses, metrics, shown, clock),
        viewBox=f"0 0 {WIDTH:g} {TOP + ARM + STRIP + FOOT:g}",
        role="img",
        font_family=FONT,
        stroke_linecap="round",
        stroke_linejoin="round",
    )


def _speed(duration: Number) -> float:
    """Real time if that takes 8 to 12 seconds, else the roundest multiple that does."""
    speeds = [1.0, *(float(f"{duration / SECONDS:.{digits}g}") for digits in (1, 2))]
    return next((s for s in speeds if s > 0 and 8.0 <= duration / s <= 12.0), 1.0)


def _arm(poses: Poses, stage: Stage, shown: np.ndarray, clock: _Clock) -> Markup:
    """The floor, the base, a scale, and both arms with their shadow and the whole paths of their tips."""
    span = stage.high - stage.low
    scale = min((WIDTH - 2 * MARGIN) / span[0], ARM / span[1])
    corner = (np.array([WIDTH, 2 * TOP + ARM]) - scale * span * (1, -1)) / 2

    def place(points: np.ndarray) -> np.ndarray:
        return np.clip((project(points) - stage.low) * (scale, -scale) + corner, -WIDTH, 2 * WIDTH)

    grid = "".join("M{}L{}".format(*map(_pair, place(line))) for line in floor_lines(stage))
    y = TOP + ARM - 6
    looks = ((poses.measured, style.TRUTH, 9.0), (poses.predicted, style.BLUE, 3.2))
    paths = [_curve(place(p[stick.evenly(len(p), CURVE), -1]), colour, opacity="0.4") for p, colour, _ in looks]
    return html(
        (
            tag("polygon", points=_points(place(floor_edge(stage.centre, stage.radius))), fill=stick.FLOOR),
            tag("path", d=grid, stroke="#ffffff", stroke_width="2"),
            tag("polygon", points=_points(place(floor_edge(np.zeros(2), BASE * stage.radius))), fill=style.QUIET),
            _stroke(f"M{MARGIN:g} {y:g}h{scale * stage.square:.1f}", style.INK, 3, stroke_linecap="butt"),
            _text(MARGIN, y - 8, f"{stage.square:g} m", style.INK, 14),
            *paths,
            _limbs(place(poses.measured[shown] * (1.0, 1.0, 0.0)), stick.SHADOW, 6.0, clock, joints=False),
            *(_limbs(place(points[shown]), colour, wide, clock) for points, colour, wide in looks),
        )
    )


def _limbs(places: np.ndarray, colour: str, wide: float, clock: _Clock, joints: bool = True) -> Content:
    """One arm, `[frame, point, 2]`: a line that moves, and dots on it; a missing pose holds the last one, unseen."""
    known = np.atleast_1d(np.isfinite(places).all((1, 2)))
    if not known.any():
        return ""
    held = places[np.maximum.accumulate(np.where(known, np.arange(len(known)), np.argmax(known)))]
    lines, seen = [_points(pose) for pose in held], ["1" if one else "0" for one in known]
    look = {"fill": "none", "stroke": colour}
    parts = [tag("polyline", clock.animate("points", lines), points=lines[0], stroke_width=f"{wide:g}", **look)]
    if joints:
        # A line of no length with round ends is a dot: one element moves all joints.
        dots = ["".join(f"M{_pair(point)}h0" for point in pose) for pose in held]
        parts.append(tag("path", clock.animate("d", dots), d=dots[0], stroke_width=f"{2 * wide:g}", **look))
    return tag("g", clock.animate("opacity", seen, "discrete"), *parts, opacity=seen[0])


def _distance(poses: Poses, metrics: Metrics, shown: np.ndarray, clock: _Clock) -> Markup:
    """The distance between the tips against time, and where the arm above is on it."""
    distance, time = poses.tip_distance, len(poses.measured)
    bottom, wide = TOP + ARM + STRIP, WIDTH - 2 * MARGIN
    most = float(np.max(distance, initial=0.0, where=np.isfinite(distance))) or 1.0
    drawn, last = stick.evenly(time, CURVE), max(time - 1, 1)
    curve = np.stack([MARGIN + wide * drawn / last, bottom - (STRIP - 24) * distance[drawn] / most], -1)
    known = f"distance of the tips, up to {stick.distance_text(most)}"
    label = known if np.isfinite(curve).all(-1).any() else "no prediction"
    at = [_shortest(MARGIN + wide * sample / last, 1) for sample in shown]
    ends = {"y1": f"{bottom - STRIP + 14:g}", "y2": f"{bottom:g}", "stroke": style.INK, "stroke_width": "1.4"}
    moving = clock.animate("x1", at), clock.animate("x2", at)
    return html(
        (
            tag("path", d=f"M{MARGIN:g} {bottom:g}h{wide:g}", stroke="#b4bac2"),
            _text(MARGIN, bottom + 20, "0 s", style.QUIET, 13),
            _text(
                MARGIN + wide, bottom + 20, f"{metrics['dt'] * (time - 1):.4g} s", style.QUIET, 13, text_anchor="end"
            ),
            _text(MARGIN + wide / 2, bottom + 20, label, style.VERMILLION, 13, text_anchor="middle"),
            _curve(curve, style.VERMILLION, stroke_width="1.6"),
            tag("line", *moving, x1=at[0], x2=at[0], **ends),
        )
    )


def _curve(places: np.ndarray, colour: str, **look: str) -> Content:
    """A line through places `[sample, 2]` that leaves out what is missing; a place on its own is a dot."""
    known = np.atleast_1d(np.isfinite(places).all(-1))
    runs = np.split(np.arange(len(places)), np.flatnonzero(np.diff(known.astype(int))) + 1)
    line = "".join(f"M{'L'.join(map(_pair, places[run]))}h0" for run in runs if known[run[0]])
    return tag("path", d=line, fill="none", stroke=colour, **look) if line else ""


def _legend() -> Markup:
    entries = ((0, "measured", style.TRUTH, 9), (122, "predicted", style.BLUE, 3.2))
    parts = [
        (_stroke(f"M{MARGIN + x + 4:g} 75h26", colour, wide), _text(MARGIN + x + 40, 80, name, style.INK, 14))
        for x, name, colour, wide in (*entries, (244, "measured, from above on the floor", stick.SHADOW, 6))
    ]
    return html(tuple(parts))


def _stroke(line: str, colour: str, wide: Number, **look: str) -> Markup:
    return tag("path", d=line, stroke=colour, stroke_width=f"{wide:g}", **look)


def _text(x: Number, y: Number, text: str, colour: str, size: int, **look: str) -> Markup:
    return tag("text", _printable(text), x=f"{x:g}", y=f"{y:g}", fill=colour, font_size=f"{size}", **look)


def _printable(text: str) -> str:
    """Text for XML, which knows no control characters."""
    return "".join(c if c.isprintable() else " " for c in text)


def _points(places: Iterable[np.ndarray]) -> str:
    return " ".join(map(_pair, places))


def _pair(place: np.ndarray) -> str:
    return f"{_shortest(place[0], 1)} {_shortest(place[1], 1)}"


def _shortest(value: float, decimals: int) -> str:
    """A number without the zeros that say nothing."""
    return f"{value:.{decimals}f}".rstrip("0").rstrip(".")
