"""Where data comes from: the folder named by the environment variable PGRSSNN_DATA, a download, or a simulator."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

from pgrssnn_jax.physics.base import Signal
from pgrssnn_jax.records.arguments import check_count
from pgrssnn_jax.records.record import Channel

VARIABLE = "PGRSSNN_DATA"
Found = TypeVar("Found")


def say_nothing(line: str) -> None:
    """The `notify` of a caller who wants no lines."""


def check_generated(generated: bool, seed: int, path: str | Path | None, what: str) -> None:
    """Raises `ValueError` for data that are to be generated and read at once, and for a bad seed."""
    if generated and path is not None:
        raise ValueError(f"data.generated: expected false where data.path names {what}, found true")
    check_count("data.seed", seed, 0, 2**63 - 1, "as a seed")


def data_folder() -> Path | None:
    """The folder in PGRSSNN_DATA; None when it is unset or empty.

    Raises `ValueError` when it names something that is no folder: a typing error must not end in simulated data.
    """
    named = os.environ.get(VARIABLE)
    if not named:
        return None
    folder = Path(named).expanduser()
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing there"
        raise ValueError(f"{VARIABLE}: expected the folder that holds the data, found {found}: {named}")
    return folder


def measured_data(
    path: str | Path | None,
    file: str,
    read: Callable[[str | Path], Found],
    download: Callable[[], Found],
    simulate: Callable[[], Found],
    notify: Callable[[str], None],
    *,
    simulated: str,
) -> Found:
    """Measured data from `path`, else from `file` under PGRSSNN_DATA, else from a download, else simulated; simulated:
    by what, for the user, who is told of each source that was passed over."""
    if path is None and (folder := data_folder()) is not None:
        if (folder / file).exists():
            path = folder / file
        else:
            notify(f"data: {VARIABLE}: no {file} in that folder, trying a download instead")
    if path is not None:
        return read(path)
    try:
        return download()
    except ConnectionError as reason:
        found = simulate()
        notify(
            f"data: NO MEASURED DATA, USING A SIMULATED {simulated}: the download failed ({reason}); "
            f"for measured data set data.path=FILE{Path(file).suffix} or {VARIABLE}"
        )
        return found


def published_folder(name: str, path: str | Path | None, seed: int, notify: Callable[[str], None]) -> Path | None:
    """The folder of published realisations: `path`, else `name` under PGRSSNN_DATA, else None with a line to the user
    that they are generated from `seed`. Raises `ValueError` when `path` is no folder."""
    if path is not None:
        folder = Path(path).expanduser()
        if not folder.is_dir():
            raise ValueError(f"data.path: expected the folder of the published files, found no folder: {path}")
        return folder
    root = data_folder()
    if root is not None and (root / name).is_dir():
        return root / name
    reason = f"{VARIABLE} is not set" if root is None else f"no folder {name} under {VARIABLE}"
    notify(f"data: NO PUBLISHED DATA, GENERATING THE REALISATIONS (seed {seed}): {reason}")
    return None


def channels(signals: Iterable[Signal]) -> tuple[Channel, ...]:
    """The columns of a record that belong to these inputs or outputs of a physics."""
    return tuple(Channel(signal.name, signal.unit) for signal in signals)
