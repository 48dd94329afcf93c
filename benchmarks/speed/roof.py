"""What this machine can do at most, measured: how long a case would take if only one thing bounded it.

    products  operations / rate of a large matrix product
    memory    bytes that the program moves at least / rate of a sum of arrays that no cache holds
    chain     steps × smallest recurrent step that was found + stages × one multiply-add that waits for the one before

The longest of the three is the roof; the fraction that is reached is the roof over the time that was measured.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.acceleration.native import gru_layer, missing_kernels

from .timing import Program
from .work import Work

_LARGE = 1536  # rows and columns of a large product
_LONG = 12_000_000  # float64 numbers of an array, 96 MB
_STEPS = 2000


class Roof(NamedTuple):
    """ms that each bound alone takes, the fraction reached, and the bound."""

    products: float
    memory: float
    chain: float
    reached: float
    bound: str
    gflop: float


def roof(work: Work, program: Program, calls: int, measured_ms: float, cores: int, dtype: Any = np.float32) -> Roof:
    """Of one of the `calls` parts of a program, an epoch of a chunk say, which takes `measured_ms`."""
    rows, hidden = work.product
    limits = {
        "products": work.flops / product_rate(np.dtype(dtype).name) * 1e3,
        "memory": program.moved / calls / streaming_rate(cores) * 1e3,
        "chain": 1e3 * (work.steps * product_step(rows, hidden, np.dtype(dtype).name) + work.stages * smallest_step()),
    }
    bound = max(limits, key=lambda name: limits[name])
    return Roof(**limits, reached=limits[bound] / measured_ms, bound=bound, gflop=work.flops / 1e9)


def machine(cores: int) -> dict[str, float]:
    """The rates in GFLOP/s, GB/s and ns."""
    return {
        "matrix product float32, GFLOP/s": product_rate("float32") / 1e9,
        "matrix product float64, GFLOP/s": product_rate("float64") / 1e9,
        "streaming, GB/s": streaming_rate(cores) / 1e9,
        "multiply-add that waits, ns": smallest_step() * 1e9,
        **{
            f"product [{rows}, {n}] x [{n}, {3 * n}], GFLOP/s": 2 * rows * n * 3 * n / product_step(rows, n) / 1e9
            for rows, n in ((1, 16), (31, 16), (60, 64))
        },
    }


@cache
def product_rate(dtype: str) -> float:
    """FLOP/s of a large matrix product, the better of XLA's and NumPy's."""
    with jax.enable_x64(dtype == "float64"):
        a = np.random.default_rng(0).standard_normal((_LARGE, _LARGE)).astype(dtype)
        b = jnp.asarray(a)
        product = jax.jit(jnp.matmul)
        best = min(_best(lambda: product(b, b)), _best(lambda: a @ a))
    return 2 * _LARGE**3 / best


@cache
def streaming_rate(cores: int) -> float:
    """Bytes per second of a = b + c, a thread per core."""
    a, b, c = (np.zeros(_LONG) + i for i in range(3))
    parts = np.array_split(np.arange(_LONG), cores)
    spans = [slice(part[0], part[-1] + 1) for part in parts]
    with ThreadPoolExecutor(cores) as pool:
        best = _best(lambda: list(pool.map(lambda span: np.add(b[span], c[span], out=a[span]), spans)))
    return 3 * a.nbytes / best


@cache
def smallest_step() -> float:
    """Seconds of one multiply-add in a loop, whose factor comes from the one before."""

    @jax.jit
    def run(x: jax.Array, a: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, 100 * _STEPS, lambda _, x: x * a + a, x)

    return _best(partial(run, jnp.ones((1, 2)), jnp.full((1, 2), 0.5))) / (100 * _STEPS)


@cache
def product_step(rows: int, hidden: int, dtype: str = "float32") -> float:
    """Seconds of h ← three summed blocks of h W, W `[hidden, 3 hidden]`: the best of XLA's product, of sums, and of a
    whole step of the C++ GRU."""

    def product(h: jax.Array, w: jax.Array) -> jax.Array:
        return h @ w

    def sums(h: jax.Array, w: jax.Array) -> jax.Array:
        return (h[:, :, None] * w[None]).sum(1)

    def chained(multiply: Callable[..., jax.Array]) -> Any:
        def step(h: jax.Array, _: None, w: jax.Array) -> tuple[jax.Array, None]:
            return multiply(h, w).reshape(rows, 3, hidden).sum(1), None

        return jax.jit(lambda h, w: jax.lax.scan(partial(step, w=w), h, None, length=_STEPS)[0])

    with jax.enable_x64(dtype == "float64"):
        h, w = jnp.ones((rows, hidden), dtype), jnp.full((hidden, 3 * hidden), 0.3 / hidden, dtype)
        forms = (product, sums) if hidden <= 16 else (product,)
        calls = [partial(chained(form), h, w) for form in forms]
        if dtype == "float32" and missing_kernels() is None:
            none = jnp.zeros(3 * hidden)
            calls.append(partial(jax.jit(gru_layer), none[None], none, w, none, jnp.zeros((_STEPS, rows, 1)), h))
        return min(_best(call) for call in calls) / _STEPS


def _best(call: Callable[[], Any], repeats: int = 5) -> float:
    """The shortest of some calls after a first one, s: what the machine can do, whatever else is running."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - started)
    return min(times)
