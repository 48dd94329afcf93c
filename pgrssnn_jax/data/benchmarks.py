"""The four benchmarks of the paper by name, as records that know their validation part and how their test starts."""

import inspect
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from pgrssnn_jax.data.csv_files import load_csv
from pgrssnn_jax.data.lgssm import load_lgssm
from pgrssnn_jax.data.robot import load_robot_real, load_robot_simulated
from pgrssnn_jax.data.tanks import load_cascaded_tank
from pgrssnn_jax.records.arguments import call_with
from pgrssnn_jax.records.record import Record, Splits, take

LOADERS: Mapping[str, Callable[..., Splits]] = MappingProxyType(
    {
        "cascaded_tank": load_cascaded_tank,
        "lgssm": load_lgssm,
        "robot_real": load_robot_real,
        "robot_simulated": load_robot_simulated,
        "csv": load_csv,
    }
)
_OF_CALLERS = ("physics", "notify", "timeout")


def loader_settings(name: str) -> dict[str, Any]:
    """The arguments of a loader with their defaults, `...` where there is none."""
    parameters = inspect.signature(LOADERS[name]).parameters.items()
    empty = inspect.Parameter.empty
    return {key: ... if p.default is empty else p.default for key, p in parameters if key not in _OF_CALLERS}


def load_benchmark(name: str, **settings: Any) -> tuple[Record, Record]:
    """Training and test record of `cascaded_tank`, `lgssm`, `robot_real` or `robot_simulated`; prints its source.

    Measured or published data come from the file named by `path=`, else from the folder in PGRSSNN_DATA, else from a
    download; without them they are simulated, which one line says. u `[sequence, time, input]`, with a leading axis of
    realisations where there are several; `train.validation` is the part that training sets aside. settings: those of
    the loader (`path`, `n_train`, `realisations`, `seed`, ...). Raises `ValueError` for an unknown name or setting, and
    for files that do not hold the benchmark.
    """
    if name not in LOADERS or name == "csv":
        raise ValueError(f"load_benchmark: expected one of {sorted(set(LOADERS) - {'csv'})}, found {name!r}")
    train, test = as_records(call_with(LOADERS[name], settings, "load_benchmark", notify=print))
    print(f"{name}: {train.info.source}: {train.info.origin}")  # noqa: T201 - the one line that a user must see
    return train, test


def as_records(splits: Splits) -> tuple[Record, Record]:
    """Training record with its validation part, and test record, without the axis of datasets where there is one."""
    train, validation, test = (take(part, 0) if len(part.u) == 1 else part for part in splits)
    return train._replace(validation=validation), test
