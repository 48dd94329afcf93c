"""Compiler options for programs that take longer to compile than to run.

XLA's fusion emitters for CPUs take a third of the time that a rollout with derivatives takes to compile, and what they
write is about as fast: 0.23 s against 0.26 s of the older ones for 48 fits of the tanks, 0.28 s against 0.24 s for
corrections without a name (two cores). The older emitters are asked for where this XLA still has them. For programs
written out in numbers (`acceleration/scalars.py`) they are no match: 58 ms against 25.
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

import jax

_OLDER_EMITTERS: dict[str, int | bool] = {"xla_cpu_use_fusion_emitters": False}


def quick_jit(
    unless: Callable[..., bool] = lambda *_: False, **options: Any
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """`jax.jit` with these options, compiled in about two thirds of the time; `unless` says of the arguments whether
    it is as usual. JAX is asked what it knows at the first call, not when the module is imported: the devices may still
    have to be set."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @cache
        def compiled(usual: bool) -> Callable[..., Any]:
            return jax.jit(function, compiler_options=None if usual else _quick(), **options)

        @wraps(function)
        def call(*args: Any) -> Any:
            return compiled(unless(*args))(*args)

        return call

    return decorate


def optimised(level: int | None) -> dict[str, int | bool] | None:
    """Options of `jax.jit` for a level of machine code, 0 to 3; None: as the compiler chooses."""
    if level is None:
        return None
    options: dict[str, int | bool] = {"xla_backend_optimization_level": level}
    return {**options, **(_quick() or {})} if level == 0 else options


@cache
def _quick() -> dict[str, int | bool] | None:
    return _OLDER_EMITTERS if known(_OLDER_EMITTERS) else None


def known(options: dict[str, int | bool]) -> bool:
    """Has this XLA such options?"""
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError as error:
        if "No such compile option" in str(error):
            return False
        raise
    return True
