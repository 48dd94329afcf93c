"""Simulation-error least squares, many fits at once.

    minimise over θ_A, x_0   Σ_t ‖w_t (y_t - ŷ_t(θ, x_0))‖² + prior        A: the free numbers of this fit

Levenberg-Marquardt with the sensitivities of the free run beside it in one scan (forward mode). Fits (lanes) differ in
which numbers are free, where they start and which fold they leave out; all run in one program, lanes last in memory.
The initial states of the sequences are eliminated by a Schur complement, so that there may be many. Source of the
damping: Marquardt 1963; of the elimination: Björck, Numerical Methods for Least Squares Problems, 1996, section 6.3.

Ours rather than a library's: lanes are frozen one by one, and the normal equations know which unknowns are local.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.acceleration.compiler import quick_jit
from pgrssnn_jax.acceleration.devices import over_devices
from pgrssnn_jax.discovery.free_runs import by_start, free_run, time_first, with_derivatives
from pgrssnn_jax.discovery.problem import Code, Problem, Signals
from pgrssnn_jax.discovery.solve import identity_like, solve
from pgrssnn_jax.records.record import Array

_DAMPINGS = (0.01, 0.2, 3.0, 100.0)  # times the present one, tried together
_OF_MANY = (0.1, 5.0)  # the same for many sequences: stretches are nearly linear, and every trial is run twice
_FEW = 4  # lanes per device: fewer take as long however they are compiled
_TINY = 1e-30  # where neither the data nor a prior say anything of a number, it stays
_GIVE_UP = 1e6  # damping at which no step is left


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


def sensitivity(problem: Problem, signals: Signals, lanes: Lanes) -> tuple[np.ndarray, np.ndarray]:
    """y `[lane, seq, time, y]`, and its derivatives by the free numbers and x_0, `[lane, seq, time, y, k + s]`;
    s: unknowns of the start."""
    y, dy = _sensitivity(problem.code, Lanes(*map(np.asarray, lanes)), signals)
    return np.asarray(y), np.asarray(dy)


def simulate(problem: Problem, u: Array, theta: Array, x0: Array) -> tuple[np.ndarray, np.ndarray]:
    """Free runs: y `[lane, seq, time, y]` and x `[lane, seq, time, x]` (state after u_t) for θ `[lane, p]` and x_0
    `[lane, seq, x]`; u `[seq, time, u]`."""
    y, x = _simulate(problem.code, jnp.asarray(u), jnp.asarray(theta), jnp.asarray(x0))
    return np.asarray(y), np.asarray(x)


class Limits(NamedTuple):
    """Bounds of θ, what was given and its precision, each `[p]`."""

    low: Float[Array, " p"]
    high: Float[Array, " p"]
    given: Float[Array, " p"]
    precision: Float[Array, " p"]


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
    return code.written_out is not None and len(lanes.theta) > _FEW * devices


@partial(jax.jit, static_argnums=0)
def _simulate(code: Code, u: jax.Array, theta: jax.Array, x0: jax.Array) -> tuple[jax.Array, jax.Array]:
    y, x = free_run(code, time_first(u), theta.T, jnp.transpose(x0, (2, 1, 0)))
    return jnp.transpose(y, (3, 2, 0, 1)), jnp.transpose(x, (3, 2, 0, 1))


@quick_jit(lambda code, *_: not code.accelerate, static_argnums=0)
def _sensitivity(code: Code, lanes: Lanes, signals: Signals) -> tuple[jax.Array, jax.Array]:
    y, dy = with_derivatives(code, time_first(signals.u), *_lanes_last(lanes))
    return jnp.transpose(y, (3, 2, 0, 1)), jnp.transpose(dy, (4, 3, 0, 1, 2))


class _State(NamedTuple):
    """Of all lanes: theta `[p, lane]`, x0 `[x, seq, lane]`, cost, damping, resting `[lane]`, steps taken; held
    `[seq, lane]`: damping of the start of one sequence beyond that of its lane."""

    theta: jax.Array
    x0: jax.Array
    cost: jax.Array
    damping: jax.Array
    held: jax.Array
    resting: jax.Array
    taken: jax.Array


@quick_jit(_worth_it, static_argnums=(0, 1))
def _fit(
    code: Code, devices: int, limits: Limits, stop_rule: StopRule, lanes: Lanes, signals: Signals
) -> tuple[jax.Array, ...]:
    def on_one_device(lanes: Lanes) -> tuple[jax.Array, ...]:
        return _fit_lanes(code, limits, stop_rule, lanes, signals)

    return over_devices(on_one_device, devices)(lanes)


def _fit_lanes(
    code: Code, limits: Limits, stop_rule: StopRule, lanes: Lanes, signals: Signals
) -> tuple[jax.Array, ...]:
    u, y, w = (time_first(a) for a in signals[:3])
    theta0, x0, free = _lanes_last(lanes)
    weight = w[..., None]  # [time, y, seq, 1]
    low, high, given, known = (jnp.asarray(a)[:, None] for a in limits)
    guessed = jnp.transpose(jnp.asarray(signals.start), (1, 0))[..., None]  # [x, seq, 1]
    precision = jnp.transpose(jnp.asarray(signals.precision), (1, 0))[..., None]  # [x, seq, 1]
    dampings = _DAMPINGS if x0.shape[1] == 1 else _OF_MANY
    used = free >= 0
    place = jnp.where(used, free, 0).T  # [k, lane]

    def error_of(found: jax.Array) -> jax.Array:
        return jnp.where(weight > 0, weight * (y[..., None] - found), 0.0)

    def tried(theta: jax.Array, x0: jax.Array) -> tuple[jax.Array, jax.Array]:
        return costs_of(theta, x0, error_of(free_run(code, u, theta, x0)[0]))

    def costs_of(theta: jax.Array, x0: jax.Array, error: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Of the numbers `[lane]`, and of every sequence with its start `[seq, lane]`."""
        start = (precision * (x0 - guessed) ** 2).sum(0)
        by_sequence = (error**2).sum((0, 1)) + start
        from_given = jnp.where(known > 0, theta - given, 0.0)
        return (known * from_given**2).sum(0), jnp.where(jnp.isfinite(by_sequence), by_sequence, jnp.inf)

    def step(state: _State) -> _State:
        found, dy = with_derivatives(code, u, state.theta, state.x0, free)
        error = error_of(found)
        own, by_sequence = costs_of(state.theta, state.x0, error)
        now = jnp.where(jnp.isfinite(own), own + by_sequence.sum(0), jnp.inf)
        columns = jnp.where(weight[:, :, None] > 0, weight[:, :, None] * dy, 0.0)
        columns = jnp.where(jnp.isfinite(columns), columns, 0.0)
        normal = jnp.einsum("tydsl,tyesl->slde", columns, columns)
        pull = jnp.einsum("tydsl,tysl->sld", columns, error)
        trial_theta, trial_x0 = _trials(state, normal, pull)
        costs, trial_x0, moved = _tried(state, trial_theta, trial_x0)
        best = jnp.argmin(costs, 0)
        cost = jnp.take_along_axis(costs, best[None], 0)[0]
        resting = state.resting | ~jnp.isfinite(now)
        better = (cost < now) & ~resting
        chosen_theta = jnp.take_along_axis(trial_theta, best[None, None], 0)[0]
        chosen_x0 = jnp.take_along_axis(trial_x0, best[None, None, None], 0)[0]
        chosen_moved = jnp.take_along_axis(moved, best[None, None], 0)[0]
        still = (now - cost <= stop_rule.tolerance * now) | (~better & (state.damping > _GIVE_UP))
        damping = jnp.where(better, jnp.asarray(dampings)[best] * state.damping, state.damping * 30.0)
        return _State(
            jnp.where(better, chosen_theta, state.theta),
            jnp.where(better, chosen_x0, state.x0),
            jnp.where(better, cost, now),
            jnp.clip(damping, 1e-9, 1e9),
            jnp.where(better, jnp.clip(state.held * jnp.where(chosen_moved, 0.1, 10.0), 1.0, _GIVE_UP), state.held),
            resting | (better & still) | (~better & (state.damping > _GIVE_UP)),
            state.taken + 1,
        )

    def _tried(state: _State, theta: jax.Array, x0: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Cost of every trial `[trial, lane]`, its starts, and which of them moved `[trial, seq, lane]`.

        A sequence keeps its start where moving it does worse: one that meets a stop or comes to rest must not hold
        back all others.
        """
        if x0.shape[2] == 1:
            own, by_sequence = jax.vmap(tried)(theta, x0)
            return own + by_sequence[:, 0], x0, jnp.ones(by_sequence.shape, bool)
        kept = jnp.broadcast_to(state.x0[None], x0.shape)
        both = jnp.concatenate([theta, theta]), jnp.concatenate([x0, kept])
        own, by_sequence = jax.vmap(tried)(*both)
        with_move, without = jnp.split(by_sequence, 2)
        moved = with_move < without
        best = jnp.minimum(with_move, without).sum(1)
        return own[: len(theta)] + best, jnp.where(moved[:, None], x0, kept), moved

    def _trials(state: _State, normal: jax.Array, pull: jax.Array) -> tuple[jax.Array, jax.Array]:
        """θ `[trial, p, lane]` and x_0 `[trial, x, seq, lane]`."""
        k = free.shape[1]
        now = jnp.take_along_axis(state.theta, place, 0)  # [k, lane]
        lowest, highest = low[place, 0], high[place, 0]
        direction = pull[..., :k].sum(0).T
        blocked = ((now <= lowest) & (direction < 0)) | ((now >= highest) & (direction > 0))
        moves = used & ~blocked.T  # [lane, k]
        held = known[place, 0].T
        back = jnp.where(held > 0, held * (given[place, 0] - now).T, 0.0)
        back = jnp.where(used & jnp.isfinite(back), back, 0.0)
        shift = jax.vmap(lambda d: _step(normal, pull, moves, held, back, state, d * state.damping))(
            jnp.asarray(dampings)
        )  # [trial, lane, k + seq s]
        delta, delta_x = shift[..., :k], shift[..., k:]
        moved = jnp.clip(now.T[None] + delta, lowest.T[None], highest.T[None])  # [trial, lane, k]
        lane = jnp.arange(free.shape[0])[:, None]
        theta = jax.vmap(lambda new: state.theta.T.at[lane, jnp.where(used, free, len(low))].set(new, mode="drop").T)(
            moved
        )
        starts = by_start(code)
        delta_x = delta_x.reshape(len(dampings), free.shape[0], x0.shape[1], starts.shape[1])
        return theta, state.x0[None] + jnp.einsum("xs,dlqs->dxql", starts, delta_x)

    def _step(
        normal: jax.Array,
        pull: jax.Array,
        moves: jax.Array,
        own: jax.Array,
        back: jax.Array,
        state: _State,
        damping: jax.Array,
    ) -> jax.Array:
        """Damped step `[lane, k + seq s]`: x_0 of every sequence eliminated first."""
        k = free.shape[1]
        mask = jnp.where(moves, 1.0, 0.0)
        local = normal[..., k:, k:]
        starts = jnp.asarray(by_start(code))
        held = _TINY + (starts.T @ precision[..., 0]).T[:, None, :, None]  # [seq, 1, s, 1]
        damped = (damping[None] * state.held)[..., None, None]
        local = local + jnp.where(identity_like(local) > 0, damped * local + held, 0.0)
        back_x = precision * (guessed - state.x0)
        back_x = jnp.einsum("xs,xql->qls", starts, back_x)
        cross = normal[..., :k, k:] * mask[None, :, :, None]
        pull_x = pull[..., k:] + back_x
        solved = solve(local, jnp.concatenate([jnp.swapaxes(cross, -1, -2), pull_x[..., None]], -1))
        whole = normal[..., :k, :k].sum(0) * mask[:, :, None] * mask[:, None, :]
        diagonal = jnp.diagonal(whole, axis1=-2, axis2=-1)
        extra = damping[:, None] * diagonal + jnp.where(moves, own, 1.0) + _TINY
        whole = whole + extra[:, :, None] * identity_like(whole) - (cross @ solved[..., :-1]).sum(0)
        right = mask * (pull[..., :k].sum(0) + back) - (cross @ solved[..., -1:])[..., 0].sum(0)
        delta = solve(whole, right[..., None])[..., 0]
        delta_x = solved[..., -1] - (solved[..., :-1] @ delta[None, :, :, None])[..., 0]
        return jnp.concatenate([delta, jnp.swapaxes(delta_x, 0, 1).reshape(len(delta), -1)], -1)

    lane = free.shape[:1]
    state = _State(
        theta0,
        x0,
        jnp.full(lane, jnp.inf),
        jnp.full(lane, 1e-2),
        jnp.ones((x0.shape[1], *lane)),
        jnp.zeros(lane, bool),
        jnp.zeros((), jnp.int32),
    )
    state = jax.lax.while_loop(lambda s: (s.taken < stop_rule.steps) & ~s.resting.all(), step, state)
    return state.theta.T, jnp.transpose(state.x0, (2, 1, 0)), state.cost
