"""Checks of input: arguments from the configuration, single values, arrays of numbers. Every failure is a `ValueError`
with one sentence."""

import inspect
import math
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

T = TypeVar("T")
_LONGEST = 80  # characters of a value shown in a message
_LONGEST_LINE = 100  # characters of another library's message


def call_with(function: Callable[..., T], group: Mapping[str, Any], where: str, **more: Any) -> T:
    """`function(**group, **more)` with every value of the group checked against the parameter's annotation.

    where: the group's name in the configuration, for messages, empty: the top level. Arguments of `more` that the
    function does not take are left out. Raises `ValueError` for an unknown key, for a missing one, and for a value of
    another type or outside its choices; the checks of `function` itself apply too.
    """
    prefix = f"{where}." if where else ""
    named = getattr(function, "func", function)  # functools.partial
    hints = get_type_hints(named.__init__ if inspect.isclass(named) else named)
    every = inspect.signature(function).parameters
    parameters = {name: p for name, p in every.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)}
    known = [name for name in parameters if name not in more]
    anything = any(p.kind is p.VAR_KEYWORD for p in every.values())
    for name in group:
        if name not in known and not anything:
            raise ValueError(f"{where or 'configuration'}: expected the keys {known}, found {name!r}")
    arguments = {name: _checked(value, hints.get(name, Any), f"{prefix}{name}") for name, value in group.items()}
    arguments |= {name: value for name, value in more.items() if name in parameters}
    for name, parameter in parameters.items():
        if parameter.default is parameter.empty and name not in arguments:
            raise ValueError(f"{prefix}{name}: expected a value, found none")
    return function(**arguments)


def _checked(value: Any, hint: Any, where: str) -> Any:
    value = value.item() if isinstance(value, np.generic) else value  # NumPy's numbers are numbers
    options = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    if any(_accepts(option, value) for option in options):
        return float(value) if float in options and isinstance(value, int) and int not in options else value
    raise ValueError(f"{where}: expected {_named(options)}, found {shown(value)}")


def _accepts(option: Any, value: Any) -> bool:
    if option is Any or isinstance(option, TypeVar):
        return True
    if get_origin(option) is Literal:
        return value in get_args(option)
    kind = get_origin(option) or option
    if isinstance(value, bool) and kind in (int, float):
        return False
    accepted = {float: (int, float), Sequence: (list, tuple), Path: (str, Path)}.get(kind, kind)
    return isinstance(value, accepted)


def _named(options: tuple[Any, ...]) -> str:
    words: list[str] = []
    for option in options:
        kind = get_origin(option) or option
        named = {type(None): "null", Sequence: "a list"}.get(kind, getattr(kind, "__name__", str(kind)))
        words += map(str, get_args(option)) if kind is Literal else [named]
    return " | ".join(words)


def check_count(name: str, value: int, least: int, most: int, what: str) -> None:
    """Raises `ValueError` unless least ≤ value ≤ most. name: the key in the configuration; what: what is counted."""
    if not least <= value <= most:
        expected = f"between {least} and {most} {what}" if most >= least else f"at least {least} {what} to choose from"
        raise ValueError(f"{name}: expected {expected}, found {value}")


def shown(value: Any) -> str:
    """A value as a message shows it: on one line, and short; of an array its shape, of what is no data its type."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of shape {value.shape} and type {value.dtype}"
    plain = isinstance(value, bool | int | float | complex | str | bytes | Path | np.ndarray | np.generic)
    if value is not None and not plain and type(value) not in (list, tuple, set, dict):
        return type(value).__name__
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "…"


def first_line(problem: BaseException) -> str:
    """The first line of another library's exception, at most 100 characters; its type where it has no text."""
    text = str(problem).strip()
    return text.splitlines()[0][:_LONGEST_LINE] if text else type(problem).__name__


def typed_line(problem: BaseException) -> str:
    """The same after the type of the exception."""
    return f"{type(problem).__name__}: {problem}".splitlines()[0]


def check_kind(where: str, value: Any, kind: Any, expected: str) -> None:
    """Raises `ValueError` unless value is an instance; expected: in words."""
    if not isinstance(value, kind):
        raise ValueError(f"{where}: expected {expected}, found {shown(value)}")


def positive(where: str, value: Any, what: str) -> float:
    """A finite number above 0; what: in words. Raises `ValueError` for anything else."""
    number = value if isinstance(value, int | float | np.number) and not isinstance(value, bool) else math.nan
    if isinstance(number, complex | np.complexfloating) or not 0 < number <= sys.float_info.max:
        raise ValueError(f"{where}: expected a positive {what}, found {shown(value)}")
    return float(number)


def real_numbers(where: str, value: Any) -> np.ndarray:
    """An array of real numbers in float64, of truth values as they are. Raises `ValueError` for rows of unequal length,
    for complex numbers, for dates, and for what is no number."""
    try:
        found = np.asarray(value)
    except (TypeError, ValueError):
        raise ValueError(f"{where}: expected an array of numbers, found rows of unequal length") from None
    if found.dtype.kind not in "biuf":
        raise ValueError(f"{where}: expected real numbers, found {_of_kind(found)}")
    return found if found.dtype == bool else found.astype(np.float64, copy=False)


def _of_kind(found: np.ndarray) -> str:
    """What an array that holds no real numbers holds."""
    kinds = {"U": "text", "S": "text", "T": "text", "c": "complex numbers", "M": "dates", "m": "times"}
    odd = next((one for one in found.flat if not isinstance(one, int | float)), None)
    return kinds.get(found.dtype.kind) or shown(odd)
