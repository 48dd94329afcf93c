"""Files of logs: columns of a CSV file, or arrays of an NPZ file, by the names that a configuration gives them."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.data.resample import Log
from pgrssnn_jax.records.arguments import first_line, real_numbers
from pgrssnn_jax.records.table import Table, fingerprint, numbers, read_table

Names = str | Sequence[str]


class Columns(NamedTuple):
    """time: None for samples every `step` s; position, torque, velocity (None: not measured): a pattern, whose %d
    stands for 1 to n, a list of names, or the name of an array `[time, joint]`."""

    time: str | None
    step: float | None
    position: Names
    torque: Names
    velocity: Names | None = None


def read_logs(path: str | Path, columns: Columns, n: int, key: str) -> tuple[str, list[Log]]:
    """The digest of a file, and its sequences of n joints. Raises `ValueError` with key and file."""
    if columns.time is None and not (columns.step or 0.0) > 0.0:
        raise ValueError(f"data.sample_time: expected s per sample where data.time is null, found {columns.step}")
    try:
        return (_from_npz if str(path).endswith(".npz") else _from_csv)(path, columns, n)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from None


def _from_csv(path: str | Path, columns: Columns, n: int) -> tuple[str, list[Log]]:
    table = read_table(path)

    def of(names: Names) -> np.ndarray:
        return np.stack([numbers(table, name) for name in _listed(names, n)], 1)

    position, torque = of(columns.position), of(columns.torque)
    velocity = None if columns.velocity is None else of(columns.velocity)
    time = _times(columns, len(position), lambda name: numbers(table, name))
    found = []
    for rows in _rows(table):
        found.append(Log(time[rows], position[rows], torque[rows], None if velocity is None else velocity[rows]))
    return table.digest, found


def _rows(table: Table) -> list[np.ndarray]:
    """Of each sequence, in file order."""
    labels = np.array(table.columns.get("sequence", [""] * len(table.lines)))
    return [np.flatnonzero(labels == label) for label in dict.fromkeys(labels)]


def _from_npz(path: str | Path, columns: Columns, n: int) -> tuple[str, list[Log]]:
    file = Path(path).expanduser()
    try:
        content = file.read_bytes()
        with np.load(io.BytesIO(content), allow_pickle=False) as found:
            there = {name: found[name] for name in _used(columns, found.files, n)}
    except Exception as problem:  # NumPy and zlib raise whatever a damaged file leads them to
        raise ValueError(f"{path}: expected a readable NPZ file, found {first_line(problem)}") from None
    arrays = {
        name: real_numbers(f"{path}: array {name!r}", values).astype(np.float64) for name, values in there.items()
    }

    def array(name: str) -> np.ndarray:
        if name not in arrays:
            raise ValueError(f"{path}: expected an array {name!r}, found none")
        if not np.isfinite(arrays[name]).all():
            raise ValueError(f"{path}: array {name!r}: expected finite numbers, found NaN or infinity")
        return arrays[name]

    def of(names: Names) -> np.ndarray:
        """`[sequence, time, joint]`."""
        named = [array(name) for name in _names(names, n)]
        whole = named[0] if _is_array(names) else np.stack(named, -1)
        if whole.ndim not in (2, 3) or whole.shape[-1] != n:
            raise ValueError(f"{path}: {names!r}: expected [time, {n}] or [sequence, time, {n}], found {whole.shape}")
        return whole if whole.ndim == 3 else whole[None]

    position, torque = of(columns.position), of(columns.torque)
    velocity = position if columns.velocity is None else of(columns.velocity)
    for one in (torque, velocity):
        if one.shape != position.shape:
            raise ValueError(f"{path}: expected arrays of one shape, found {position.shape} and {one.shape}")
    time = _times(columns, position.shape[1], array)
    if time.shape not in (position.shape[:2], position.shape[1:2]):
        raise ValueError(f"{path}: {columns.time!r}: expected shape {position.shape[:2]}, found {time.shape}")
    parts = zip(np.broadcast_to(time, position.shape[:2]), position, torque, velocity, strict=True)
    return fingerprint(content), [Log(t, q, u, None if columns.velocity is None else v) for t, q, u, v in parts]


def _used(columns: Columns, there: Sequence[str], n: int) -> list[str]:
    """Arrays that are asked for; others may hold anything."""
    wanted = {columns.time, *(name for names in columns[2:] if names is not None for name in _names(names, n))}
    return [name for name in there if name in wanted]


def _names(names: Names, n: int) -> list[str]:
    return [str(names)] if _is_array(names) else _listed(names, n)


def _is_array(names: Names) -> bool:
    return isinstance(names, str) and "%d" not in names


def _listed(names: Names, n: int) -> list[str]:
    """One name per joint."""
    found = [names.replace("%d", str(i + 1)) for i in range(n)] if isinstance(names, str) else [str(x) for x in names]
    if len(found) != n or len(set(found)) != n:
        raise ValueError(f"expected one column per joint, {n} (a list, or a pattern with %d), found {names!r}")
    return found


def _times(columns: Columns, samples: int, read: Callable[[str], np.ndarray]) -> np.ndarray:
    if columns.time is None:
        assert columns.step is not None
        return columns.step * np.arange(samples)
    return read(columns.time)
