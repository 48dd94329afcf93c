"""C++ of a function written out in numbers (`scalars.py`), with its derivatives by reverse accumulation.

    value_i = f_i(θ, x, u)        entry_ij = ∂f_i / ∂(θ, x)_j,  where it is not zero whatever the numbers are

Every operation of `scalars.py` has its text here, on vectors of lanes (`kernels/free_run/numbers.h`). The derivative of
one value costs as much as the value itself, and most values depend on few numbers; the forward derivatives of
`scalars.Program` are taken once for every free number instead.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jax.extend.core import Literal

from pgrssnn_jax.acceleration.scalars import Program

ONE, ZERO = "splat(1.0)", "splat(0.0)"
# fmt: off
_INFIX = {
    "add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/", "and": "&", "or": "|", "xor": "^",
    "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!=",
}
# fmt: on
_CALLED = {"rem": "fmod", "max": "greater", "min": "smaller", "abs": "size_of"}  # others have the same name


class Function(NamedTuple):
    """lines: statements; values: an expression for each; entries: expressions of the derivatives by row and column."""

    lines: Sequence[str]
    values: Sequence[str]
    entries: Mapping[tuple[int, int], str]


class UnknownOperationError(Exception):
    """An operation, or a type of numbers, without a text here."""

    def __init__(self, what: str) -> None:
        super().__init__(f"no C++ is written for {what}")


def function_of(program: Program, inputs: Sequence[str]) -> Function:
    """inputs: C++ expressions of the numbers. Raises `UnknownOperationError`."""
    text, jaxpr = _Text(), program.jaxpr
    known = dict(zip(jaxpr.constvars, map(_constant, program.constants), strict=True))
    known.update(zip(jaxpr.invars, map(text.put, inputs), strict=False))
    tangents = list(jaxpr.invars[len(inputs) :])
    linear, moving = [], set(tangents)

    def read(v: Any) -> str:
        return _constant(v.val) if isinstance(v, Literal) else known[v]

    for equation in jaxpr.eqns:
        if any(not isinstance(v, Literal) and v in moving for v in equation.invars):
            moving.add(equation.outvars[0])
            linear.append(equation)
        else:
            known[equation.outvars[0]] = _written(text, equation, [read(v) for v in equation.invars])
    count = len(jaxpr.outvars) // 2
    values = [read(v) for v in jaxpr.outvars[:count]]
    entries: dict[tuple[int, int], str] = {}
    for i, out in enumerate(jaxpr.outvars[count:]):
        if not isinstance(out, Literal) and out in moving:
            pulled = _pulled_back(text, linear, moving, out, read)
            entries.update({(i, j): pulled[v] for j, v in enumerate(tangents) if v in pulled})
    return Function(text.lines, values, entries)


class _Text:
    """Statements in order, the same expression once. guarded: derivatives that a choice may have made zero."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.guarded: set[str] = set()
        self._known: dict[str, str] = {}

    def put(self, expression: str, kind: str = "Vector", guarded: bool = False) -> str:
        if expression not in self._known:
            name = f"v{len(self._known)}"
            self._known[expression] = name
            self.lines.append(f"const {kind} {name} = {expression};")
            if guarded:
                self.guarded.add(name)
        return self._known[expression]


def _written(text: _Text, equation: Any, operands: Sequence[str]) -> str:
    name, params = equation.primitive.name, equation.params
    kind = _kind(equation.outvars[0].aval)
    if name in _INFIX:
        return text.put(f"{operands[0]} {_INFIX[name]} {operands[1]}", kind)
    if name in ("neg", "not"):
        return text.put(f"{'-' if name == 'neg' else '~'}{operands[0]}", kind)
    if name == "copy":
        return operands[0]
    if name == "select_n" and len(operands) == 3:
        which, otherwise, chosen = operands
        return text.put(f"{which} ? {chosen} : {otherwise}", kind)
    if name == "clamp":
        low, value, high = operands
        return text.put(f"smaller(greater({value}, {low}), {high})")
    if name == "integer_pow":
        return text.put(f"power<{params['y']}>({operands[0]})")
    if name == "convert_element_type":
        return _converted(text, _kind(equation.invars[0].aval), kind, operands[0])
    if name == "round":
        name = "rint" if int(params["rounding_method"]) == 1 else "round"
    if name == "select_n":
        raise UnknownOperationError(name)
    return text.put(f"{_CALLED.get(name, name)}({', '.join(operands)})", kind)


