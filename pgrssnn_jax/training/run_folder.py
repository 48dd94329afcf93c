"""The run folder: what a finished, interrupted or failed run leaves behind.

    config.yaml  environment.json  history.csv  metrics.json  predictions.npz  checkpoint/  figures/*.png
    report.html  DONE           a job of a sweep that failed: FAILED, and traceback.txt where the cause is unknown

Every file is written under a temporary name, brought to the disk and renamed; `DONE` is written last, so a folder
without it holds a run that has not finished.
"""

import io
import json
import math
import os
import platform
import shutil
import subprocess
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pgrssnn_jax.records.arguments import first_line

_GROUPS = ("physics", "data", "model", "fit", "members")  # of every configuration of training
_RESULTS = (
    "DONE", "FAILED", "traceback.txt", "metrics.json", "predictions.npz", "intervals.npz", "history.csv", "report.html",
    "discovery.json", "discovery.npz",
)  # fmt: skip
_PACKAGES = ("jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "hydra-core", "numpy", "scipy", "pin")


class RunFolder:
    """Paths and atomic writers of one run; nothing is created before the first write."""

    def __init__(self, path: Path) -> None:
        """Raises `ValueError` where a file stands in the place of the folder, or of one above it."""
        if file := next((one for one in (path, *path.parents) if one.is_file()), None):
            raise ValueError(f"run folder: expected a folder at {str(path)!r}, found the file {str(file)!r}")
        self.path, self.checkpoint, self.figures = path, path / "checkpoint", path / "figures"

    @property
    def finished(self) -> bool:
        return (self.path / "DONE").exists()

    @property
    def has_checkpoint(self) -> bool:
        return self.checkpoint.is_dir() and any(path.name.isdigit() for path in self.checkpoint.iterdir())

    def begin(
        self,
        config_text: str,
        *,
        command: str | None,
        data: Mapping[str, str],
        choices: Mapping[str, str | None] | None = None,
        physics: Mapping[str, Any] | None = None,
    ) -> None:
        """Writes what is known before training: configuration, environment, command, and where the data came from.

        The results of an earlier run in this folder go first: from here on the run is unfinished. Its checkpoints go
        with them, in one step, because no run may go on from those of another one. command None: a resumed run, whose
        environment, command, physics and checkpoints stay on record. choices: names of the configuration's files,
        where there were any; physics: what `effects/stored.py` needs to build it again.
        """
        self._remove(*_RESULTS, *(("physics.json",) if physics is not None else ()))
        shutil.rmtree(self.figures, ignore_errors=True)
        for left in self.path.glob(".*.partial"):  # by a process that was killed while it wrote
            left.unlink(missing_ok=True)
        if command is not None:
            self._forget_checkpoints()
        self.write_text("config.yaml", config_text)
        if command is not None:
            more = {"command": command, "data": data, "choices": choices or {}}
            self.write_json("environment.json", {**environment(), **more})
        if physics is not None:
            self.write_json("physics.json", physics)

    def choices(self) -> dict[str, str | None]:
        """The names of the configuration's files, as the run began with them; empty where none are on record."""
        return self.read_json("environment.json").get("choices") or {}

    def check_data(self, data: Mapping[str, str]) -> None:
        """Raises `ValueError` when the run in this folder was made from other data than `data`."""
        before = self.read_json("environment.json").get("data")
        if before != dict(data):
            raise ValueError(f"resume: data: expected {before} as the run began with, found {dict(data)}")

    def write(self, name: str, write: Callable[[Path], object]) -> None:
        """What `write` writes into the path that it is given, or nothing. name: may lie in a folder."""
        path = self.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.partial")
        try:
            write(temporary)
            with temporary.open("rb") as file:
                os.fsync(file.fileno())  # a name that is on the disk before its content would stand for a half file
            temporary.replace(path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise

    def write_text(self, name: str, text: str) -> None:
        self.write(name, lambda path: path.write_text(text, encoding="utf-8"))

    def write_json(self, name: str, content: Mapping[str, Any]) -> None:
        self.write_text(name, json.dumps(_without_nan(content), indent=1, allow_nan=False) + "\n")

    def write_csv(self, name: str, table: pd.DataFrame) -> None:
        self.write(name, lambda path: table.to_csv(path, index=False))

    def write_arrays(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        if objects := [key for key, array in arrays.items() if np.asarray(array).dtype.hasobject]:
            raise TypeError(f"{name}: {objects[0]}: expected numbers, found objects, which would be pickled")

        save: Callable[..., None] = np.savez_compressed  # NumPy before 2.2 takes its allow_pickle for an array

        def write(path: Path) -> None:
            with path.open("wb") as file:
                save(file, **arrays)

        self.write(name, write)

    def read_json(self, name: str) -> dict[str, Any]:
        """The named values of a file, none where there is no file. Raises `ValueError` for a damaged one."""
        path = self.path / name
        try:
            found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        except (OSError, ValueError, RecursionError) as problem:
            raise ValueError(f"{path}: expected a JSON file, found {first_line(problem)}") from None
        if not isinstance(found, dict):
            raise ValueError(f"{path}: expected named values, found {type(found).__name__}")
        return found

    def read_arrays(self, name: str) -> dict[str, np.ndarray]:
        """The arrays of a file, none where there is no file; nothing in it is executed."""
        path = self.path / name
        if not path.is_file():
            return {}
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as arrays:
                return {key: arrays[key] for key in arrays.files}
        except Exception as problem:  # NumPy and zlib raise whatever a damaged file leads them to
            raise ValueError(f"{path}: expected arrays of numbers, found {first_line(problem)}") from None

    def finish(self) -> None:
        self.write_text("DONE", "")

    def fail(self, reason: str, trace: str | None = None) -> None:
        """Leaves the reason, one sentence, and the traceback of a failure that nobody expected."""
        if trace is not None:
            self.write_text("traceback.txt", trace)
        self.write_text("FAILED", f"{reason}\n")

    @property
    def failure(self) -> str | None:
        path = self.path / "FAILED"
        return path.read_text(encoding="utf-8").strip() if path.exists() else None

    def forget_failure(self) -> None:
        self._remove("FAILED", "traceback.txt")

    def _remove(self, *names: str) -> None:
        for name in names:
            (self.path / name).unlink(missing_ok=True)

    def _forget_checkpoints(self) -> None:
        """Renamed first: half of a checkpoint that is being removed must not be taken for one."""
        removed = self.path / ".checkpoint.removed"
        shutil.rmtree(removed, ignore_errors=True)
        if self.checkpoint.exists():
            self.checkpoint.rename(removed)
            shutil.rmtree(removed, ignore_errors=True)


def environment() -> dict[str, Any]:
    """Versions, device and commit: what someone needs to explain a difference in the last digits."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": os.cpu_count(),
        "devices": [str(device) for device in jax.devices()],
        "x64": bool(jax.config.read("jax_enable_x64")),
        "commit": _commit(),
        "packages": {name: _version(name) for name in _PACKAGES},
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Commit of this package's checkout, with `+changes` if the tree differs; None outside a checkout of its own."""
    package = Path(__file__).resolve().parent

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=package, capture_output=True, text=True, timeout=10, check=True)
        return done.stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != package.parent:
            return None
        return git("describe", "--always", "--dirty=+changes", "--abbrev=12")
    except (OSError, subprocess.SubprocessError):
        return None


def _without_nan(content: Any) -> Any:
    """JSON knows no NaN or infinity: null stands for a figure that does not exist."""
    if isinstance(content, Mapping):
        return {str(key): _without_nan(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_without_nan(value) for value in content]
    if isinstance(content, float | np.floating):
        return float(content) if math.isfinite(content) else None
    return int(content) if isinstance(content, np.integer) else content


def read_config(folder: Path) -> dict[str, Any]:
    """The configuration that a run folder was made with, as it is written there: nothing in it is resolved, so that a
    folder of others can read no variable of this machine. Raises `ValueError` when `folder` holds no run."""
    path = folder / "config.yaml"
    if not path.is_file():
        raise ValueError(f"run folder: expected one with a config.yaml, found none in {str(folder)!r}")
    try:
        found = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    except (yaml.YAMLError, OmegaConfBaseException, UnicodeDecodeError, AssertionError, OSError) as problem:
        raise ValueError(f"{path}: expected the configuration of a run, found {first_line(problem)}") from None
    if not isinstance(found, dict):
        raise ValueError(f"{path}: expected groups of named values, found {type(found).__name__}")
    return {str(key): value for key, value in found.items()}


def read_training_config(folder: Path) -> dict[str, Any]:
    """The configuration of a training run. Raises `ValueError` when the folder holds none, or one of something else."""
    found = read_config(folder)
    for group in _GROUPS:
        if not isinstance(found.get(group), dict):
            expected = f"{group}: expected a group of named values"
            raise ValueError(f"{folder / 'config.yaml'}: {expected}, found {found.get(group)!r}")
    return found


def short_path(path: Path) -> str:
    """A path as a person would type it: relative where it lies under the current folder."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def discard_if_empty(folder: Path) -> None:
    """Removes a folder that nothing was written to; a run makes it again with its first file."""
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
