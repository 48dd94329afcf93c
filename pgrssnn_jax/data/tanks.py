"""The cascaded-tanks benchmark: from a file, else from a download, else from a simulated plant, split as published.

    train        first 768 of the 1024 samples of the estimation record
    validation   last 256 of them
    test         the second record, 1024 samples; it starts at the same, unknown levels as the first

u: pump voltage, V; y: level voltage of the lower tank, V; one sample every 4 s. A file has the columns uEst, uVal,
yEst, yVal and Ts (s; on the first row).
Source: Schoukens and Noël, Cascaded Tanks benchmark combining soft and hard nonlinearities, 2016.
"""

import hashlib
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.data.download import download_tanks
from pgrssnn_jax.data.sources import check_generated, measured_data, say_nothing
from pgrssnn_jax.data.tank_simulator import SAMPLE_TIME, estimation_and_test
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.arguments import check_count
from pgrssnn_jax.records.record import Channel, RecordInfo, Splits, crop, record, stack
from pgrssnn_jax.records.table import column, numbers, problem, read_table

_FILE = "cascaded_tanks/dataBenchmark.csv"
_CLOCK = 0.01  # of the sample time
_COLUMNS = ("uEst", "uVal", "yEst", "yVal")
_PUBLISHED = "c28ec4bde8563e8f8827561dd07b85941e45cb96326f4249a04823ed4c9f00dd"


class _Found(NamedTuple):
    """columns: u_est, u_test, y_est, y_test; origin: in words."""

    columns: Float[np.ndarray, "time 4"]
    source: str
    origin: str


def load_cascaded_tank(
    *,
    path: str | Path | None = None,
    n_train: int | None = None,
    n_validation: int = 256,
    generated: bool = False,
    seed: int = 0,
    physics: Physics | None = None,
    notify: Callable[[str], None] = say_nothing,
    timeout: float = 30.0,
) -> Splits:
    """The three records, each `[1, 1, time, 1]`; `info` says where they come from.

    path: the file; None looks in PGRSSNN_DATA, then downloads, then simulates a plant. n_train: samples from the front,
    None: all that are not for validation; n_validation: samples at the end of the estimation record. generated:
    simulate in any case. seed: of the simulated plant. notify: takes one line about each source that was passed over.
    timeout: s that a download may take. Raises `ValueError` for a bad file, for another sample time than that of
    `physics`, and for more samples than there are.
    """
    check_generated(generated, seed, path, "a file")
    dt = SAMPLE_TIME if physics is None else physics.dt
    simulate = partial(_simulated, dt, seed)
    if generated:
        found = simulate()
    else:
        read, download = partial(_read, dt=dt), partial(_downloaded, dt, timeout)
        plant = f"TWO-TANK PLANT (seed {seed})"
        found = measured_data(path, _FILE, read, download, simulate, notify, simulated=plant)
    check_count("data.n_validation", n_validation, 1, len(found.columns) - 1, f"samples in {found.origin}")
    rest = len(found.columns) - n_validation
    n_train = rest if n_train is None else n_train
    check_count("data.n_train", n_train, 1, rest, f"samples before the {n_validation} for validation")
    u, y = (Channel(name, "V") for name in ("pump_voltage", "level_voltage"))
    info = RecordInfo((u,), (y,), dt, found.source, found.origin, start="shared", benchmark="cascaded_tank")
    estimation, test = (record(found.columns[:, [i]], found.columns[:, [i + 2]], info) for i in range(2))
    parts = (crop(estimation, 0, n_train), crop(estimation, rest, rest + n_validation), test)
    return Splits(*(stack([part]) for part in parts))


def _downloaded(dt: float, timeout: float) -> _Found:
    columns, sample_time = download_tanks(timeout)
    _check_sample_time(dt, sample_time, "the downloaded data")
    return _Found(columns, "download", f"package nonlinear_benchmarks, {_verdict(columns)}")


def _read(path: str | Path, dt: float) -> _Found:
    table = read_table(path)
    for name in (*_COLUMNS, "Ts"):
        column(table, name)
    if not table.lines:
        raise problem(path, 1, None, "samples below the header", "none")
    columns = np.stack([numbers(table, name) for name in _COLUMNS], axis=1)
    first_row = np.arange(len(table.lines)) == 0
    sample_time = float(numbers(table, "Ts", first_row)[0])
    if not math.isclose(sample_time, dt, rel_tol=_CLOCK):
        raise problem(path, table.lines[0], "Ts", f"{dt:g} s (the physics' dt)", f"{sample_time:g} s")
    return _Found(columns, "file", f"{Path(path).name}, sha256 {table.digest}…, {_verdict(columns)}")


def _simulated(dt: float, seed: int) -> _Found:
    _check_sample_time(dt, SAMPLE_TIME, "the simulated plant")
    return _Found(estimation_and_test(seed), "simulated", f"built-in two-tank simulator, seed {seed}")


def _check_sample_time(dt: float, found: float, whose: str) -> None:
    if not math.isclose(found, dt, rel_tol=_CLOCK):
        raise ValueError(f"physics.dt: expected {found:g} s, the sample time of {whose}, found {dt:g} s")


def _verdict(columns: Float[np.ndarray, "time 4"]) -> str:
    """Compares the numbers with the published ones to five digits, as many as the file has."""
    text = "\n".join(",".join(f"{value:.5g}" for value in row) for row in columns)
    published = hashlib.sha256(text.encode()).hexdigest() == _PUBLISHED
    return "the published benchmark (numbers verified)" if published else "not the published benchmark"
