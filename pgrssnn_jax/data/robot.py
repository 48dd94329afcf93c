"""The KUKA KR300 arm: measured sequences, and the published simulated ones. u: motor torque, Nm; y: position, rad.

    load_robot_real        60, 6 and 6 sequences of 605 samples, 10 Hz; one dataset
    load_robot_simulated   60, 6 and 6 sequences of 606 samples, 10 Hz; every realisation is a dataset, all share u

Every sequence starts at rest at q = 0. Where neither a file nor, for the measured arm, a download can be had, an arm
is simulated with the unknown effects of the published one (`arm_simulator.py`); position noise 0.1 rad, or, in place of
the measured arm, an encoder's 1e-4 rad.
Source: Weigand, Götz, Ulmen, Ruskowski, industrial robot identification benchmark; Li, Seth, Kok, IFAC 2026.
"""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.data.download import download_robot
from pgrssnn_jax.data.mat import Sequences, read_mat
from pgrssnn_jax.data.sources import channels, check_generated, measured_data, published_folder, say_nothing
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.arguments import check_count
from pgrssnn_jax.records.record import Channel, RecordInfo, Splits, record, stack
from pgrssnn_jax.records.table import fingerprint

JOINTS, SAMPLE_TIME = 6, 0.1  # s
REAL_SAMPLES, SIMULATED_SAMPLES = 605, 606
_REAL_FILE = "robot_real/forward_identification_without_raw_data_shifted.mat"
_SIMULATED_FOLDER = "robot_simulated"
_SIMULATED_FILE = "1010m_vary_sim_position_noiseTorque{}.mat"
_SPLIT = (60, 6, 6)
_ENCODER = 1e-4  # rad


class _Found(NamedTuple):
    """datasets: train, validation and test sequences of each; origin: in words."""

    datasets: list[tuple[Sequences, ...]]
    source: str
    origin: str


def load_robot_real(
    *,
    path: str | Path | None = None,
    generated: bool = False,
    n_train: int | None = None,
    n_validation: int | None = None,
    n_test: int | None = None,
    n_samples: int | None = None,
    seed: int = 0,
    physics: Physics | None = None,
    notify: Callable[[str], None] = say_nothing,
    timeout: float = 60.0,
) -> Splits:
    """The three records, each `[1, seq, time, 6]`; `info` says where they come from.

    path: MAT file; None looks in PGRSSNN_DATA, then downloads, then simulates an arm. n_train, n_validation, n_test:
    sequences from the front; n_samples: of each, from its start; None: all. generated: simulate in any case. seed: of
    the simulated arm. notify: takes one line about each source that was passed over. timeout: s that a download may
    take. Raises `ValueError` for a bad file, for another physics than one of six joints at 10 Hz, and for more than
    there is.
    """
    check_generated(generated, seed, path, "a file")
    _check(physics)
    simulate = partial(_simulated, seed, REAL_SAMPLES, 1, f"built-in simulated arm, seed {seed}", noise=_ENCODER)
    if generated:
        found = simulate()
    else:
        download, arm = partial(_downloaded, timeout), f"ARM (seed {seed})"
        found = measured_data(path, _REAL_FILE, _read_real, download, simulate, notify, simulated=arm)
    return _splits(found, (n_train, n_validation, n_test), n_samples, physics, "robot_real")


def load_robot_simulated(
    *,
    path: str | Path | None = None,
    generated: bool = False,
    realisations: int = 10,
    n_train: int | None = None,
    n_validation: int | None = None,
    n_test: int | None = None,
    n_samples: int | None = None,
    seed: int = 0,
    physics: Physics | None = None,
    notify: Callable[[str], None] = say_nothing,
) -> Splits:
    """The three records, each `[realisation, seq, time, 6]`.

    path: folder of the published files; None: `robot_simulated` under PGRSSNN_DATA, or, without that, generated data.
    realisations: files, each a dataset. n_train, n_validation, n_test, n_samples, generated, seed and notify as for
    `load_robot_real`.
    """
    check_generated(generated, seed, path, "a folder")
    _check(physics)
    check_count("data.realisations", realisations, 1, 1000, "datasets")
    folder = None if generated else published_folder(_SIMULATED_FOLDER, path, seed, notify)
    if folder is None:
        found = _simulated(seed, SIMULATED_SAMPLES, realisations, f"generated, seed {seed}")
    else:
        found = _read(folder, realisations)
    return _splits(found, (n_train, n_validation, n_test), n_samples, physics, "robot_simulated")


