"""Linear Gaussian state-space data: the published realisations, or generated ones.

    x_t = A x_{t-1} + B u_t + w_t,   w ~ N(0, 0.25 I)        A = [0.7 0.8; 0 0.1],  B = [-1; 0.1],  x_0 = 0
    y_t = C x_t + v_t,               v ~ N(0, 1)              C = [1 0],   u white, uniform in [-2.5, 2.5]

u `[.., 1]`, y `[.., 1]` without unit. Every realisation has its own u, w and v; all share one test record.
Source: Li, Seth, Kok, IFAC 2026, section 4.1; its text gives w ~ N(0, 0.5 I), the published data have variance 0.25.
"""

import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.data.sources import check_generated, published_folder, say_nothing
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.arguments import check_count
from pgrssnn_jax.records.record import Channel, RecordInfo, Splits, map_signals, record, stack
from pgrssnn_jax.records.table import fingerprint

A = np.array([[0.7, 0.8], [0.0, 0.1]])
B = np.array([-1.0, 0.1])
C = np.array([1.0, 0.0])
_W_STD, _V_STD, _U_LARGEST = 0.5, 1.0, 2.5
_FOLDER = "lgssm"
_TRAIN_FILE = "toy_lgssm_pre_trainingset_shifted_{}.npz"
_TEST_FILE = "toy_lgssm_pre_testset_shifted.npz"

Signals = tuple[Float[np.ndarray, "time 1"], Float[np.ndarray, "time 1"]]  # u, y


def load_lgssm(
    *,
    path: str | Path | None = None,
    generated: bool = False,
    realisations: int = 50,
    n_train: int = 2000,
    n_validation: int = 2000,
    n_test: int = 5000,
    seed: int = 0,
    physics: Physics | None = None,
    notify: Callable[[str], None] = say_nothing,
) -> Splits:
    """train `[realisation, 1, n_train, 1]`, validation `[realisation, 1, n_validation, 1]` and test
    `[realisation, 1, n_test, 1]`, the same record for each.

    path: folder of the published files; None: `lgssm` under PGRSSNN_DATA, or, without that, generated data. generated:
    generate in any case. seed: of generated data. physics: its dt is the sample time (1 without). notify: takes a line
    when data are generated though nobody asked. Raises `ValueError` for bad files and for more samples than they have.
    """
    check_generated(generated, seed, path, "a folder")
    check_count("data.realisations", realisations, 1, 10**6, "datasets")
    for name, count in (("n_train", n_train), ("n_validation", n_validation), ("n_test", n_test)):
        check_count(f"data.{name}", count, 1, 10**9, "samples")
    folder = None if generated else published_folder(_FOLDER, path, seed, notify)
    if folder is None:
        # each record has a random stream of its own, so that fewer samples or realisations are a part of more
        test = _simulate(np.random.default_rng((seed, 0)), n_test)
        streams = [np.random.default_rng((seed, 1, i)).spawn(2) for i in range(realisations)]
        fitted = [(_simulate(first, n_train), _simulate(second, n_validation)) for first, second in streams]
        source, origin = "simulated", f"generated, seed {seed}"
    else:
        files = [folder / _TRAIN_FILE.format(i) for i in range(realisations)]
        fitted = [(_read(file, "train", n_train), _read(file, "val", n_validation)) for file in files]
        test = _read(folder / _TEST_FILE, "test", n_test)
        digest = fingerprint((folder / _TEST_FILE).read_bytes())
        source, origin = "file", f"{_TRAIN_FILE.format(f'0..{realisations - 1}')}, test record sha256 {digest}…"
    dt = 1.0 if physics is None else physics.dt
    info = RecordInfo((Channel("u"),), (Channel("y"),), dt, source, origin, start="rest", benchmark="lgssm")
    train, validation = (stack([record(u, y, info) for u, y in part]) for part in zip(*fitted, strict=True))
    # the same test record for every realisation, without copying it
    tested = map_signals(record(*test, info), lambda signal: np.broadcast_to(signal, (realisations, *signal.shape)))
    return Splits(train, validation, tested)


def _simulate(rng: np.random.Generator, n: int) -> Signals:
    inputs, process, sensor = rng.spawn(3)
    u = inputs.uniform(-_U_LARGEST, _U_LARGEST, size=(n, 1))
    pushes = u * B + _W_STD * process.standard_normal((n, 2))
    x, levels = np.zeros(2), np.empty((n, 2))
    for t, push in enumerate(pushes):
        x = levels[t] = A @ x + push
    return u, (levels @ C)[:, None] + _V_STD * sensor.standard_normal((n, 1))


def _read(file: Path, part: str, count: int) -> Signals:
    """The first `count` samples of u_<part> and y_<part> of a file."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            found = {key: np.asarray(arrays[key], np.float64) for key in (f"u_{part}", f"y_{part}") if key in arrays}
            there = ", ".join(arrays.keys())
    except FileNotFoundError:
        raise ValueError(f"{file}: expected a file of the published data, found no such file") from None
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{file}: expected a readable .npz file of numbers, found {reason}") from None
    for key in (f"u_{part}", f"y_{part}"):
        if key not in found:
            raise ValueError(f"{file}: array {key!r}: expected it in the file, found {there or 'no array'}")
        shape = found[key].shape
        if len(shape) != 2 or shape[1] != 1 or shape[0] < count:
            raise ValueError(f"{file}: array {key!r}: expected shape (at least {count}, 1), found {shape}")
        if not np.isfinite(found[key][:count]).all():
            t = int(np.flatnonzero(~np.isfinite(found[key][:count, 0]))[0])
            raise ValueError(f"{file}: array {key!r}: expected finite numbers, found {found[key][t, 0]} at t = {t}")
    return found[f"u_{part}"][:count], found[f"y_{part}"][:count]
