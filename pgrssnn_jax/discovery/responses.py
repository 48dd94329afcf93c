"""How the free run of a model answers a small signal that enters one of its equations.

    δx_t = A_t δx_{t-1} + g_t w_t        δy_t = C_t δx + h_t w_t        (δx_t or δx_{t-1}, as outputs are timed)

A, C and B, D (by the input): derivatives along the free run itself. g: a unit vector of a state, or B; h: D, or a unit
vector of an output. So every nonparametric correction (`flexible.py`) is a set of columns, without a fit.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.acceleration.compiler import quick_jit
from pgrssnn_jax.discovery.code import Code
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.flexible import HISTORY, Where, nearness
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.problem import Problem, Signals

_AT_ONCE = 4_000_000  # numbers of one recursion held in memory


class Path(NamedTuple):
    """A free run and its derivatives. u, y; x: after each input; before: the same one sample earlier; a, b, c, d:
    A `[seq, time, x, x]`, B `[seq, time, x, u]`, C `[seq, time, y, x]`, D `[seq, time, y, u]`."""

    u: Float[np.ndarray, "seq time u"]
    y: Float[np.ndarray, "seq time y"]
    x: Float[np.ndarray, "seq time x"]
    before: Float[np.ndarray, "seq time x"]
    a: Float[np.ndarray, "seq time x x"]
    b: Float[np.ndarray, "seq time x u"]
    c: Float[np.ndarray, "seq time y x"]
    d: Float[np.ndarray, "seq time y u"]


class Response(NamedTuple):
    """low, high: reach of the signal that a correction depends on; columns: δy of each of its coefficients."""

    low: float
    high: float
    columns: Float[np.ndarray, "seq time y k"]


def path_of(problem: Problem, signals: Signals, guess: Guess) -> Path:
    """Of a model over the record."""
    y, x = simulate(problem, signals.u, guess.theta[None], guess.x0[None])
    before = np.concatenate([guess.x0[:, None], x[0, :, :-1]], 1)
    found = _derivatives(problem.code, guess.theta, before, x[0], signals.u)
    a, b, c, d = (np.nan_to_num(np.asarray(one), posinf=0.0, neginf=0.0) for one in found)
    return Path(signals.u, y[0], x[0], before, a, b, c, d)


@quick_jit(static_argnums=0)
def _derivatives(code: Code, theta: jax.Array, before: jax.Array, x: jax.Array, u: jax.Array) -> tuple[Any, ...]:
    def each(function: Any, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        own = jax.jacfwd(lambda x, u: function(code.unravel(theta), x, u), (0, 1))
        return jax.vmap(jax.vmap(own))(x, u)

    after = code.full.output_timing == "after_step"
    return (*each(code.full.step, before), *each(code.full.measure, x if after else before))


def correction_responses(problem: Problem, path: Path, families: Mapping[str, Where]) -> dict[str, Response]:
    """Of every correction whose signal moves, by name."""
    names, found = list(families), {}
    values = {name: _values(path, where) for name, where in families.items()}
    names = [name for name in names if np.ptp(values[name]) > 0.0 and np.isfinite(values[name]).all()]
    n_seq, time = path.u.shape[:2]
    room = max(1, _AT_ONCE // (n_seq * time * HISTORY))
    for i in range(0, len(names), room):
        part = {name: families[name] for name in names[i : i + room]}
        found.update(_together(problem, path, part, values))
    return found


def _values(path: Path, where: Where) -> Float[np.ndarray, "seq time"]:
    kind, index = where.by
    of = {"x": 0.5 * (path.before + path.x), "u": path.u, "y": path.y}[kind]
    return of[..., index]


def _together(
    problem: Problem, path: Path, families: Mapping[str, Where], values: Mapping[str, np.ndarray]
) -> dict[str, Response]:
    shapes = {name: _shapes(where, values[name]) for name, where in families.items()}
    most = max(shape.shape[-1] for shape in shapes.values())
    w = np.stack([np.pad(s, ((0, 0), (0, 0), (0, most - s.shape[-1]))) for s in shapes.values()], 2)
    g, h = (
        np.stack(both, 2) for both in zip(*(_entering(problem, path, one) for one in families.values()), strict=True)
    )
    moved = _driven(path, g, w, after=problem.physics.output_timing == "after_step")
    moved += h.swapaxes(2, 3)[..., None] * w[:, :, None]
    return {
        name: Response(
            float(values[name].min()), float(values[name].max()), moved[:, :, :, k, : shapes[name].shape[-1]]
        )
        for k, name in enumerate(families)
    }


def _driven(path: Path, g: np.ndarray, w: np.ndarray, *, after: bool) -> Float[np.ndarray, "seq time y family k"]:
    """C δx of signals w `[seq, time, family, k]` that enter along g `[seq, time, family, x]`."""
    n_seq, time, count, most = w.shape
    n_x, n_y = path.a.shape[-1], path.c.shape[2]
    x, found = np.zeros((n_seq, n_x, count * most)), np.empty((n_seq, time, n_y, count * most))
    for t in range(time):
        old = x
        entered = g[:, t].swapaxes(1, 2)[..., None] * w[:, t, None]
        x = path.a[:, t] @ old + entered.reshape(n_seq, n_x, -1)
        found[:, t] = path.c[:, t] @ (x if after else old)
    return found.reshape(n_seq, time, n_y, count, most)


def _shapes(where: Where, value: Float[np.ndarray, "seq time"]) -> Float[np.ndarray, "seq time k"]:
    """What each coefficient of a correction multiplies."""
    if where.kind != "history":
        return nearness(value, value.min(), value.max())
    past = np.concatenate([np.repeat(value[:, :1], HISTORY, 1), value], 1)
    time = value.shape[1]
    return np.stack([past[:, HISTORY - k : HISTORY - k + time] - value for k in range(1, HISTORY + 1)], -1)


def _entering(problem: Problem, path: Path, where: Where) -> tuple[np.ndarray, np.ndarray]:
    """g `[seq, time, x]` and h `[seq, time, y]`."""
    n_seq, time = path.u.shape[:2]
    g, h = np.zeros((n_seq, time, path.a.shape[-1])), np.zeros((n_seq, time, path.c.shape[2]))
    if where.kind == "state":
        g[..., where.target] = problem.physics.dt
    elif where.kind == "output":
        h[..., where.target] = 1.0
    else:
        g, h = path.b[..., where.target], path.d[..., where.target]
    return g, h
