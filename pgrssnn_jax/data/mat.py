"""Robot sequences in MAT files of the published layout, one row per joint, sequences back to back.

    u_train, u_val, u_test   [n, samples · sequences]   motor-side torque, Nm      u_t acts on y_t
    y_train, y_val, y_test   [n, samples · sequences]   position, degrees

Bad files raise `ValueError` with one sentence: file, array, what was expected, what was found.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.records.arguments import first_line
from pgrssnn_jax.records.table import fingerprint


class Sequences(NamedTuple):
    """u: motor-side torque, Nm; y: position, rad."""

    u: Float[np.ndarray, "seq time n"]
    y: Float[np.ndarray, "seq time n"]


class MatFile(NamedTuple):
    """digest: of the file's bytes."""

    train: Sequences
    validation: Sequences
    test: Sequences
    digest: str


def read_mat(path: str | Path, joints: int, samples: int) -> MatFile:
    """The three parts of a file. joints: rows of every array; samples: of one sequence."""
    arrays, digest = _load(path)
    keys = [(f"u_{part}", f"y_{part}") for part in ("train", "val", "test")]
    matrices = {key: _matrix(path, arrays, key, joints) for pair in keys for key in pair}
    parts = [_cut(path, matrices, *pair, samples) for pair in keys]
    largest = max(float(np.abs(part.y).max()) for part in parts)
    if largest < 2 * np.pi:
        raise ValueError(
            f"{path}: positions y_*: expected degrees, found no value beyond ±{largest:.3g}, which looks like radians"
        )
    train, validation, test = (part._replace(y=np.deg2rad(part.y)) for part in parts)
    return MatFile(train, validation, test, digest)


def _load(path: str | Path) -> tuple[Mapping[str, Any], str]:
    """Every array of a file by its name, and the file's digest."""
    try:
        content = Path(path).expanduser().read_bytes()
    except FileNotFoundError:
        raise ValueError(f"{path}: expected a MAT file, found no such file") from None
    except OSError as error:
        raise ValueError(f"{path}: expected a readable MAT file, found {error.strerror}") from None
    # Said first because SciPy takes some of these files for damaged ones.
    if content.startswith((b"\x89HDF", b"MATLAB 7.3")):
        raise ValueError(f"{path}: expected a MAT file up to version 7.2, found version 7.3 (save it with '-v7')")
    try:
        found = scipy.io.loadmat(io.BytesIO(content))
    except Exception as error:  # SciPy's reader raises whatever a damaged file leads it to
        raise ValueError(f"{path}: expected a readable MAT file, found {first_line(error)}") from None
    return {key: value for key, value in found.items() if not key.startswith("__")}, fingerprint(content)


def _matrix(path: str | Path, arrays: Mapping[str, Any], key: str, joints: int) -> Float[np.ndarray, "n columns"]:
    where = f"{path}: array {key!r}: expected"
    if key not in arrays:
        raise ValueError(f"{where} it in the file, found {', '.join(sorted(arrays)) or 'no array'}")
    found = arrays[key]
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "iuf":
        raise ValueError(f"{where} a matrix of real numbers, found {getattr(found, 'dtype', type(found).__name__)}")
    if found.ndim != 2 or found.shape[0] != joints:
        raise ValueError(f"{where} {joints} rows, one for each joint of the physics, found shape {found.shape}")
    bad = np.argwhere(~np.isfinite(found))
    if len(bad):
        row, column = bad[0]
        raise ValueError(f"{where} finite numbers, found {found[row, column]} in row {row + 1}, column {column + 1}")
    return found.astype(np.float64)


def _cut(path: str | Path, matrices: Mapping[str, np.ndarray], u_key: str, y_key: str, samples: int) -> Sequences:
    """`[seq, samples, n]` from `[n, samples · seq]`."""
    u, y = matrices[u_key], matrices[y_key]
    if u.shape != y.shape:
        raise ValueError(f"{path}: array {y_key!r}: expected {u.shape[1]} columns, as {u_key!r}, found {y.shape[1]}")
    if not u.shape[1] or u.shape[1] % samples:
        raise ValueError(
            f"{path}: array {u_key!r}: expected a multiple of {samples} columns, the samples of a sequence, "
            f"found {u.shape[1]}"
        )
    return Sequences(*(np.ascontiguousarray(a.reshape(len(a), -1, samples).transpose(1, 2, 0)) for a in (u, y)))
