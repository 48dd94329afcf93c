"""The figures of a discovery: where physics and measurement disagree, what is missing, and what it brought.

Each function takes `discovery.json` and the arrays of `discovery.npz` and returns a `matplotlib.figure.Figure`; a
missing piece becomes a sentence in its panel. The captions of the page say what to look at.
"""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pgrssnn_jax.reports import content, panels, style
from pgrssnn_jax.reports import discovery_facts as facts
from pgrssnn_jax.reports import discovery_panels as found
from pgrssnn_jax.reports.discovery_facts import STAGES, Discovery, real
from pgrssnn_jax.reports.discovery_panels import COLOURS, Arrays

NOT_CHOSEN = "#b9c3cd"
SHOWN_BARS, SHOWN_SHIFTS = 24, 16


def discovery_figures(discovery: Discovery, arrays: Arrays) -> dict[str, Figure]:
    """All figures by title, in the order of the page."""
    where = {"Simulation": simulation_figure, "Disagreement": disagreement_figure, "Map": map_figure}
    if facts.by_torques(discovery):
        where = {"Torques": simulation_figure, "Joints": joints_figure}
    made = {**where, "Candidates": candidates_figure, "Shifts": shifts_figure}
    return {title: make(discovery, arrays) for title, make in made.items()}


def simulation_figure(discovery: Discovery, arrays: Arrays) -> Figure:
    """Measured and simulated by the nominal physics and with the missing effects, and the residuals, on test data.

    Of more than 1500 samples a window of 300 is shown, around the largest residual of the nominal physics.
    """
    signals, sequences = found.record(discovery, arrays, "test", ("before", "after"))
    if signals is None:
        return _empty(discovery, "test")
    shown, n_y = found.window(signals), len(signals.outputs)
    body = panels.rows_of(n_y) * (4.6 if n_y == 1 else 3.4)
    figure = _page(discovery, body, f"test record, {panels.extent(*shown, len(signals.time), sequences)}")
    panels.draw_pairs(figure, signals, shown, [3.0, 1.3])
    style.legend(figure)
    return figure


