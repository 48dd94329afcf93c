"""Where data comes from: the folder named by the environment variable PGRSSNN_DATA, and what a loader says of it."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from pgrssnn_jax.physics.base import Signal
from pgrssnn_jax.records.record import Channel

VARIABLE = "PGRSSNN_DATA"


def say_nothing(line: str) -> None:
    """The `notify` of a caller who wants no lines."""


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
