"""Free runs of many fits (lanes) at once, and their derivatives beside them in one scan (forward mode).

    x_t = step(θ, x_{t-1}, u_t)        dx_t = ∂step/∂x dx_{t-1} + ∂step/∂θ dθ

Lanes are last in memory. One column of dx for every free number of θ and every unknown of the start.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.acceleration.scalars import Program
from pgrssnn_jax.discovery.code import Code, Function
from pgrssnn_jax.records.record import Array

Rows = jax.Array | tuple[jax.Array, ...]
Along = Callable[[Any, Any, jax.Array], tuple[Rows, Rows]]


def free_run(code: Code, u: jax.Array, theta: jax.Array, x0: jax.Array) -> tuple[jax.Array, jax.Array]:
    """y `[time, y, seq, lane]` and x `[time, x, seq, lane]` (state after u_t) from u `[time, u, seq]`, θ `[p, lane]`
    and x_0 `[x, seq, lane]`."""
    if code.compiled is not None:
        return code.compiled.run(u, theta, x0)
    step, measure = _batched(code.step), _batched(code.measure)
    after = _after(code)

    def body(x: jax.Array, u_t: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        new = step(theta, x, u_t)
        return new, (measure(theta, new if after else x, u_t), new)

    return jax.lax.scan(body, x0, u)[1]


def with_derivatives(
    code: Code, u: jax.Array, theta: jax.Array, x0: jax.Array, free: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """y `[time, y, seq, lane]` and dy `[time, y, k + s, seq, lane]`; free `[lane, k]`: positions in θ, -1 for none;
    s: unknowns of the start."""
    if code.compiled is not None:
        return code.compiled.along(u, theta, x0, free)
    after, (n_x, seq, lanes), k, starts = _after(code), x0.shape, free.shape[1], by_start(code)
    chosen = jnp.where(free.T[None] == jnp.arange(len(theta))[:, None, None], 1.0, 0.0)  # [p, k, lane]
    dtheta = jnp.pad(chosen, ((0, 0), (0, starts.shape[1]), (0, 0)))
    dx0 = jnp.concatenate([jnp.zeros((n_x, k)), starts], 1)[:, :, None, None]
    dx0 = jnp.broadcast_to(dx0, (*dx0.shape[:2], seq, lanes))
    if code.rows is None:
        step, measure = (_along_arrays(f, theta, dtheta) for f in (code.step, code.measure))
        begin: tuple[Rows, Rows] = (x0, dx0)
    else:
        step, measure = (_along_rows(program, theta, dtheta, dx0.shape[1:]) for program in code.rows)
        begin = (tuple(x0), tuple(dx0))

    def body(carry: tuple[Rows, Rows], u_t: jax.Array) -> tuple[tuple[Rows, Rows], tuple[jax.Array, jax.Array]]:
        new = step(*carry, u_t)
        y, dy = measure(*(new if after else carry), u_t)
        return new, (jnp.asarray(y), jnp.asarray(dy))

    return jax.lax.scan(body, begin, u)[1]


def _after(code: Code) -> bool:
    return code.full.output_timing == "after_step"


def _batched(function: Function) -> Function:
    """The same for θ `[p, lane]`, x `[x, seq, lane]`, u `[u, seq]`."""
    return jax.vmap(jax.vmap(function, (-1, -1, None), -1), (None, 1, 1), 1)


def _along_arrays(function: Function, theta: jax.Array, dtheta: jax.Array) -> Along:
    """By JAX's own derivatives: x `[x, seq, lane]`, dx `[x, d, seq, lane]`."""
    batched = _batched(function)

    def along(x: jax.Array, dx: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        value, push = jax.linearize(lambda t, x: batched(t, x, u), theta, x)
        return value, jax.vmap(push, (1, 1), 1)(dtheta, dx)

    return along


def _along_rows(program: Program, theta: jax.Array, dtheta: jax.Array, shape: tuple[int, ...]) -> Along:
    """By operations on numbers: one row of x `[seq, lane]` and of dx `[d, seq, lane]` per state. Rows are carried
    apart: joined in one array, the scan takes more than three times as long."""
    numbers, tangents = tuple(theta), tuple(dtheta[:, :, None])

    def along(x: Rows, dx: Rows, u: jax.Array) -> tuple[Rows, Rows]:
        found = program(*numbers, *x, *u[..., None], *tangents, *dx)
        half = len(found) // 2
        value, moved = found[:half], found[half:]
        return (
            tuple(jnp.broadcast_to(a, shape[1:]) for a in value),
            tuple(jnp.broadcast_to(a, shape) for a in moved),
        )

    return along


def by_start(code: Code) -> np.ndarray:
    """Which state `[x]` each unknown of the start `[s]` is, as a matrix of zeros and ones."""
    return np.eye(len(code.free_start))[:, code.free_start]


def time_first(a: Array) -> jax.Array:
    """`[seq, time, channel]` as `[time, channel, seq]`."""
    return jnp.transpose(jnp.asarray(a), (1, 2, 0))
