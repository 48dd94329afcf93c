"""The equations of a discovery as programs: the physics with every effect of the catalogue, written out if possible.

What is written out in numbers becomes a program of its own in C++ where there is a compiler, and else operations of
XLA, if they are few.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool

from pgrssnn_jax.acceleration.compiled_runs import FreeRuns, Sizes, compiled_free_runs
from pgrssnn_jax.acceleration.scalars import MOST, Program, written_out
from pgrssnn_jax.physics.base import Physics

Function = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]  # of θ, x, u
_MOST_COMPILED = 5000  # operations of a step: the compiler takes 8 s (two masses, 8 steps of RK4 a sample)


@dataclass(frozen=True, eq=False)
class Code:
    """What a compiled program depends on beside its arrays: the physics with every effect of the catalogue, θ as the
    tree of its params, which states' initial values are unknown, and step and measurement written out in numbers, where
    they can be. accelerate: compiled the quick way."""

    full: Physics
    unravel: Callable[[jax.Array], Any]
    free_start: Bool[np.ndarray, " x"]
    written_out: tuple[Program, Program] | None
    accelerate: bool = True

    @property
    def compiled(self) -> FreeRuns | None:
        """Free runs in C++, where the functions are written out and there is a compiler."""
        return found if isinstance(found := self._free_runs, FreeRuns) else None

    @property
    def rows(self) -> tuple[Program, Program] | None:
        """Step and measurement for XLA, where they are short enough."""
        short = self.written_out is not None and max(one.operations for one in self.written_out) <= MOST
        return self.written_out if short else None

    @property
    def uncompiled(self) -> str | None:
        """Why free runs are not compiled, where they were to be."""
        if self.accelerate and self.written_out is None:
            return f"the equations have operations that are not written out in numbers, or more than {_MOST_COMPILED}"
        return found if isinstance(found := self._free_runs, str) else None

    @cached_property
    def step(self) -> Function:
        """The step for θ `[p]`, x `[x]`, u `[u]`. All programs share what JAX traces of it."""
        return jax.jit(_on_vectors(self.full.step, self.unravel))

    @cached_property
    def measure(self) -> Function:
        """The same of the measurement."""
        return jax.jit(_on_vectors(self.full.measure, self.unravel))

    @cached_property
    def _free_runs(self) -> FreeRuns | str | None:
        if self.written_out is None or not self.accelerate:
            return None
        full, p = self.full, ravel_pytree(self.full.params)[0].size
        start = tuple(map(int, np.flatnonzero(self.free_start)))
        sizes = Sizes(p, len(full.states), len(full.inputs), len(full.outputs), start)
        return compiled_free_runs(*self.written_out, sizes, full.output_timing == "after_step")


def code_of(
    full: Physics, unravel: Callable[[jax.Array], Any], p: int, free_start: Bool[np.ndarray, " x"], accelerate: bool
) -> Code:
    """p: numbers of θ; accelerate: False without the tricks of `pgrssnn_jax.acceleration`."""
    return Code(full, unravel, free_start, _functions(full, unravel, p) if accelerate else None, accelerate)


def _functions(full: Physics, unravel: Callable[[jax.Array], Any], p: int) -> tuple[Program, Program] | None:
    """Step and measurement as operations on the numbers of θ, x and u."""
    sizes = (p, len(full.states), len(full.inputs))
    with jax.enable_x64(True):
        step = written_out(_on_vectors(full.step, unravel), sizes, 2, _MOST_COMPILED)
        measure = step and written_out(_on_vectors(full.measure, unravel), sizes, 2, _MOST_COMPILED)
    return (step, measure) if step and measure else None


def _on_vectors(function: Callable[..., jax.Array], unravel: Callable[[jax.Array], Any]) -> Function:
    return lambda theta, x, u: function(unravel(theta), x, u)
