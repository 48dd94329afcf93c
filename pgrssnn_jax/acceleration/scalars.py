"""A function of small arrays written out in numbers, so that very many of it side by side run fast on a CPU.

Batched over fits, a state of a few entries becomes an array `[fit, entry]`, and XLA concatenates and scatters rows of
two numbers. Written out, every operation acts on one number of all fits, `[fit]`: 24 free runs of the tanks, with 14
derivatives apiece, take 25 ms instead of 47 (two cores). Where there is a compiler, `scalar_code.py` makes C++ of it.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import Jaxpr, Literal, Primitive

Array = jax.Array | np.ndarray
Numbers = Sequence[Any]
MOST = 700  # operations on numbers: beyond, XLA takes longer to compile them than is gained
# fmt: off
_EACH = frozenset({
    "abs", "acos", "acosh", "add", "add_any", "and", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "clamp",
    "convert_element_type", "copy", "cos", "cosh", "div", "eq", "erf", "erfc", "exp", "exp2", "expm1", "floor",
    "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p", "logistic", "lt", "max", "min", "mul", "ne",
    "neg", "not", "or", "pow", "rem", "round", "rsqrt", "select_n", "sign", "sin", "sinh", "sqrt", "square", "sub",
    "tan", "tanh", "xor",
})
# fmt: on
_REDUCED = {"reduce_sum": jax.lax.add_p, "reduce_max": jax.lax.max_p, "reduce_min": jax.lax.min_p}
_SCATTERED = {
    "scatter": None,
    "scatter-add": jax.lax.add_p,
    "scatter-max": jax.lax.max_p,
    "scatter-min": jax.lax.min_p,
    "scatter-mul": jax.lax.mul_p,
}


class Program(NamedTuple):
    """Operations on scalars, and the constants among them. It takes arrays of any shapes that broadcast. operations:
    how many the function has without its derivatives."""

    jaxpr: Jaxpr
    constants: Numbers
    operations: int

    def __call__(self, *numbers: Array) -> list[Array]:
        known = dict(zip([*self.jaxpr.constvars, *self.jaxpr.invars], [*self.constants, *numbers], strict=True))

        def read(v: Any) -> Any:
            return _literal(v) if isinstance(v, Literal) else known[v]

        for equation in self.jaxpr.eqns:
            operands = _broadcast([read(v) for v in equation.invars])
            known[equation.outvars[0]] = equation.primitive.bind(*operands, **equation.params)
        return [read(v) for v in self.jaxpr.outvars]


def written_out(
    function: Callable[..., jax.Array], sizes: Sequence[int], moving: int, most: int = MOST
) -> Program | None:
    """A function of vectors of these sizes, whose result is a vector, with its derivative along tangents of the first
    `moving` arguments:

        (*numbers, *tangents) -> (*values, *tangents of the values)

    None where it has operations that are unknown here (loops of unknown length, functions with derivatives of their
    own) or too many.
    """
    kind = jax.dtypes.canonicalize_dtype(float)
    whole = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct((n,), kind) for n in sizes))
    operations = _operations(whole.jaxpr)
    if operations > most:
        return None
    count, moved = sum(sizes), sum(sizes[:moving])

    def on_numbers(*numbers: jax.Array) -> tuple[jax.Array, ...]:
        rest = iter(numbers)
        vectors = [_Array([next(rest) for _ in range(n)], (n,)) for n in sizes]
        (found,) = _evaluate(whole.jaxpr, whole.consts, vectors)
        return tuple(jnp.asarray(number, kind) for number in found.numbers)

    def along(*both: jax.Array) -> tuple[jax.Array, ...]:
        numbers, tangents = both[:count], both[count:]
        values, changes = jax.jvp(lambda *first: on_numbers(*first, *numbers[moved:]), numbers[:moved], tangents)
        return (*values, *changes)

    try:
        program = jax.make_jaxpr(along)(*[jax.ShapeDtypeStruct((), kind)] * (count + moved))
    except _UnknownError:
        return None
    jaxpr = program.jaxpr.replace(eqns=_needed(program.jaxpr))
    if any(equation.primitive.name not in _EACH for equation in jaxpr.eqns):
        return None
    return Program(jaxpr, program.consts, operations)


def _needed(jaxpr: Jaxpr) -> list[Any]:
    """Equations on which the results depend: nobody asks for the count of a loop."""
    wanted, kept = {v for v in jaxpr.outvars if not isinstance(v, Literal)}, []
    for equation in reversed(jaxpr.eqns):
        if wanted.intersection(equation.outvars):
            kept.append(equation)
            wanted.update(v for v in equation.invars if not isinstance(v, Literal))
    return kept[::-1]


class _UnknownError(Exception):
    """An operation that is not written out here."""


class _Array(NamedTuple):
    """An array as a list of its numbers, last axis fastest."""

    numbers: Numbers
    shape: tuple[int, ...]

    @property
    def places(self) -> np.ndarray:
        return np.arange(len(self.numbers)).reshape(self.shape)

    def at(self, places: Any) -> "_Array":
        places = np.asarray(places)
        return _Array([self.numbers[i] for i in places.ravel()], places.shape)


def _evaluate(jaxpr: Jaxpr, constants: Sequence[Any], arguments: Sequence[_Array]) -> list[_Array]:
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*map(_constant, constants), *arguments], strict=True))

    def read(v: Any) -> _Array:
        return _constant(_literal(v)) if isinstance(v, Literal) else known[v]

    for equation in jaxpr.eqns:
        found = _apply(equation.primitive, equation.params, [read(v) for v in equation.invars])
        known.update(zip(equation.outvars, found, strict=True))
    return [read(v) for v in jaxpr.outvars]


def _apply(primitive: Primitive, params: dict[str, Any], given: list[_Array]) -> list[_Array]:
    name = primitive.name
    if name == "jit":
        return _evaluate(params["jaxpr"].jaxpr, params["jaxpr"].consts, given)
    if name == "scan":
        return _looped(params, given)
    if name in _EACH:
        shape = np.broadcast_shapes(*(a.shape for a in given))
        each = zip(*(a.at(np.broadcast_to(a.places, shape)).numbers for a in given), strict=True)
        return [_Array([primitive.bind(*numbers, **params) for numbers in each], shape)]
    if name in ("concatenate", "stack"):
        return [_joined(name, params, given)]
    if name in _SCATTERED:
        return [_scattered(_SCATTERED[name], params, *given)]
    if name == "dot_general":
        return [_product(params, *given)]
    if name in _REDUCED:
        return [_reduced(_REDUCED[name], given[0], params["axes"])]
    if name == "iota":
        shape, axis = params["shape"], params["dimension"]
        return [_constant(np.indices(shape)[axis].astype(params["dtype"]))]
    return [given[0].at(places) for places in _rearranged(name, params, given[0])] if given else _unknown(name)


def _looped(params: dict[str, Any], given: list[_Array]) -> list[_Array]:
    """A loop of known length, one round after the other: the sub-steps of an integrator."""
    consts, carried = params["num_consts"], params["num_consts"] + params["num_carry"]
    body = params["jaxpr"]
    if len(given) != carried or len(body.jaxpr.outvars) != params["num_carry"]:
        _unknown("scan")  # over arrays
    state = given[consts:]
    for _ in range(params["length"]):
        state = _evaluate(body.jaxpr, body.consts, [*given[:consts], *state])
    return state


def _rearranged(name: str, params: dict[str, Any], a: _Array) -> Sequence[np.ndarray]:
    """Where the numbers of the results stand in the array."""
    places = a.places
    if name == "reshape":
        return [places.reshape(params["new_sizes"])]
    if name == "squeeze":
        return [np.squeeze(places, tuple(params["dimensions"]))]
    if name == "transpose":
        return [np.transpose(places, params["permutation"])]
    if name == "rev":
        return [np.flip(places, params["dimensions"])]
    if name == "slice":
        strides = params["strides"] or [1] * places.ndim
        return [places[tuple(map(slice, params["start_indices"], params["limit_indices"], strides))]]
    if name == "split":
        return np.split(places, np.cumsum(params["sizes"])[:-1], params["axis"])
    if name == "broadcast_in_dim":
        shape = np.ones(len(params["shape"]), int)
        shape[list(params["broadcast_dimensions"])] = a.shape
        return [np.broadcast_to(places.reshape(shape), params["shape"])]
    return _unknown(name)


def _joined(name: str, params: dict[str, Any], given: Sequence[_Array]) -> _Array:
    offsets = np.cumsum([0, *(len(a.numbers) for a in given)])
    places = [a.places + offset for a, offset in zip(given, offsets, strict=False)]
    joined = np.concatenate(places, params["dimension"]) if name == "concatenate" else np.stack(places, params["axis"])
    return _Array([number for a in given for number in a.numbers], (offsets[-1],)).at(joined)


def _scattered(combine: Primitive | None, params: dict[str, Any], into: _Array, where: _Array, given: _Array) -> _Array:
    """`x.at[i].add(v)`, `x.at[i:j].add(v)` and their kin, for a vector and places that are known."""
    vectors = len(into.shape) == 1 and len(given.shape) <= 1
    if not vectors or any(isinstance(i, Tracer) for i in where.numbers):
        _unknown("scatter")
    places = [int(i) for i in where.numbers]
    if params["dimension_numbers"].update_window_dims:  # of a slice the first place alone, and none where that is 0
        first = places[0] if places else 0
        places = range(first, first + len(given.numbers))
    if any(not 0 <= i < len(into.numbers) for i in places):
        _unknown("scatter")
    new = list(into.numbers)
    for i, number in zip(places, given.numbers, strict=True):
        new[i] = number if combine is None else combine.bind(new[i], number)
    return _Array(new, into.shape)


def _product(params: dict[str, Any], a: _Array, b: _Array) -> _Array:
    """Sums of products over one axis or more; axes of a batch are unknown here."""
    (over_a, over_b), (batch, _) = params["dimension_numbers"]
    if batch:
        _unknown("dot_general")
    left, right = (np.moveaxis(m.places, over, range(len(over))) for m, over in ((a, over_a), (b, over_b)))
    shape = (*left.shape[len(over_a) :], *right.shape[len(over_b) :])
    terms = np.prod(left.shape[: len(over_a)], dtype=int)
    left, right = left.reshape(terms, -1), right.reshape(terms, -1)

    def entry(i: int, j: int) -> Any:
        products = (
            jax.lax.mul_p.bind(a.numbers[m], b.numbers[n]) for m, n in zip(left[:, i], right[:, j], strict=True)
        )
        return reduce(jax.lax.add_p.bind, products)

    return _Array([entry(i, j) for i in range(left.shape[1]) for j in range(right.shape[1])], shape)


def _reduced(combine: Primitive, a: _Array, axes: Sequence[int]) -> _Array:
    rows = np.moveaxis(a.places, axes, range(len(axes)))
    shape = rows.shape[len(axes) :]
    columns = rows.reshape(-1, int(np.prod(shape))).T
    return _Array([reduce(combine.bind, a.at(column).numbers) for column in columns], shape)


def _broadcast(operands: Sequence[Any]) -> Iterator[Any]:
    shape = np.broadcast_shapes(*map(np.shape, operands))
    for a in operands:
        axes = tuple(range(len(shape) - np.ndim(a), len(shape)))
        yield a if np.shape(a) == shape else jax.lax.broadcast_in_dim(a, shape, axes)


def _literal(v: Any) -> np.ndarray:
    return np.asarray(v.val, v.aval.dtype)


def _constant(value: Any) -> _Array:
    value = np.asarray(value)
    return _Array(list(value.ravel()), value.shape)


def _operations(jaxpr: Any) -> int:
    """On numbers, of which a function consists."""
    return sum(map(_operations_of, jaxpr.eqns))


def _operations_of(equation: Any) -> int:
    name, params = equation.primitive.name, equation.params
    if name == "jit":
        return _operations(params["jaxpr"].jaxpr)
    if name == "scan":
        return params["length"] * _operations(params["jaxpr"].jaxpr)
    if name == "dot_general":
        (over, _), _ = params["dimension_numbers"]
        return equation.outvars[0].aval.size * int(np.prod([equation.invars[0].aval.shape[i] for i in over]))
    if name in _REDUCED:
        return equation.invars[0].aval.size
    return equation.outvars[0].aval.size if name in _EACH else 0


def _unknown(name: str) -> Any:
    raise _UnknownError(name)