def _converted(text: _Text, old: str, new: str, operand: str) -> str:
    if old == new:
        return operand
    return text.put(f"{operand} ? {ONE} : {ZERO}") if new == "Vector" else text.put(f"{operand} != {ZERO}", new)


def _kind(aval: Any) -> str:
    if aval.dtype == np.bool_:
        return "Mask"
    if aval.dtype == np.float64:
        return "Vector"
    raise UnknownOperationError(f"numbers of type {aval.dtype}")


def _constant(value: Any) -> str:
    value = np.asarray(value)
    if value.dtype == np.bool_:
        return "kTrue" if value else "kFalse"
    number = float(value)
    if np.isfinite(number):
        return f"splat({number.hex()})"
    return "splat(NAN)" if np.isnan(number) else f"splat({'-' if number < 0 else ''}INFINITY)"


def _pulled_back(
    text: _Text, linear: Sequence[Any], moving: set[Any], out: Any, read: Callable[[Any], str]
) -> dict[Any, str]:
    """Derivatives of one value by all that it is a linear function of, from the last equation to the first."""
    found: dict[Any, str] = {out: ONE}

    def give(v: Any, derivative: str) -> None:
        if isinstance(v, Literal) or v not in moving:
            return
        if v in found:
            guarded = found[v] in text.guarded or derivative in text.guarded
            derivative = text.put(f"{found[v]} + {derivative}", guarded=guarded)
        found[v] = derivative

    for equation in reversed(linear):
        if (pulled := found.pop(equation.outvars[0], None)) is not None:
            for v, derivative in _transposed(text, equation, moving, pulled, read):
                give(v, derivative)
    return found


def _transposed(
    text: _Text, equation: Any, moving: set[Any], pulled: str, read: Callable[[Any], str]
) -> list[tuple[Any, str]]:
    """What each operand of a linear operation gets. A choice makes derivatives zero that an infinite factor must not
    turn into NaN: where it was taken, the branch that was not is no part of the function."""
    name, operands, guarded = equation.primitive.name, equation.invars, pulled in text.guarded
    if name in ("add", "add_any", "copy", "convert_element_type"):
        return [(v, pulled) for v in operands]
    if name in ("neg", "sub"):
        minus = text.put(f"-{pulled}", guarded=guarded)
        return [(operands[-1], minus), *((v, pulled) for v in operands[:-1])]
    if name == "mul":
        first = not isinstance(operands[0], Literal) and operands[0] in moving
        v, factor = operands if first else operands[::-1]
        return [(v, _times(text, pulled, read(factor)))]
    if name == "div":
        by = read(operands[1])
        return [(operands[0], text.put(f"over({pulled}, {by})" if guarded else f"{pulled} / {by}", guarded=guarded))]
    if name == "select_n" and len(operands) == 3:
        which, (otherwise, chosen) = read(operands[0]), operands[1:]
        return [
            (chosen, text.put(f"{which} ? {pulled} : {ZERO}", guarded=True)),
            (otherwise, text.put(f"{which} ? {ZERO} : {pulled}", guarded=True)),
        ]
    raise UnknownOperationError(f"the derivative of {name}")


def _times(text: _Text, pulled: str, factor: str) -> str:
    if pulled == ONE:
        return factor
    if pulled in text.guarded:
        return text.put(f"times({pulled}, {factor})", guarded=True)
    return text.put(f"{pulled} * {factor}")
