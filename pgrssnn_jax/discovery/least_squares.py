"""Simulation-error least squares, many fits at once.

    minimise over θ_A, x_0   Σ_t ‖w_t (y_t - ŷ_t(θ, x_0))‖² + prior        A: the free numbers of this fit

Levenberg-Marquardt (`marquardt.py`) with the sensitivities of the free run beside it in one scan (forward mode). Fits
(lanes) differ in which numbers are free, where they start and which fold they leave out; all run in one program, lanes
last in memory. Devices share the lanes, or the sequences of a single lane.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.acceleration.compiler import quick_jit
from pgrssnn_jax.acceleration.devices import filled_up, over_devices, sum_over_devices
from pgrssnn_jax.discovery.code import Code
from pgrssnn_jax.discovery.free_runs import free_run, time_first, with_derivatives
from pgrssnn_jax.discovery.marquardt import Limits, Task, begin, step
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.records.record import Array

_FEW = 4  # lanes per device: fewer take as long however they are compiled
_SHARED = 4  # sequences per device, at least, where devices share those of one lane


class Lanes(NamedTuple):
    """theta `[lane, p]` and x0 `[lane, seq, x]`: starting values; free `[lane, k]`: positions in θ that are fitted, -1
    for an unused place."""

    theta: Float[Array, "lane p"]
    x0: Float[Array, "lane seq x"]
    free: Int[Array, "lane k"]


class Fitted(NamedTuple):
    """cost: what is minimised, with the prior; inf where the simulation is not finite."""

    theta: Float[Array, "lane p"]
    x0: Float[Array, "lane seq x"]
    cost: Float[Array, " lane"]


def fit(
    problem: Problem,
    signals: Signals,
    lanes: Lanes,
    *,
    steps: int,
    tolerance: float = 1e-6,
    devices: int = 1,
) -> Fitted:
    """At most `steps` steps per lane; a lane rests when its cost falls by less than `tolerance`, relative. Double
    precision."""
    lanes, stop_rule = Lanes(*map(np.asarray, lanes)), StopRule(jnp.asarray(steps), jnp.asarray(tolerance))
    return Fitted(*map(np.asarray, _fit(problem.code, devices, _limits(problem), stop_rule, lanes, signals)))


def sensitivity(problem: Problem, signals: Signals, lanes: Lanes, devices: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """y `[lane, seq, time, y]`, and its derivatives by the free numbers and x_0, `[lane, seq, time, y, k + s]`;
    s: unknowns of the start."""
    y, dy = _sensitivity(problem.code, devices, Lanes(*map(np.asarray, lanes)), signals.u)
    return np.asarray(y), np.asarray(dy)


def simulate(problem: Problem, u: Array, theta: Array, x0: Array) -> tuple[np.ndarray, np.ndarray]:
    """Free runs: y `[lane, seq, time, y]` and x `[lane, seq, time, x]` (state after u_t) for θ `[lane, p]` and x_0
    `[lane, seq, x]`; u `[seq, time, u]`."""
    y, x = _simulate(problem.code, jnp.asarray(u), jnp.asarray(theta), jnp.asarray(x0))
    return np.asarray(y), np.asarray(x)


class StopRule(NamedTuple):
    """Steps at most, and the relative fall of the cost below which a lane rests."""

    steps: Int[Array, ""]
    tolerance: Float[Array, ""]


def _limits(problem: Problem) -> Limits:
    return Limits(problem.low, problem.high, problem.theta, problem.precision)


def _lanes_last(lanes: Lanes) -> tuple[jax.Array, jax.Array, jax.Array]:
    return jnp.asarray(lanes.theta).T, jnp.transpose(jnp.asarray(lanes.x0), (2, 1, 0)), jnp.asarray(lanes.free)


def _worth_it(code: Code, devices: int, limits: Limits, rule: StopRule, lanes: Lanes, *_: object) -> bool:
    """Will a program of so many lanes, written out in numbers, make up for the time that it takes to compile well?"""
    if not code.accelerate:
        return True
    return code.rows is not None and code.compiled is None and len(lanes.theta) > _FEW * devices


def _shares(lanes: Lanes, devices: int) -> bool:
    """Do devices share the sequences of a single lane?"""
    return devices > 1 and len(lanes.theta) == 1 and lanes.x0.shape[1] >= _SHARED * devices


@partial(jax.jit, static_argnums=0)
def _simulate(code: Code, u: jax.Array, theta: jax.Array, x0: jax.Array) -> tuple[jax.Array, jax.Array]:
    y, x = free_run(code, time_first(u), theta.T, jnp.transpose(x0, (2, 1, 0)))
    return jnp.transpose(y, (3, 2, 0, 1)), jnp.transpose(x, (3, 2, 0, 1))


@quick_jit(lambda code, *_: not code.accelerate, static_argnums=(0, 1))
def _sensitivity(code: Code, devices: int, lanes: Lanes, u: jax.Array) -> tuple[jax.Array, jax.Array]:
    def of_sequences(u: jax.Array, x0: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Sequences come first: u `[seq, time, u]`, x0 `[seq, lane, x]`."""
        own = lanes._replace(x0=jnp.swapaxes(x0, 0, 1))
        y, dy = with_derivatives(code, time_first(u), *_lanes_last(own))
        return jnp.transpose(y, (2, 3, 0, 1)), jnp.transpose(dy, (3, 4, 0, 1, 2))

    shared = over_devices(of_sequences, devices if _shares(lanes, devices) else 1)
    y, dy = shared(jnp.asarray(u), jnp.swapaxes(jnp.asarray(lanes.x0), 0, 1))
    return jnp.swapaxes(y, 0, 1), jnp.swapaxes(dy, 0, 1)


