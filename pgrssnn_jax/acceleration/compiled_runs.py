"""Free runs of a physics written out in numbers, and their derivatives, as a program of its own in C++.

XLA runs a scan over small states operation by operation through its runtime, and takes the derivative by every free
number apart. Compiled, one step keeps its numbers in registers, and the derivatives come from one backward pass. 24
free runs of the tanks with 13 derivatives apiece take 13 ms instead of 70 on one core, of a servo axis 26 instead of
172; the compiler takes 2 to 5 s, and XLA has less to compile.
"""

import ctypes
import hashlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.acceleration import build
from pgrssnn_jax.acceleration.scalar_code import Function, UnknownOperationError, function_of
from pgrssnn_jax.acceleration.scalars import Program

_TARGETS = ("free_run", "free_run_along", "free_run_normal")


class Sizes(NamedTuple):
    """Numbers of θ, states, inputs and outputs, and which states' initial values are unknown."""

    p: int
    x: int
    u: int
    y: int
    start: tuple[int, ...]


class FreeRuns(NamedTuple):
    """number: by which the kernel knows the compiled program, the same in every process."""

    number: int
    sizes: Sizes

    def run(
        self, u: Float[jax.Array, "time u seq"], theta: Float[jax.Array, "p lane"], x0: Float[jax.Array, "x seq lane"]
    ) -> tuple[Float[jax.Array, "time y seq lane"], Float[jax.Array, "time x seq lane"]]:
        """y, and the state after u_t."""
        time, rest = len(u), x0.shape[1:]
        shapes = [(time, self.sizes.y, *rest), (time, self.sizes.x, *rest)]
        y, x = self._call("free_run", shapes, u, theta, x0)
        return y, x

    def along(
        self,
        u: Float[jax.Array, "time u seq"],
        theta: Float[jax.Array, "p lane"],
        x0: Float[jax.Array, "x seq lane"],
        free: Int[jax.Array, "lane k"],
    ) -> tuple[Float[jax.Array, "time y seq lane"], Float[jax.Array, "time y d seq lane"]]:
        """y and dy; free: positions in θ, -1 for none; d: those, then the unknowns of the start."""
        time, rest, d = len(u), x0.shape[1:], free.shape[1] + len(self.sizes.start)
        shapes = [(time, self.sizes.y, *rest), (time, self.sizes.y, d, *rest)]
        y, dy = self._call("free_run_along", shapes, u, theta, x0, free.astype(jnp.int64))
        return y, dy

    def normal(
        self,
        u: Float[jax.Array, "time u seq"],
        theta: Float[jax.Array, "p lane"],
        x0: Float[jax.Array, "x seq lane"],
        free: Int[jax.Array, "lane k"],
        measured: Float[jax.Array, "time y seq"],
        weight: Float[jax.Array, "time y seq"],
    ) -> tuple[Float[jax.Array, "seq lane"], Float[jax.Array, "d seq lane"], Float[jax.Array, "d d seq lane"]]:
        """Σ e², Σ w dy e and Σ w dy w dyᵀ over the samples of every sequence, e = w (measured - y); d as in `along`.

        Weight 0: not measured. A derivative that is not finite counts as zero.
        """
        rest, d = x0.shape[1:], free.shape[1] + len(self.sizes.start)
        given = (u, theta, x0, free.astype(jnp.int64), measured, weight)
        squares, pull, matrix = self._call("free_run_normal", [rest, (d, *rest), (d, d, *rest)], *given)
        return squares, pull, matrix

    def _call(self, target: str, shapes: Sequence[tuple[int, ...]], *arrays: jax.Array) -> Sequence[jax.Array]:
        like = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
        call = jax.ffi.ffi_call(f"pgrssnn_{target}", like, vmap_method="broadcast_all")
        return call(*arrays, program=np.int64(self.number))


