"""The loaders of records: the four benchmarks of the paper by name, users' own CSV files and logs of arms.

Records of a benchmark know their validation part and how their test record starts.
"""

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pgrssnn_jax.data.arm_log import load_arm_log
from pgrssnn_jax.data.lgssm import load_lgssm
from pgrssnn_jax.data.robot import load_robot_real, load_robot_simulated
from pgrssnn_jax.data.sources import channels
from pgrssnn_jax.data.tanks import load_cascaded_tank
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.arguments import call_with
from pgrssnn_jax.records.csv import read_csv
from pgrssnn_jax.records.record import Record, Splits, stack, take
from pgrssnn_jax.records.splits import front, split_tail


def load_csv(
    *,
    train: str | Path,
    test: str | Path,
    validation: str | Path | None = None,
    physics: Physics,
    n_train: int | None = None,
    n_validation: int | None = None,
) -> Splits:
    """The three records of an experiment on users' files, each `[1, seq, time, channel]`.

    validation: None takes it from the end of `train`: the last quarter of the samples of a single sequence, the last
    quarter (at least one) of several sequences. n_train, n_validation: samples per sequence; training samples count
    from the front, None: all.
    """

    def read(key: str, path: str | Path) -> Record:
        try:
            return read_csv(path, channels(physics.inputs), channels(physics.outputs), physics.dt)
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from None

    fitted, tested = read("data.train", train), read("data.test", test)
    if validation is None:
        fitted, validated = split_tail(fitted, n_validation)
    else:
        validated = front(read("data.validation", validation), "data.n_validation", n_validation)
    fitted = front(fitted, "data.n_train", n_train)
    for key, part in (("data.train", fitted), ("data.validation", validated), ("data.test", tested)):
        if not part.mask.any():
            raise ValueError(f"{key}: expected at least one measured output, found none in {part.info.origin}")
    return Splits(*(stack([part]) for part in (fitted, validated, tested)))


LOADERS: Mapping[str, Callable[..., Splits]] = MappingProxyType(
    {
        "cascaded_tank": load_cascaded_tank,
        "lgssm": load_lgssm,
        "robot_real": load_robot_real,
        "robot_simulated": load_robot_simulated,
        "csv": load_csv,
        "arm_log": load_arm_log,
    }
)
_FILES = {"csv", "arm_log"}  # users' own
_OF_CALLERS = ("physics", "notify", "timeout")


def loader_settings(name: str) -> dict[str, Any]:
    """The arguments of a loader with their defaults, `...` where there is none."""
    parameters = inspect.signature(LOADERS[name]).parameters.items()
    empty = inspect.Parameter.empty
    return {key: ... if p.default is empty else p.default for key, p in parameters if key not in _OF_CALLERS}


def load_benchmark(name: str, **settings: Any) -> tuple[Record, Record]:
    """Training and test record of `cascaded_tank`, `lgssm`, `robot_real` or `robot_simulated`; prints its source.

    Measured or published data come from the file named by `path=`, else from the folder in PGRSSNN_DATA, else from a
    download. Without these a simulator makes them, and one line states it. u `[sequence, time, input]`, with a leading
    axis of realisations where there are several; `train.validation` is the part that training sets aside. settings:
    those of the loader (`path`, `n_train`, `realisations`, `seed`, ...). Raises `ValueError` for an unknown name or
    setting, and for files that do not hold the benchmark.
    """
    if not isinstance(name, str) or name not in LOADERS or name in _FILES:
        raise ValueError(f"load_benchmark: expected one of {sorted(set(LOADERS) - _FILES)}, found {name!r}")
    train, test = as_records(call_with(LOADERS[name], settings, "load_benchmark", notify=print))
    print(f"{name}: {train.info.source}: {train.info.origin}")  # noqa: T201 - the one line that a user must see
    return train, test


def as_records(splits: Splits) -> tuple[Record, Record]:
    """Training record with its validation part, and test record, without the axis of datasets where there is one."""
    train, validation, test = (take(part, 0) if len(part.u) == 1 else part for part in splits)
    return train._replace(validation=validation), test