@quick_jit(_worth_it, static_argnums=(0, 1))
def _fit(
    code: Code, devices: int, limits: Limits, stop_rule: StopRule, lanes: Lanes, signals: Signals
) -> tuple[jax.Array, ...]:
    def of_lanes(lanes: Lanes) -> tuple[jax.Array, ...]:
        return _fit_lanes(code, limits, stop_rule, lanes, signals)

    def of_sequences(x0: jax.Array, signals: Signals) -> tuple[jax.Array, ...]:
        """Sequences come first; every device ends with the same θ."""
        own = lanes._replace(x0=x0[None])
        theta, x0, cost = _fit_lanes(code, limits, stop_rule, own, signals, sum_over_devices)
        return x0[0], jnp.repeat(theta, len(x0[0]), 0), jnp.repeat(cost, len(x0[0]), 0)

    if not _shares(lanes, devices):
        return over_devices(of_lanes, devices)(lanes)
    count = len(signals.u)
    x0, theta, cost = over_devices(of_sequences, devices)(*_without_weight(lanes.x0[0], signals, devices))
    return theta[:1], x0[None, :count], cost[:1]


def _without_weight(x0: Array, signals: Signals, devices: int) -> tuple[Any, Any]:
    """Sequences filled up to a multiple of the devices; those added have no weight."""
    count = len(x0)
    x0, filled = filled_up((x0, signals), devices)
    added = np.arange(len(x0)) >= count
    weight, precision = (
        jnp.where(jnp.expand_dims(added, range(1, a.ndim)), 0.0, a) for a in (filled.weight, filled.precision)
    )
    return x0, filled._replace(weight=weight, precision=precision)


def _fit_lanes(
    code: Code,
    limits: Limits,
    stop_rule: StopRule,
    lanes: Lanes,
    signals: Signals,
    total: Callable[[jax.Array], jax.Array] = lambda value: value,
) -> tuple[jax.Array, ...]:
    u, y, weight = (time_first(a) for a in signals[:3])
    theta, x0, free = _lanes_last(lanes)
    guessed, precision = (jnp.asarray(a).T[..., None] for a in (signals.start, signals.precision))
    limits = Limits(*(jnp.asarray(a)[:, None] for a in limits))
    task = Task(code, u, y, weight[..., None], guessed, precision, limits, free, total, x0.shape[1] > 1)
    state = jax.lax.while_loop(
        lambda s: (s.taken < stop_rule.steps) & ~s.resting.all(),
        lambda s: step(task, s, jnp.asarray(stop_rule.tolerance)),
        begin(theta, x0),
    )
    return state.theta.T, jnp.transpose(state.x0, (2, 1, 0)), state.cost