def _check(physics: Physics | None) -> None:
    if physics is None:
        return
    sizes = len(physics.inputs), len(physics.outputs)
    if sizes != (JOINTS, JOINTS):
        raise ValueError(
            f"physics: expected {JOINTS} inputs and {JOINTS} outputs, the joints of the arm in these data, "
            f"found {sizes[0]} and {sizes[1]}"
        )
    if not math.isclose(physics.dt, SAMPLE_TIME, rel_tol=0.01):
        raise ValueError(
            f"physics.dt: expected {SAMPLE_TIME:g} s, the sample time of the arm's data, found {physics.dt:g} s"
        )


def _read_real(path: str | Path) -> _Found:
    *parts, digest = read_mat(path, JOINTS, REAL_SAMPLES)
    return _Found([tuple(parts)], "file", f"{Path(path).name}, sha256 {digest}…")


def _downloaded(timeout: float) -> _Found:
    """Split as published: the last 6 training sequences (at most half) validate, the first 60 of the others train."""
    train, test = download_robot(timeout)
    if len(train) < 2:
        raise ConnectionError(f"expected at least two training sequences, found {len(train)}")
    most, last, tested = _SPLIT
    rest = len(train) - min(last, len(train) // 2)
    parts = tuple(_aligned(part) for part in (train[: min(most, rest)], train[rest:], test[:tested]))
    return _Found([parts], "download", "package nonlinear_benchmarks")


def _aligned(part: Float[np.ndarray, "seq time 12"]) -> Sequences:
    """u_t with what was measured a sample later, as published."""
    return Sequences(part[:, :-1, :JOINTS], np.deg2rad(part[:, 1:, JOINTS:]))


def _read(folder: Path, realisations: int) -> _Found:
    files = [read_mat(folder / _SIMULATED_FILE.format(i), JOINTS, SIMULATED_SAMPLES) for i in range(realisations)]
    sizes = [tuple(len(part.u) for part in file[:3]) for file in files]
    for i, size in enumerate(sizes):
        if size != sizes[0]:
            file, first = folder / _SIMULATED_FILE.format(i), _SIMULATED_FILE.format(0)
            raise ValueError(f"{file}: sequences: expected {sizes[0]} (train, val, test), as {first}, found {size}")
    together = fingerprint("".join(file.digest for file in files).encode())
    origin = f"{_SIMULATED_FILE.format(f'0..{realisations - 1}')}, sha256 of their digests {together}…"
    return _Found([file[:3] for file in files], "file", origin)


def _simulated(seed: int, samples: int, realisations: int, origin: str, **changes: float) -> _Found:
    from pgrssnn_jax.data.arm_simulator import ArmSimulator, simulated_arm  # loads Pinocchio

    u, _, y = simulated_arm(seed, sum(_SPLIT), samples, realisations, ArmSimulator()._replace(**changes))
    ends = np.cumsum(_SPLIT)[:-1]
    datasets = [tuple(map(Sequences, np.split(u, ends), np.split(one, ends))) for one in y]
    return _Found(datasets, "simulated", origin)


def _splits(
    found: _Found, wanted: tuple[int | None, ...], samples: int | None, physics: Physics | None, benchmark: str
) -> Splits:
    """wanted: sequences of each part, samples: of every sequence; None: all."""
    if physics is None:
        inputs = tuple(Channel(f"torque_{i + 1}", "Nm") for i in range(JOINTS))
        outputs = tuple(Channel(f"position_{i + 1}", "rad") for i in range(JOINTS))
    else:
        inputs, outputs = channels(physics.inputs), channels(physics.outputs)
    dt = SAMPLE_TIME if physics is None else physics.dt
    info = RecordInfo(inputs, outputs, dt, found.source, found.origin, start="rest", benchmark=benchmark)
    longest = found.datasets[0][0].u.shape[1]
    samples = _count("data.n_samples", samples, longest, f"samples per sequence in {found.origin}")
    parts = []
    for name, part, some in zip(Splits._fields, zip(*found.datasets, strict=True), wanted, strict=True):
        count = _count(f"data.n_{name}", some, len(part[0].u), f"{name} sequences in {found.origin}")
        parts.append(stack([record(u[:count, :samples], y[:count, :samples], info) for u, y in part]))
    return Splits(*parts)


def _count(name: str, wanted: int | None, most: int, what: str) -> int:
    check_count(name, most if wanted is None else wanted, 1, most, what)
    return most if wanted is None else wanted
