"""Measured or simulated signals, and how they are cut into windows.

A `Record` holds the inputs and outputs of one or more sequences of equal length. Axis order is
`[member, sequence, time, channel]`; the member axis is present where many realisations are stacked.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import DTypeLike

from pgrssnn_jax.records.units import with_unit

Array = jax.Array | np.ndarray
Start = Literal["unknown", "rest", "shared"]


class Channel(NamedTuple):
    """One column of a record: its name and its unit."""

    name: str
    unit: str = ""


@jax.tree_util.register_static
@dataclass(frozen=True)
class RecordInfo:
    """What the numbers of a record mean; static, so that a record passes through `jit` and `vmap`.

    source: `file`, `download` or `simulated`; origin: where exactly, in words; padded: sequences of unequal length were
    filled up at their ends, after the last measured sample; begins: sample of the measured record at which it was cut;
    same_run: a validation record that is the training record with other samples measured (`splits.py`); start: what is
    known of x_0: nothing, at rest (zero), or shared by the training and the test record; benchmark: its name, or empty;
    bandwidth: Hz, cut-off of the low-pass filter that the signals passed, None where none is known.
    """

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    dt: float
    source: str
    origin: str = ""
    padded: bool = False
    begins: int = 0
    same_run: bool = False
    start: Start = "unknown"
    benchmark: str = ""
    bandwidth: float | None = None


class Record(NamedTuple):
    """Signals u_t, y_t for t = 1 .. T.

    u `[..., seq, time, u]` and y `[..., seq, time, y]` in the physical units of `info`; mask
    `[..., seq, time, y]` is True where y was measured (y is finite but meaningless elsewhere). validation: the record
    that training sets aside, where the data come with one.
    """

    u: Float[Array, "*members seq time u"]
    y: Float[Array, "*members seq time y"]
    mask: Bool[Array, "*members seq time y"]
    info: RecordInfo
    validation: "Record | None" = None

    def __repr__(self) -> str:
        """What a person asks of a record: how much, of what, and from where."""
        columns = [", ".join(with_unit(c.name, c.unit) for c in part) for part in (self.info.inputs, self.info.outputs)]
        aside = "" if self.validation is None else f"\n  validation: {_size(self.validation)}"
        source = f"\n  source: {self.info.source}" + (f": {self.info.origin}" if self.info.origin else "")
        return f"Record of {_size(self)}\n  inputs: {columns[0]}\n  outputs: {columns[1]}{aside}{source}"


def _size(whole: Record) -> str:
    *lead, n_seq, time, _ = np.shape(whole.u)
    counts = [*((count, "dataset") for count in lead), (n_seq, "sequence")]
    several = " of ".join(f"{count} {what}{'s' * (count > 1)}" for count, what in counts)
    return f"{several} of {time} samples, one every {whole.info.dt:g} s"


class Splits(NamedTuple):
    """The three records of an experiment; each with a leading axis over datasets (realisations)."""

    train: Record
    validation: Record
    test: Record


def record(u: Array, y: Array, info: RecordInfo, mask: Array | None = None) -> Record:
    """Builds a `Record` from u `[(seq,) time, u]` and y `[(seq,) time, y]`.

    A missing sequence axis is added. Raises `ValueError` if the shapes disagree with each other or
    with `info`, or if a value that counts is not finite.
    """
    u, y = np.asarray(u), np.asarray(y)
    if u.ndim == 2 and y.ndim == 2:
        u, y = u[None], y[None]
        mask = None if mask is None else np.asarray(mask)[None]
    if u.ndim != 3 or y.ndim != 3 or u.shape[:2] != y.shape[:2]:
        raise ValueError(
            "record: u and y: expected [sequence, time, channel] with equal sequences and times,"
            f" found {u.shape} and {y.shape}"
        )
    expected = (len(info.inputs), len(info.outputs))
    if (u.shape[2], y.shape[2]) != expected:
        raise ValueError(f"record: channels: expected {expected} (inputs, outputs), found {(u.shape[2], y.shape[2])}")
    u, y = (a if np.issubdtype(a.dtype, np.floating) else a.astype(np.float64) for a in (u, y))
    mask = np.ones((), bool) if mask is None else np.asarray(mask, bool)
    try:
        mask = np.broadcast_to(mask, y.shape)
    except ValueError:
        raise ValueError(f"record: mask: expected the shape of y, {y.shape}, found {mask.shape}") from None
    if not (np.isfinite(u).all() and np.isfinite(y[mask]).all()):
        raise ValueError("record: u and y: expected finite numbers wherever the mask is True, found NaN or infinity")
    return Record(u, np.where(mask, y, 0.0), mask, info)


def valid_mask(whole: Record) -> Bool[Array, "*members seq time"] | None:
    """True up to the last measured sample of every sequence; None where no sequence is padded."""
    if not whole.info.padded:
        return None
    measured = jnp.asarray(whole.mask).any(-1)
    return jnp.flip(jnp.cumsum(jnp.flip(measured, -1), -1), -1) > 0


def map_signals(whole: Record, function: Callable[[Array], Array]) -> Record:
    """The same function of u, y and mask."""
    return whole._replace(u=function(whole.u), y=function(whole.y), mask=function(whole.mask))


def windows(whole: Record, length: int) -> Record:
    """Cuts every sequence into consecutive windows of `length` samples; the incomplete rest is dropped."""
    time = whole.u.shape[-2]
    if not 1 <= length <= time:
        raise ValueError(f"windows: length: expected between 1 and the record's {time} samples, found {length}")
    count = time // length

    def cut(a: Array) -> Array:
        *lead, n_seq, _, channels = a.shape
        return a[..., : count * length, :].reshape(*lead, n_seq * count, length, channels)

    return map_signals(whole, cut)


def crop(whole: Record, start: int, stop: int) -> Record:
    """The samples `start <= t < stop` of every sequence."""
    cut = map_signals(whole, lambda signal: signal[..., start:stop, :])
    return cut._replace(info=replace(whole.info, begins=whole.info.begins + start))


def continues(first: Record, second: Record) -> bool:
    """Is the second record, of one sequence, what was measured right after the first?"""
    same = replace(first.info, begins=0) == replace(second.info, begins=0)
    after = second.info.begins == first.info.begins + first.u.shape[1]
    return len(first.u) == len(second.u) == 1 and same and after


def join(first: Record, second: Record) -> Record:
    """Two records of `[seq, time, channel]` as one: in time where the second continues the first, else as further
    sequences, padded at their ends to equal length."""
    if continues(first, second):
        u, y, mask = (np.concatenate(pair, 1) for pair in zip(first[:3], second[:3], strict=True))
        return Record(u, y, mask, first.info)
    longest = max(first.u.shape[1], second.u.shape[1])
    u, y, mask = (
        np.concatenate([padded(one, longest), padded(other, longest)])
        for one, other in zip(first[:3], second[:3], strict=True)
    )
    unequal = first.u.shape[1] != second.u.shape[1]
    return Record(u, y, mask, replace(first.info, padded=first.info.padded or second.info.padded or unequal))


def padded(signal: Array, time: int) -> np.ndarray:
    """A signal `[..., time, channel]` up to `time` samples: its last one repeated, or, in a mask, not measured."""
    signal = np.asarray(signal)
    rest = [*[(0, 0)] * (signal.ndim - 2), (0, time - signal.shape[-2]), (0, 0)]
    return np.pad(signal, rest) if signal.dtype == bool else np.pad(signal, rest, mode="edge")


def stack(records: Sequence[Record]) -> Record:
    """Stacks records of equal shape along a new leading axis."""
    shapes = {r.u.shape + r.y.shape for r in records}
    if len(shapes) != 1:
        raise ValueError(f"stack: records: expected equal shapes, found {sorted(shapes)}")
    u, y, mask = (np.stack(signals) for signals in zip(*(r[:3] for r in records), strict=True))
    return Record(u, y, mask, records[0].info)


def take(stacked: Record, index: int | np.ndarray) -> Record:
    """One record of a stack, or, with an array of indices, the stack of those records."""
    return map_signals(stacked, lambda signal: signal[index])


def cast(whole: Record, dtype: DTypeLike) -> Record:
    """The same record with u and y in `dtype`: the one place where the precision of data changes."""
    return whole._replace(u=np.asarray(whole.u, dtype), y=np.asarray(whole.y, dtype))
