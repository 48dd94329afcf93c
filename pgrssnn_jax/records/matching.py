"""A record brought to the signals of a physics: names compared, units converted, the sample time checked."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from pgrssnn_jax.records.arguments import check_kind
from pgrssnn_jax.records.record import Channel, Record
from pgrssnn_jax.records.units import conversion

A_RECORD = "a record, as pg.record(u, y, ...) or pg.read_csv(file, physics) makes one"
_CLOCK = 0.01  # of the sample time: clocks are no better


@runtime_checkable
class Named(Protocol):
    """A signal of a physics, or a channel of a record."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...


def matched(record: Record, inputs: Sequence[Named], outputs: Sequence[Named], dt: float, *, where: str) -> Record:
    """The record with u and y in the units of these signals; a unit that is empty on either side is taken as equal.

    where: what the record is, for messages. Raises `ValueError` for other names or their order, for a unit that cannot
    be converted, and for a sample time that differs by more than 1 % from dt, s.
    """
    check_kind(where, record, Record, A_RECORD)
    info = record.info
    for what, channels, signals in (("inputs", info.inputs, inputs), ("outputs", info.outputs, outputs)):
        found, wanted = ([signal.name for signal in group] for group in (channels, signals))
        if found != wanted:
            raise ValueError(f"{where}: {what}: expected those of the physics, {wanted}, found {found}")
    if not math.isclose(info.dt, dt, rel_tol=_CLOCK):
        raise ValueError(f"{where}: dt: expected {dt:g} s, the sample time of the physics, found {info.dt:g} s")
    u, in_u = _converted(np.asarray(record.u), info.inputs, inputs, where)
    y, in_y = _converted(np.asarray(record.y), info.outputs, outputs, where)
    aside = record.validation
    if aside is not None:
        aside = matched(aside, inputs, outputs, dt, where=f"{where}: validation")
    return record._replace(u=u, y=y, info=replace(info, inputs=in_u, outputs=in_y), validation=aside)


def _converted(
    values: np.ndarray, channels: Sequence[Channel], signals: Sequence[Named], where: str
) -> tuple[np.ndarray, tuple[Channel, ...]]:
    factors = []
    for channel, signal in zip(channels, signals, strict=True):
        factor = conversion(channel.unit, signal.unit) if channel.unit and signal.unit else 1.0
        if factor is None:
            raise ValueError(
                f"{where}: {channel.name}: expected a unit that converts to {signal.unit}, found {channel.unit}"
            )
        factors.append(factor)
    named = tuple(Channel(s.name, s.unit or c.unit) for c, s in zip(channels, signals, strict=True))
    return (values if all(factor == 1.0 for factor in factors) else values * np.array(factors)), named
