"""Measuring calls side by side, compile time and memory apart."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

_TURN = 0.05  # seconds that a short call is repeated for
_COMPILED = "/jax/core/compile/backend_compile_duration"
_compilations: list[float] = []  # seconds of every compilation of this process, once `count_compilations` was called


class Program(NamedTuple):
    """A compiled program with its arguments. memory_mb: arguments, results and temporaries, MB; moved: bytes that it
    moves at least, every argument, result and temporary once written or read."""

    call: Callable[[], Any]
    compile_s: float
    compilations: int
    memory_mb: float
    moved: float


def interleaved(calls: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, list[float]]:
    """ms of every round. All calls once to warm up, then in turn (A B A B), so that a busy moment meets all of them.

    A short call is repeated within its turn: the first one finds the caches, and the other core, as the call before has
    left them.
    """
    for call in calls.values():
        jax.block_until_ready(call())
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            seconds = _seconds(call, 1)
            if seconds < _TURN:
                seconds = _seconds(call, math.ceil(_TURN / max(seconds, 1e-6)))
            times[name].append(1e3 * seconds)
    return times


def _seconds(call: Callable[[], Any], count: int) -> float:
    """Of one of `count` calls."""
    started = time.perf_counter()
    for _ in range(count):
        jax.block_until_ready(call())
    return (time.perf_counter() - started) / count


def spread(values: list[float]) -> list[float]:
    """Median and quartiles."""
    return [float(q) for q in np.quantile(values, [0.5, 0.25, 0.75])]


def compiled(function: Any, *arguments: Any) -> Program:
    """`function` (jitted), compiled for these arguments and bound to them."""
    before = count_compilations()
    started = time.perf_counter()
    call = function.lower(*arguments).compile()
    seconds = time.perf_counter() - started
    memory = call.memory_analysis()
    ends = memory.argument_size_in_bytes + memory.output_size_in_bytes - memory.alias_size_in_bytes
    temporary = memory.temp_size_in_bytes
    return Program(
        lambda: call(*arguments),
        seconds,
        count_compilations() - before,
        (ends + temporary) / 1e6,
        float(ends + 2 * temporary),
    )


def count_compilations() -> int:
    """How many programs this process has compiled since the first call."""
    if not _listening:
        jax.monitoring.register_event_duration_secs_listener(_listen)
        _listening.append(True)
    return len(_compilations)


_listening: list[bool] = []


def _listen(event: str, seconds: float, **_: Any) -> None:
    if event == _COMPILED:
        _compilations.append(seconds)
