"""Users' own data: CSV files whose columns are named after the inputs and outputs of the physics.

    time, pump_voltage, level_voltage           optional beside them:
    0.0,  3.25,         5.20                    sequence          rows of equal label are one sequence
    4.0,  3.24,         5.21                    mask, mask_<y>    1 = measured, 0 = not

An empty cell of an output was not measured, where no mask says 1. Sequences of unequal length are padded at their end
with their last input; the padding is masked. A bad file raises `ValueError` with one
sentence that names file, line, column, the expected and the found value.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int

from pgrssnn_jax.records.record import Channel, Record, RecordInfo, Start, record
from pgrssnn_jax.records.table import Table, column, numbers, problem, quoted_cell, read_table

_NOTHING = ("", "nan")  # how programs write an output that was not measured
_TOLERANCE = 0.01  # of dt: clocks and rounded time stamps are no better


def read_csv(
    path: str | Path, inputs: Sequence[Channel], outputs: Sequence[Channel], dt: float, *, start: Start = "unknown"
) -> Record:
    """u `[seq, time, u]` and y `[seq, time, y]` in float64, sampled every `dt` seconds.

    start: what is known of x_0. Columns that are not asked for are ignored.
    """
    table = read_table(path)
    if not table.lines:
        raise problem(path, 1, None, "samples below the header", "none")
    # Every column that is missing is found before the first bad cell.
    for channel in (*inputs, *outputs):
        column(table, channel.name)
    rows = _sequences(table)
    measured = np.stack([_measured(table, channel.name) for channel in outputs], axis=1)
    u = np.stack([numbers(table, channel.name) for channel in inputs], axis=1)
    y = np.stack([numbers(table, channel.name, measured[:, i]) for i, channel in enumerate(outputs)], axis=1)
    if "time" in table.columns:
        _check_time(table, rows, dt)
    longest = max(map(len, rows))
    index = np.stack([np.pad(r, (0, longest - len(r)), mode="edge") for r in rows])
    real = np.arange(longest) < np.array([[len(r)] for r in rows])
    origin = f"{Path(path).name}, sha256 {table.digest}…"
    info = RecordInfo(tuple(inputs), tuple(outputs), float(dt), "file", origin, padded=not real.all(), start=start)
    return record(u[index], y[index], info, measured[index] & real[..., None])


def _sequences(table: Table) -> list[Int[np.ndarray, " time"]]:
    """The rows of each sequence, in file order; sequences in the order of their first rows."""
    labels = table.columns.get("sequence", [""] * len(table.lines))
    rows: dict[str, list[int]] = {}
    for row, label in enumerate(labels):
        if not label and "sequence" in table.columns:
            raise problem(table.file, table.lines[row], "sequence", "a label", quoted_cell(label))
        rows.setdefault(label, []).append(row)
    for label, mine in rows.items():
        if len(mine) < 2:
            name, of = ("sequence", f" of sequence {quoted_cell(label)}") if label else (None, "")
            raise problem(table.file, table.lines[mine[-1]], name, f"at least 2 samples{of}", str(len(mine)))
    return [np.array(mine) for mine in rows.values()]


def _measured(table: Table, output: str) -> Bool[np.ndarray, " rows"]:
    """Where the output counts: where neither `mask` nor `mask_<output>` says 0; without both, where it has a value."""
    masks = [name for name in ("mask", f"mask_{output}") if name in table.columns]
    if not masks:
        return np.array([cell.lower() not in _NOTHING for cell in column(table, output)], bool)
    measured = np.ones(len(table.lines), bool)
    for name in masks:
        for row, cell in enumerate(table.columns[name]):
            if cell not in ("0", "1", "0.0", "1.0"):
                raise problem(table.file, table.lines[row], name, "0 or 1", quoted_cell(cell))
            measured[row] &= cell in ("1", "1.0")
    return measured


def _check_time(table: Table, rows: list[Int[np.ndarray, " time"]], dt: float) -> None:
    time = numbers(table, "time")
    # Large time stamps (seconds since 1970) cannot resolve short steps; that is not the file's fault.
    allowed = _TOLERANCE * dt + 4 * np.spacing(np.abs(time).max())
    for mine in rows:
        steps = np.diff(time[mine])
        wrong = np.flatnonzero(np.abs(steps - dt) > allowed)
        if len(wrong):
            expected = f"evenly spaced samples, {dt:g} s (the physics' dt) after the one before"
            if np.abs(steps - np.median(steps)).max() <= allowed:
                expected = f"{dt:g} s between samples (the physics' dt)"
            line = table.lines[mine[wrong[0] + 1]]
            raise problem(table.file, line, "time", expected, f"{steps[wrong[0]]:g} s")
