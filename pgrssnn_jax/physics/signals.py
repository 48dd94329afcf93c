"""What the numbers of a physics mean: its parameters and its signals, and the sentence for what is none of them."""

import sys
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.core import Tracer

from pgrssnn_jax.records.arguments import check_kind, real_numbers, shown


class Parameter(NamedTuple):
    """Meaning of one number of `Physics.params`.

    symbol, unit: for people; bounds: closed interval that fitting respects; neutral: the value at which the term has no
    influence (None if there is none); trainable: may fitting change it?
    """

    symbol: str = ""
    unit: str = ""
    bounds: tuple[float, float] = (-float("inf"), float("inf"))
    neutral: float | None = None
    trainable: bool = True


class Signal(NamedTuple):
    """One state, input or output.

    A state can be related to another signal, which gives it a scale and a value at the start.

    like: an output, whose scale and first value the state shares. rate_of: an output or another state, whose time
    derivative the state is: zero at the start, scaled by measured differences, or by a simulation where that signal is
    not measured (`measured_rate`). memory_of: an input that the state remembers: its scale, and its first value at the
    start; or a state whose past it holds: zero at the start, scaled by a simulation. range: data outside are refused,
    because they are in another unit (degrees for rad). start: value at the start of a record, where it is known.
    fit_initial: a lasting memory, whose start a fit must find like that of a state of the physics. inner: of a state
    that networks neither see nor correct, a covariance for example.
    """

    name: str
    unit: str = ""
    like: str | None = None
    rate_of: str | None = None
    range: tuple[float, float] = (-float("inf"), float("inf"))
    memory_of: str | None = None
    start: float | None = None
    fit_initial: bool = False
    inner: bool = False


_EACH = ", "


def unit_of_all(signals: Sequence[Signal]) -> str:
    """Of an array with one number per signal; where units differ, all of them in their order: `W, W, K`."""
    units = [signal.unit for signal in signals]
    return units[0] if len(set(units)) == 1 else _EACH.join(unit or "1" for unit in units)


def unit_at(unit: str, element: Sequence[int], shape: Sequence[int]) -> str:
    """Of one element of an array whose unit is given as by `unit_of_all`."""
    units = unit.split(_EACH)
    return units[element[0]] if element and len(units) == shape[0] > 1 else unit


def is_parameter(leaf: object) -> bool:
    return isinstance(leaf, Parameter)


def checked_signals(where: str, given: Any) -> tuple[Signal, ...]:
    """Signals as a tuple. Raises `ValueError` for what is none, for none at all, and for a name that is there twice."""
    found = () if isinstance(given, str | Signal) or not isinstance(given, Iterable) else tuple(given)
    if not found or not all(isinstance(s, Signal) and isinstance(s.name, str) and s.name for s in found):
        expected = 'signals with names, (pg.Signal("level", "V"),) say'
        raise ValueError(f"{where}: expected {expected}, found {shown(given)}")
    for signal in found:
        check_kind(f"{where}: {signal.name}: unit", signal.unit, str, "text, '' for none")
        checked_span(f"{where}: {signal.name}: range", signal.range)
        if signal.start is not None and not np.isfinite(real_numbers(f"{where}: {signal.name}: start", signal.start)):
            raise ValueError(f"{where}: {signal.name}: start: expected a finite number or None, found {signal.start}")
    names = [signal.name for signal in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"{where}: expected every name once, found {twice[0]!r} {len(twice)} times")
    return found


def checked_span(where: str, given: Any) -> tuple[float, float]:
    """A lower and an upper end. Raises `ValueError` for anything else."""
    ends = given if isinstance(given, tuple | list) and len(given) == 2 else (np.nan, np.nan)
    if not all(isinstance(end, int | float | np.number) for end in ends) or not ends[0] <= ends[1]:
        raise ValueError(f"{where}: expected (low, high) with low ≤ high, found {shown(given)}")
    most = sys.float_info.max  # which a whole number may exceed
    low, high = (np.inf if end > most else -np.inf if end < -most else float(end) for end in ends)
    return low, high


def written(value: Any) -> str:
    """A number or an array in four digits; a traced value as JAX prints it."""
    if isinstance(value, Tracer):
        return str(value)
    return f"{float(value):.4g}" if np.ndim(value) == 0 else f"[{', '.join(map(written, np.asarray(value)))}]"


def check_number(where: str, value: Any, meaning: Parameter) -> None:
    """Raises `ValueError` for a parameter that is no number, or outside its bounds, and for bounds that are none."""
    low, high = checked_span(f"{where}: bounds", meaning.bounds)
    numbers = real_numbers(where, value)
    if np.isnan(numbers).any():
        raise ValueError(f"{where}: expected numbers, found NaN")
    if not np.all((numbers >= low) & (numbers <= high)):
        found = " ".join(str(value).split())
        raise ValueError(f"{where}: expected {low:g} to {high:g} {meaning.unit}".rstrip() + f", found {found}")
