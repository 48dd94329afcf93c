"""Logs of any arm: whatever it records, as positions and torques of the joints of its model, every `physics.dt` s.

    θ = N (q - z)        τ = Nᵀ u_m        u_m = k i        record: y = q,  u = τ / G

θ: position of the motors; N: transmission, the gear ratios on its diagonal and, where the drives of a wrist run through
it, further entries; z: angle of the model's joints where the log says zero; u_m: torque of the motors, i: their
currents, k Nm/A; G: gear ratio of the physics. A CSV file has a column per joint and quantity; an NPZ file has those,
or arrays `[time, joint]`, `[sequence, time, joint]`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.data.log_files import Columns, read_logs
from pgrssnn_jax.data.resample import Log, resampled
from pgrssnn_jax.data.sources import channels
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Record, RecordInfo, Splits, crop, map_signals, padded, record, stack
from pgrssnn_jax.records.splits import front, split_tail

Side = Literal["link", "motor"]
PerJoint = float | Sequence[float]
_SINGULAR = 1e9  # condition of a transmission


class _Meaning(NamedTuple):
    """What the numbers of a log are. transmission: N; constant: k, Nm/A, ones where torques were logged; gear: of the
    physics; position, torque: the side on which they were measured; angle: rad per unit of position."""

    transmission: Float[np.ndarray, "n n"]
    zero: Float[np.ndarray, " n"]
    constant: Float[np.ndarray, " n"]
    gear: Float[np.ndarray, " n"]
    position: Side
    torque: Side
    angle: float


def load_arm_log(
    *,
    train: str | Path,
    test: str | Path | None = None,
    validation: str | Path | None = None,
    physics: Physics,
    time: str | None = "time",
    sample_time: float | None = None,
    position: str | Sequence[str] = "position_%d",
    velocity: str | Sequence[str] | None = None,
    torque: str | Sequence[str] = "torque_%d",
    position_unit: Literal["rad", "deg"] = "rad",
    position_side: Side = "link",
    position_zero: PerJoint = 0.0,
    torque_side: Side = "motor",
    torque_constant: PerJoint | None = None,
    transmission: Sequence[Any] | None = None,
    cutoff: float | None = None,
    test_share: float = 1 / 3,
    n_train: int | None = None,
    n_validation: int | None = None,
) -> Splits:
    """The three records of an experiment on logs, each `[1, seq, time, joint]`.

    train, test: CSV or NPZ; test: None takes the last `test_share` of `train`, in time of a single sequence.
    validation: None: the end of the rest. time: column, s; None: samples every `sample_time` s. position, velocity,
    torque: a pattern, whose %d stands for 1 to n, a list of columns, or an array of an NPZ file; velocity, in the unit
    of the position per s, says how positions are interpolated. position_unit: rad | deg. position_side, torque_side:
    link | motor. position_zero: z, rad. torque_constant: k, Nm/A, where torques are currents. transmission: N, or the
    ratios on its diagonal; None: the gear ratios of the physics. cutoff: Hz of the low-pass filter, None: 0.4 /
    physics.dt where the log is finer. n_train, n_validation: samples per sequence. Raises `ValueError` for a physics
    that is no arm and for files that do not hold what is named.
    """
    meaning = _meaning(physics, transmission, position_zero, torque_constant, position_side, torque_side, position_unit)
    columns = Columns(time, sample_time, position, torque, velocity)

    def read(key: str, path: str | Path) -> Record:
        return _record(path, columns, meaning, physics, cutoff, key)

    whole = read("data.train", train)
    fitted, tested = (whole, read("data.test", test)) if test is not None else _shared(whole, test_share)
    if validation is None:
        fitted, validated = split_tail(fitted, n_validation)
    else:
        validated = front(read("data.validation", validation), "data.n_validation", n_validation)
    fitted = front(fitted, "data.n_train", n_train)
    return Splits(*(stack([part]) for part in (fitted, validated, tested)))


def _meaning(
    physics: Physics,
    transmission: Sequence[Any] | None,
    zero: PerJoint,
    constant: PerJoint | None,
    position: Side,
    torque: Side,
    unit: str,
) -> _Meaning:
    own = getattr(physics.params, "own", physics.params)  # without the numbers of effects
    if physics.name != "arm" or "G" not in own:
        raise ValueError(f"data.name: arm_log: expected physics=arm, found physics {physics.name!r}")
    gear = np.asarray(own["G"], np.float64)
    ratios = gear if transmission is None else _numbers("data.transmission", transmission)
    matrix = np.diag(ratios) if ratios.ndim == 1 else ratios
    n = len(gear)
    if matrix.shape != (n, n) or np.linalg.cond(matrix) > _SINGULAR:
        raise ValueError(
            f"data.transmission: expected {n} ratios, or {n} x {n} that can be inverted, found {transmission}"
        )
    zeros, constants = (
        np.broadcast_to(_numbers(f"data.{name}", value, n), (n,))
        for name, value in (("position_zero", zero), ("torque_constant", 1.0 if constant is None else constant))
    )
    return _Meaning(matrix, zeros, constants, gear, position, torque, np.pi / 180 if unit == "deg" else 1.0)


def _numbers(key: str, value: Any, n: int | None = None) -> np.ndarray:
    """n: one number or n of them."""
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        found = np.asarray(np.nan)
    if not np.isfinite(found).all() or (n is not None and found.shape not in ((), (n,))):
        expected = "numbers" if n is None else f"one number or {n}, one per joint"
        raise ValueError(f"{key}: expected {expected}, found {value!r}")
    return found


def _record(
    path: str | Path, columns: Columns, meaning: _Meaning, physics: Physics, cutoff: float | None, key: str
) -> Record:
    digest, logs = read_logs(path, columns, len(meaning.gear), key)
    found = [resampled(_of_joints(log, meaning), physics.dt, cutoff, f"{key}: {path}") for log in logs]
    longest = max(len(one.position) for one in found)
    u = np.stack([padded(one.torque / meaning.gear, longest) for one in found])
    y = np.stack([padded(one.position, longest) for one in found])
    real = np.arange(longest) < np.array([[len(one.position)] for one in found])
    inputs, outputs = channels(physics.inputs), channels(physics.outputs)
    origin = f"{Path(path).name}, sha256 {digest}…, {min(found, key=lambda one: one.kept).words}"
    bandwidth = min((one.cutoff for one in found if one.cutoff is not None), default=None)
    info = RecordInfo(inputs, outputs, physics.dt, "file", origin, padded=not real.all(), bandwidth=bandwidth)
    return record(u, y, info, np.broadcast_to(real[..., None], y.shape))


def _of_joints(log: Log, meaning: _Meaning) -> Log:
    """Angles of the model's joints and torques on their side."""
    position, velocity = (None if x is None else meaning.angle * x for x in (log.position, log.velocity))
    assert position is not None
    if meaning.position == "motor":
        back = np.linalg.inv(meaning.transmission).T
        position, velocity = position @ back, None if velocity is None else velocity @ back
    torque = log.torque * meaning.constant
    return Log(
        log.time,
        position + meaning.zero,
        torque @ meaning.transmission if meaning.torque == "motor" else torque,
        velocity,
    )


def _shared(whole: Record, share: float) -> tuple[Record, Record]:
    """Without its last part, and that: of a single sequence in time, else of the sequences."""
    if not 0 < share < 1:
        raise ValueError(f"data.test_share: expected more than 0 and less than 1, found {share}")
    sequences, time = whole.u.shape[:2]
    if sequences == 1:
        cut = min(max(1, round(time * (1 - share))), time - 1)
        return crop(whole, 0, cut), crop(whole, cut, time)
    cut = min(max(1, round(sequences * (1 - share))), sequences - 1)
    first, last = (map_signals(whole, lambda a, w=which: a[w]) for which in (slice(0, cut), slice(cut, None)))
    return first, last