def disagreement_figure(discovery: Discovery, arrays: Arrays) -> Figure:
    """Residuals on training data at every stage, and the correction that the worst equation needs."""
    signals, sequences = found.record(discovery, arrays, "train", COLOURS)
    if signals is None:
        return _empty(discovery, "training")
    n_y, time = len(signals.outputs), len(signals.time)
    columns, rows = min(n_y, 2), panels.rows_of(n_y)
    extent = f"training record, {panels.extent(0, time, time, sequences)}"
    figure = _page(discovery, rows * (2.5 if columns == 1 else 1.9) + 2.4, extent)
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=[1.0] * rows + [1.0 if columns == 1 else 1.3])
    state, intervals = found.worst(discovery, arrays)
    for k, output in enumerate(signals.outputs):
        ax = figure.add_subplot(grid[k // columns, k % columns])
        panels.draw_residuals(ax, signals, k, x="" if columns == 1 else "time (s)")
        if n_y > 1:
            ax.set_title(style.plain(str(output["name"])), loc="left", fontsize=9, color=style.INK, pad=5)
    ax = figure.add_subplot(grid[rows, :])
    if state is None:
        style.quiet(ax, x="time (s)", y="correction (unit/s)")
        style.note(ax, "no correction could be estimated from these data", blank=True)
    else:
        correction = arrays["correction"]
        mean, std = (a[state, 0] for a in (correction, arrays.get("correction_std", np.nan * correction)))
        found.draw_correction(ax, signals.time[: len(mean)], mean, std, discovery["states"][state])
    for ax in figure.axes:
        found.shade(ax, intervals)
    style.legend(figure)
    return figure


def map_figure(discovery: Discovery, arrays: Arrays) -> Figure:
    """The correction over two signals, and its standard error beside it; the regions of disagreement are outlined."""
    names = [str(arrays[name]) if name in arrays else "" for name in ("map_equation", "map_a", "map_b")]
    figure = _page(discovery, 4.2, f"training record, equation of {names[0]}" if names[0] else "training record")
    left, right = figure.subplots(1, 2)
    if arrays.get("map_mean") is None or not np.size(arrays["map_mean"]):
        for ax in (left, right):
            style.note(style.quiet(ax, x="state", y="input"), "no map could be made from these data", blank=True)
        return figure
    signals = [signal for kind in ("inputs", "outputs", "states") for signal in discovery.get(kind) or ()]
    units = {str(signal["name"]): str(signal.get("unit") or "") for signal in signals}
    x, y = (style.label(n, units[n]) if n in units else style.plain(n) for n in names[1:])
    unit = found.rate(units.get(names[0], ""))
    for ax, name, title in ((left, "map_mean", "correction"), (right, "map_std_error", "standard error")):
        values = np.asarray(arrays[name], np.float64)
        mesh = found.draw_map(ax, arrays, values, diverging=ax is left, labels=(x, y), title=title)
        bar = figure.colorbar(mesh, ax=ax, pad=0.02)
        bar.set_label(style.label(title, unit), fontsize=8.5, color=style.INK)
        bar.ax.tick_params(colors=style.FAINT, labelcolor=style.QUIET, labelsize=8, length=3)
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    found.draw_certain(left, arrays)
    for row in discovery.get("disagreement") or ():
        if row.get("equation") == names[0]:
            found.draw_region(left, arrays, row.get("region") or {})
    style.legend(figure, Patch(facecolor=found.UNVISITED, label=f"fewer than {found.FEWEST_VISITS} visits"))
    return figure


def candidates_figure(discovery: Discovery, arrays: Arrays) -> Figure:
    """Candidate effects by the error energy they take away in cross-validation, best first; chosen ones are blue."""
    ranked = [row for row in discovery.get("ranking") or () if np.isfinite(real(row.get("gain")))]
    ranked = sorted(ranked, key=lambda row: row["gain"], reverse=True)
    shown = [row for k, row in enumerate(ranked) if k < SHOWN_BARS or row.get("chosen")]
    null, gains = discovery.get("null") or {}, [100 * real(row["gain"]) for row in shown]
    threshold, draws = 100 * real(null.get("threshold")), 100 * np.ravel(arrays.get("null_law", np.array([])))
    draws = draws[np.isfinite(draws)]
    left_out = f", {len(ranked) - len(shown)} weaker ones left out" if len(ranked) > len(shown) else ""
    figure = _page(discovery, max(1.6, 0.24 * (len(shown) + 1) + 0.7), f"{len(shown)} candidates{left_out}")
    ax = style.quiet(figure.add_subplot(), x="error energy taken away in cross-validation (%)")
    style.rows(ax, [str(row["name"]) for row in shown] + ["nothing missing"] * bool(len(draws)))
    behind = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    beside: dict[str, Any] = {"xytext": (5, 0), "textcoords": "offset points", "va": "center", "fontsize": 8}
    for k, (row, gain) in enumerate(zip(shown, gains, strict=True)):
        chosen, p = bool(row.get("chosen")), row.get("p_value")
        colour, ink = (style.BLUE, style.INK) if chosen else (NOT_CHOSEN, style.QUIET)
        ax.barh(k, gain, height=0.68, color=colour, gid="chosen" if chosen else "candidate")
        text = f"{gain:.1f} %".replace("-", "−") + (f" · p = {p:.2g}" if p is not None else "")
        ax.annotate(text, (max(gain, 0.0), k), color=ink, zorder=3, bbox=behind, **beside)
    if np.isfinite(threshold):
        origin = f" of {null['draws']} draws with nothing missing" if null.get("draws") else ""
        look: dict[str, Any] = {"color": style.VERMILLION, "linestyle": style.DASHED, "linewidth": 1.4}
        ax.axvline(threshold, gid="threshold", label=f"threshold{origin}: {threshold:.1f} %", **look)
    ax.axvline(0.0, color=style.INK, linewidth=0.8)
    look = {"color": style.VERMILLION, "markersize": 7, "alpha": 0.35, "gid": "null"}
    ax.plot(draws, np.full(len(draws), len(shown)), "|", **look)
    best = float(np.nanmax([1.0, threshold, *gains]))
    ax.set_xlim(max(min([0.0, *gains]), -best / 4) * 1.05, 1.16 * best)
    if not shown:
        style.note(ax, "no candidate effect was tried", blank=True)
    style.legend(figure, Patch(color=style.BLUE, label="chosen"), Patch(color=NOT_CHOSEN, label="not chosen"))
    return figure


def joints_figure(discovery: Discovery, arrays: Arrays) -> Figure:
    """Torque errors by joint, moving and at rest, at every stage."""
    del arrays
    rows = discovery.get("joints") or ()
    figure = _page(discovery, max(1.8, 0.5 * len(rows) + 0.7), f"test record, {len(rows)} joints")
    axes = figure.subplots(1, 2, sharey=True)
    for ax, regime, words in zip(axes, ("moving", "at_rest"), ("while it moves", "at rest"), strict=True):
        style.quiet(ax, x=f"torque error {words} / std of the torque")
        style.rows(ax, [f"joint {row['joint']}" for row in rows])
        for k, (stage, colour) in enumerate(COLOURS.items()):
            values = np.nan_to_num([real((row.get(regime) or {}).get(stage)) for row in rows])
            places = np.arange(len(rows)) + 0.26 * (k - 1)
            ax.barh(places, values, height=0.24, color=colour, gid=stage, label=STAGES[stage])
    style.legend(figure)
    return figure


def shifts_figure(discovery: Discovery, arrays: Arrays) -> Figure:
    """Relative shift of every number of the physics, refitted on its own and with the missing effects, and its std."""
    del arrays
    rows = facts.shifts(discovery)
    movable = [row for row in rows if np.isfinite(row.size)]
    shown = movable[:SHOWN_SHIFTS]
    line = f"{len(shown)} of {len(rows)} numbers" + (", largest shifts" if len(movable) > len(shown) else "")
    line += ", those that began at zero or are new only in the table" if len(rows) > len(movable) else ""
    figure = _page(discovery, max(1.6, 0.34 * len(shown) + 0.7), line)
    ax = style.quiet(figure.add_subplot(), x="shift from the nominal value (%)")
    style.rows(ax, [row.name for row in shown])
    ax.grid(True, axis="y")
    ax.axvline(0.0, color=style.INK, linewidth=0.8)
    reach = 100 * max((row.size for row in shown), default=0.0)
    words = {"recalibrated": "refitted on its own", "after": "with the missing effects"}
    ends = [0.0]
    for k, row in enumerate(shown):
        stages = (("recalibrated", row.recalibrated, row.recalibrated_std), ("after", row.final, row.final_std))
        for (stage, value, std), aside in zip(stages, (-0.14, 0.14), strict=True):
            shift, error = 100 * row.relative(value), float(np.nan_to_num(100 * std / abs(row.before)))
            if np.isfinite(shift):
                look: dict[str, Any] = {"color": COLOURS[stage], "markersize": 5, "elinewidth": 1.3, "capsize": 2.5}
                ax.errorbar(shift, k + aside, xerr=error or None, fmt="o", gid=stage, label=words[stage], **look)
                ends += [shift - min(error, reach), shift + min(error, reach)]
    room = 0.04 * (max(ends) - min(ends)) or 1.0
    ax.set_xlim(min(ends) - room, max(ends) + room)
    if not shown:
        style.note(ax, "no number of the physics was refitted", blank=True)
    style.legend(figure)
    return figure


def _page(discovery: Discovery, body: float, line: str) -> Figure:
    metrics = facts.as_metrics(discovery)
    return style.page(body, metrics, [facts.gap_line(discovery), f"{line} · {content.source(metrics)}"])


def _empty(discovery: Discovery, part: str) -> Figure:
    figure = _page(discovery, 1.6, f"{part} record")
    style.note(style.quiet(figure.add_subplot(), x="time (s)"), f"there is no {part} record", blank=True)
    return figure
