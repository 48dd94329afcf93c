"""A record from arrays in memory."""

from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np

from pgrssnn_jax.records.arguments import check_kind, positive, real_numbers, shown
from pgrssnn_jax.records.record import Array, Channel, Record, RecordInfo, Start, padded, record


def record_from(
    u: Array | Sequence[Array] | Sequence[float],
    y: Array | Sequence[Array] | Sequence[float],
    *,
    dt: float,
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
    mask: Array | Sequence[Array] | None = None,
    start: Start = "unknown",
) -> Record:
    """A record from inputs u and outputs y, sampled every `dt` seconds.

    u `[time, input]` or `[sequence, time, input]`, or a list of sequences `[time, input]` of any length; y likewise.
    inputs, outputs: name and unit of every channel, in the order of the columns. NaN in y, or False in mask (the shape
    of y), stands for a sample that was not measured. start: the initial state: `unknown`, `rest`, that is zero, or
    `shared` by the training and the test record. Raises `ValueError` for shapes that disagree, for values that are no
    real numbers, for a value of u that is not finite, and for a dt that is not positive.
    """
    dt = positive("record: dt", dt, "sample time in seconds")
    if start not in get_args(Start):
        raise ValueError(f"record: start: expected one of {list(get_args(Start))}, found {start!r}")
    for name, named in (("inputs", inputs), ("outputs", outputs)):
        if not isinstance(named, Mapping):
            expected = "names with units, {'pump_voltage': 'V'} say"
            raise ValueError(f"record: {name}: expected {expected}, found {shown(named)}")
        for channel, unit in named.items():
            check_kind(f"record: {name}: {channel}", unit, str, "the text of a unit, '' for none")
        if not named:
            raise ValueError(f"record: {name}: expected at least one name with its unit, found none")
    us, ys = _sequences("u", u, len(inputs)), _sequences("y", y, len(outputs))
    masks = [np.isfinite(one) for one in ys] if mask is None else _sequences("mask", mask, len(outputs))
    lengths = [[len(one) for one in part] for part in (us, ys, masks)]
    if lengths[2] != lengths[1]:
        raise ValueError(f"record: mask: expected sequences of the lengths of y, {lengths[1]}, found {lengths[2]}")
    if lengths[0] != lengths[1]:
        raise ValueError(f"record: u and y: expected sequences of equal lengths, found {lengths[0]} and {lengths[1]}")
    longest = max(lengths[0])
    _check("mask", masks, [(m == 0) | (m == 1) for m in masks], outputs, "True or False")
    measured = [m.astype(bool) & np.isfinite(one) for m, one in zip(masks, ys, strict=True)]
    _check("u", us, [np.isfinite(one) for one in us], inputs, "finite numbers")
    names_u, names_y = (tuple(Channel(str(name), unit) for name, unit in named.items()) for named in (inputs, outputs))
    unequal = min(lengths[0]) < longest
    info = RecordInfo(names_u, names_y, dt, "record", "arrays in memory", padded=unequal, start=start)
    u, y, mask = (np.stack([padded(one, longest) for one in part]) for part in (us, ys, measured))
    return record(u, y, info, mask)


def _sequences(name: str, signal: Any, channels: int) -> list[np.ndarray]:
    """Sequences `[time, channel]`; a single channel may come without its axis."""
    where = f"record: {name}"
    several = isinstance(signal, list | tuple)
    parts = [real_numbers(where, one) for one in signal] if several else real_numbers(where, signal)
    if isinstance(parts, np.ndarray):
        parts = [parts] if parts.ndim < 3 else list(parts)
    elif parts and parts[0].ndim == 0:  # a list of numbers
        parts = [np.asarray(parts)]
    parts = [one[:, None] if one.ndim == 1 and channels == 1 else one for one in parts]
    for one in parts:
        if one.ndim != 2 or one.shape[1] != channels or not len(one):
            raise ValueError(f"record: {name}: expected [time, {channels}] or sequences of it, found shape {one.shape}")
    if not parts:
        raise ValueError(f"record: {name}: expected at least one sequence, found none")
    return parts


def _check(
    name: str, parts: Sequence[np.ndarray], good: Sequence[np.ndarray], channels: Mapping[str, str], expected: str
) -> None:
    """Raises `ValueError` that names the first sample of a signal that is not good."""
    for k, (part, usable) in enumerate(zip(parts, good, strict=True)):
        if not usable.all():
            t, j = np.argwhere(~usable)[0]
            place = f"{'' if len(parts) == 1 else f'sequence {k}, '}sample {t} of {list(channels)[j]!r}"
            raise ValueError(f"record: {name}: expected {expected}, found {part[t, j]:g} in {place}")