def compiled_free_runs(step: Program, measure: Program, sizes: Sizes, after_step: bool) -> FreeRuns | str:
    """Or why there are none, in one phrase: no compiler, or an operation that C++ is not written for."""
    try:
        text = _source(step, measure, sizes, after_step)
    except UnknownOperationError as problem:
        return str(problem)
    number = int.from_bytes(hashlib.sha256((text + build.headers()).encode()).digest()[:7])
    return _missing(number, text) or FreeRuns(number, sizes)


@cache
def _missing(number: int, text: str) -> str | None:
    """Compiles a physics and, at the same time, the kernel that is to know it."""
    kernel = _kernel()

    def use(library: ctypes.CDLL) -> None:
        table = ctypes.c_char.in_dll(library, "pgrssnn_free_runs")
        kernel.result().pgrssnn_register(ctypes.c_int64(number), ctypes.byref(table))

    return build.missing_library("physics", {"physics.cc": text}, ("-O2",), use)


@cache
def _kernel() -> Future[ctypes.CDLL]:
    return ThreadPoolExecutor(1).submit(_compiled_kernel)


def _compiled_kernel() -> ctypes.CDLL:
    """Raises `RuntimeError` where it is not to be had."""
    found: list[ctypes.CDLL] = []

    def use(library: ctypes.CDLL) -> None:
        build.register(library, _TARGETS)
        found.append(library)

    text = (build.KERNELS / "free_runs.cc").read_text()
    if missing := build.missing_library("free_runs", {"free_runs.cc": text}, ("-O1",), use):
        raise RuntimeError(missing)
    return found[0]


def _source(step: Program, measure: Program, sizes: Sizes, after_step: bool) -> str:
    """A struct of functions and tables, as `kernels/free_run/loop.h` takes it."""
    inputs = [f"{name}[{i}]" for name, n in (("theta", sizes.p), ("x", sizes.x), ("u", sizes.u)) for i in range(n)]
    functions = {name: function_of(program, inputs) for name, program in (("step", step), ("measure", measure))}
    constants = {
        "kP": sizes.p,
        "kX": sizes.x,
        "kU": sizes.u,
        "kY": sizes.y,
        "kStart": len(sizes.start),
        "kStep": len(functions["step"].entries),
        "kMeasure": len(functions["measure"].entries),
    }
    parts = [_functions(name, function) for name, function in functions.items()]
    start = ", ".join(map(str, sizes.start)) or "0"
    return f"""#include "free_run/loop.h"
namespace {{  // its names are also those of other programs in the process
struct Model {{
static constexpr int {", ".join(f"{name} = {value}" for name, value in constants.items())};
static constexpr bool kAfterStep = {str(after_step).lower()};
static int start(int s) {{ static const int of[] = {{{start}}}; return of[s]; }}
{"".join(parts)}}};
}}
extern "C" const FreeRuns pgrssnn_free_runs = {{
    {{Model::kP, Model::kX, Model::kU, Model::kY, Model::kStart}},
    run<Model>, derivatives<Model>, normal_equations<Model>}};
"""


def _functions(name: str, function: Function) -> str:
    """The values alone, and with the derivatives; statements that a function does not need are the compiler's."""
    entries: Mapping[tuple[int, int], str] = function.entries
    table = ", ".join(f"{{{i}, {j}}}" for i, j in entries) or "{0, 0}"
    lines = "\n".join(function.lines)
    values = "\n".join(f"value[{i}] = {text};" for i, text in enumerate(function.values))
    along = "\n".join(f"entry[{i}] = {text};" for i, text in enumerate(entries.values()))
    arguments = "const Vector* theta, const Vector* x, const Vector* u, Vector* value"
    return f"""
static const Entry* {name}_entries() {{ static const Entry table[] = {{{table}}}; return table; }}
static void {name}({arguments}) {{
{lines}
{values}
}}
static void {name}_along({arguments}, Vector* entry) {{
{lines}
{values}
{along}
}}
"""
