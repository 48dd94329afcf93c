"""Signals and their panels: an output measured and predicted, and the residual."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pgrssnn_jax.reports import style

READABLE, WINDOW = 1500, 300  # samples that one panel can show, and of a longer record


class Curve(NamedTuple):
    """A prediction `[time, y]`; name: in the legend; gid: of its artists; residual_colour: of its residual,
    empty: as the curve."""

    name: str
    gid: str
    values: np.ndarray
    colour: str
    residual_colour: str = ""
    dash: Any = "-"


class Signals(NamedTuple):
    """One sequence: time `[time]` (s), measured `[time, y]`, NaN where nothing was; outputs: `name` and `unit` of each;
    members `[member, time, y]`; half_width `[time, y]` of the band around the first curve, and its name. Without
    members, neither members nor a band are drawn."""

    outputs: Sequence[Mapping[str, Any]]
    time: np.ndarray
    measured: np.ndarray
    curves: Sequence[Curve]
    members: np.ndarray
    half_width: np.ndarray
    band: str = ""

    def cut(self, start: int, stop: int) -> "Signals":
        part = slice(start, stop)
        curves = [curve._replace(values=curve.values[part]) for curve in self.curves]
        cut = self._replace(time=self.time[part], measured=self.measured[part], curves=curves)
        return cut._replace(members=self.members[:, part], half_width=self.half_width[part])

    def label(self, k: int, name: str = "") -> str:
        return style.label(name or str(self.outputs[k]["name"]), self.outputs[k].get("unit"))

    def residual(self, k: int, curve: int) -> np.ndarray:
        """Measured minus predicted, `[time]`."""
        return self.measured[:, k] - self.curves[curve].values[:, k]

    @property
    def marker(self) -> str:
        return style.marker(len(self.time))


def finite(values: np.ndarray) -> np.ndarray:
    """In float64, NaN for what is not finite."""
    values = np.asarray(values, np.float64)
    return np.where(np.isfinite(values), values, np.nan)


def rows_of(count: int) -> int:
    """The rows of panels of so many outputs, two beside each other."""
    return -(-count // 2)


def draw_pairs(figure: Figure, signals: Signals, shown: tuple[int, int], ratios: Sequence[float]) -> list[list[Axes]]:
    """The panels of each output, one below the other: measured and predicted, residual, and an empty panel for each
    further height in `ratios`. The first two share their time axis."""
    count, cut = len(signals.outputs), signals.cut(*shown)
    columns, rows = min(count, 2), rows_of(count)
    # Every other row and column of the grid is room between the outputs.
    apart = {"width_ratios": [1.0, 0.012] * (columns - 1) + [1.0], "height_ratios": [1.0, 0.03] * (rows - 1) + [1.0]}
    grid = figure.add_gridspec(2 * rows - 1, 2 * columns - 1, **apart)
    found: list[list[Axes]] = []
    for k in range(count):
        inner = grid[k // columns * 2, k % columns * 2].subgridspec(len(ratios), 1, height_ratios=ratios, hspace=0.0)
        top = figure.add_subplot(inner[0])
        under = figure.add_subplot(inner[1], sharex=top)
        found.append([top, under, *(figure.add_subplot(inner[row]) for row in range(2, len(ratios)))])
        draw_signal(top, cut, k)
        draw_residuals(under, cut, k)
    for column in range(columns):
        figure.align_ylabels([ax for axes in found[column::columns] for ax in axes[:2]])
    return found


def extent(start: int, stop: int, time: int, sequences: int) -> str:
    """The samples shown, in words."""
    samples = f"samples {start} to {stop - 1} of {time}"
    if (start, stop) == (0, time):
        samples = "one sample" if time == 1 else f"all {time} samples"
    return samples + (f", sequence 1 of {sequences}" if sequences > 1 else "")


def draw_signal(ax: Axes, signals: Signals, k: int, *, x: str = "", title: str = "") -> None:
    """Output `k` as measured, below the predicted ones; of one that runs away only the near part shows. x: label of the
    time, empty where it stands below another panel."""
    style.quiet(ax, title=title, x=x, y=signals.label(k)).tick_params(labelbottom=bool(x))
    measured = signals.measured[:, k]
    band = _draw_members(ax, signals, k, np.zeros(len(signals.time)), 1.0)
    look: dict[str, Any] = {"linewidth": 2.6, "marker": signals.marker, "markersize": 9, "zorder": 1.9}
    ax.plot(signals.time, measured, color=style.TRUTH, label="measured", gid="measured", **look)
    for curve in signals.curves:
        look = {"color": curve.colour, "linestyle": curve.dash, "linewidth": 1.3, "marker": signals.marker}
        ax.plot(signals.time, curve.values[:, k], label=curve.name, gid=curve.gid, zorder=2.6, **look)
    curves = [curve.values[:, k] for curve in signals.curves]
    limit(ax, measured, np.concatenate([signals.members[..., k].ravel(), *band, *curves]))
    ax.margins(x=0.01)


def draw_residuals(ax: Axes, signals: Signals, k: int, *, x: str = "time (s)") -> None:
    """Measured minus predicted, one line per curve, the later ones on top."""
    style.quiet(ax, x=x, y=signals.label(k, "residual"))
    measured = signals.measured[:, k]
    _draw_members(ax, signals, k, measured, -1.0)
    ax.axhline(0.0, color=style.INK, linewidth=0.8)
    left = [(curve, signals.residual(k, i)) for i, curve in enumerate(signals.curves)]
    left = [(curve, residual) for curve, residual in left if np.isfinite(residual).any()]
    for curve, residual in left:
        name = f"residual: measured − {curve.name}" if curve.residual_colour else curve.name
        colour = curve.residual_colour or curve.colour
        look = {"color": colour, "linewidth": 1.0, "marker": signals.marker, "gid": curve.gid}
        ax.plot(signals.time, residual, label=name, **look)
    ax.margins(x=0.01)
    if not left:
        ax.set_yticks([])
        style.note(ax, "no residual to show: nothing was measured or predicted here")
        return
    span = np.ptp(measured[np.isfinite(measured)]) or 1.0
    limit(ax, np.array([-span / 2, span / 2]), np.concatenate([residual for _, residual in left]))


def _draw_members(ax: Axes, signals: Signals, k: int, base: np.ndarray, sign: float) -> list[np.ndarray]:
    """The members and the band, less `base`; returns the ends of the band."""
    members, half = signals.members[..., k], signals.half_width[:, k]
    if not len(members):
        return []
    middle = sign * (signals.curves[0].values[:, k] - base)
    look = {"color": style.SKY, "alpha": 0.30, "linewidth": 0}
    ax.fill_between(signals.time, middle - half, middle + half, label=signals.band, **look)
    faint = {"color": style.BLUE, "linewidth": 0.5, "alpha": float(np.clip(2.2 / len(members), 0.06, 0.45))}
    ax.plot(signals.time, sign * (members - base).T, label="members", **faint)
    return [middle - half, middle + half]


def limit(ax: Axes, reference: np.ndarray, others: np.ndarray) -> None:
    """Keeps the measurement readable when a prediction runs far away: the axis reaches 1.5 spans beyond it at most."""
    reference, others = reference[np.isfinite(reference)], others[np.isfinite(others)]
    if not len(reference) or not len(others):
        return
    low, high = reference.min(), reference.max()
    span = (high - low) or abs(high) or 1.0
    least, most = low - 1.5 * span, high + 1.5 * span
    if others.min() < least or others.max() > most:
        ax.set_ylim(max(others.min(), least) - 0.05 * span, min(others.max(), most) + 0.05 * span)
        box = {"boxstyle": "round,pad=0.3", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
        place = {"transform": ax.transAxes, "ha": "right", "va": "top"}
        ax.text(0.995, 0.97, "predictions leave the axis", fontsize=8, color=style.VERMILLION, bbox=box, **place)
