"""One step of Levenberg-Marquardt for many fits (lanes) at once: linearise, solve, try, accept. Arrays have lanes last.

    (JᵀJ + λ diag JᵀJ + Λ) δ = Jᵀe + Λ (β_nominal - β)        β = (θ_A, x_0), Λ: precision of the prior

The initial states of the sequences are eliminated by a Schur complement, so that there may be many. Sequences may be
shared by devices: sums over them go through `Task.total`. Source of the damping: Marquardt 1963; of the elimination:
Björck, Numerical Methods for Least Squares Problems, 1996, section 6.3.

Ours rather than a library's: lanes are frozen one by one, and the normal equations know which unknowns are local.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.code import Code
from pgrssnn_jax.discovery.free_runs import by_start, free_run, with_derivatives
from pgrssnn_jax.discovery.solve import identity_like, solve
from pgrssnn_jax.records.record import Array

_DAMPINGS = (0.01, 0.2, 3.0, 100.0)  # times the present one, tried together
_OF_MANY = (0.1, 5.0)  # the same for many sequences: stretches are nearly linear, and every trial is run twice
_TINY = 1e-250  # where neither the data nor a prior say anything of a number, it stays; small in any unit
_GIVE_UP = 1e6  # damping at which no step is left


class Limits(NamedTuple):
    """Bounds, nominal numbers and precisions of the prior of θ, each `[p]`."""

    low: Float[Array, " p"]
    high: Float[Array, " p"]
    nominal: Float[Array, " p"]
    precision: Float[Array, " p"]


class Task(NamedTuple):
    """What stays the same during a fit. u `[time, u, seq]`; y `[time, y, seq]`; weight `[time, y, seq, 1]`; guessed and
    precision `[x, seq, 1]`: of x_0; limits, each `[p, 1]`; free `[lane, k]`: positions in θ that are fitted, -1 for an
    unused place; total: sum of a value over all devices; many: more than one sequence."""

    code: Code
    u: jax.Array
    y: jax.Array
    weight: jax.Array
    guessed: jax.Array
    precision: jax.Array
    limits: Limits
    free: Int[jax.Array, "lane k"]
    total: Callable[[jax.Array], jax.Array]
    many: bool

    @property
    def dampings(self) -> jax.Array:
        return jnp.asarray(_OF_MANY if self.many else _DAMPINGS)

    @property
    def used(self) -> jax.Array:
        return self.free >= 0

    @property
    def place(self) -> Int[jax.Array, "k lane"]:
        return jnp.where(self.used, self.free, 0).T


class State(NamedTuple):
    """Of all lanes: theta `[p, lane]`, x0 `[x, seq, lane]`, cost, damping, resting `[lane]`, steps taken; held
    `[seq, lane]`: damping of the start of one sequence beyond that of its lane."""

    theta: jax.Array
    x0: jax.Array
    cost: jax.Array
    damping: jax.Array
    held: jax.Array
    resting: jax.Array
    taken: jax.Array


class Normal(NamedTuple):
    """Of a linearisation: cost `[lane]`, JᵀJ `[seq, lane, d, d]`, Jᵀe `[seq, lane, d]`; d: k free numbers, then the
    unknowns of the start."""

    cost: jax.Array
    matrix: jax.Array
    pull: jax.Array


class Trials(NamedTuple):
    """Of every damping: theta `[trial, p, lane]`, x0 `[trial, x, seq, lane]`, cost `[trial, lane]`; moved
    `[trial, seq, lane]`: did the start of the sequence?"""

    theta: jax.Array
    x0: jax.Array
    cost: jax.Array
    moved: jax.Array


def begin(theta: jax.Array, x0: jax.Array) -> State:
    lane = theta.shape[1:]
    return State(
        theta,
        x0,
        jnp.full(lane, jnp.inf),
        jnp.full(lane, 1e-2),
        jnp.ones((x0.shape[1], *lane)),
        jnp.zeros(lane, bool),
        jnp.zeros((), jnp.int32),
    )


def step(task: Task, state: State, tolerance: jax.Array) -> State:
    """tolerance: relative fall of the cost below which a lane rests."""
    normal = _linearise(task, state)
    return _accept(task, state, normal.cost, _try(task, state, *_solve(task, state, normal)), tolerance)


def _linearise(task: Task, state: State) -> Normal:
    squares, pull, matrix = _sums(task, state)
    own, by_sequence = _costs(task, state.theta, state.x0, squares)
    cost = own + task.total(by_sequence.sum(0))
    return Normal(jnp.where(jnp.isfinite(own), cost, jnp.inf), matrix, pull)


def _sums(task: Task, state: State) -> tuple[jax.Array, jax.Array, jax.Array]:
    """eᵀe `[seq, lane]`, Jᵀe and JᵀJ of every sequence; a derivative that is not finite counts as zero."""
    if task.code.compiled is not None:
        squares, pull, matrix = task.code.compiled.normal(
            task.u, state.theta, state.x0, task.free, task.y, task.weight[..., 0]
        )
        return squares, jnp.moveaxis(pull, 0, -1), jnp.moveaxis(matrix, (0, 1), (-2, -1))
    found, dy = with_derivatives(task.code, task.u, state.theta, state.x0, task.free)
    error, weight = _error(task, found), task.weight[:, :, None]
    columns = jnp.where(weight > 0, weight * dy, 0.0)
    columns = jnp.where(jnp.isfinite(columns), columns, 0.0)
    pull = jnp.einsum("tydsl,tysl->sld", columns, error)
    return (error**2).sum((0, 1)), pull, jnp.einsum("tydsl,tyesl->slde", columns, columns)


def _error(task: Task, found: jax.Array) -> jax.Array:
    return jnp.where(task.weight > 0, task.weight * (task.y[..., None] - found), 0.0)


def _costs(task: Task, theta: jax.Array, x0: jax.Array, squares: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Of the numbers `[lane]`, and of every sequence with its start `[seq, lane]`. squares: eᵀe."""
    known = task.limits.precision
    by_sequence = squares + (task.precision * (x0 - task.guessed) ** 2).sum(0)
    departure = jnp.where(known > 0, theta - task.limits.nominal, 0.0)
    return (known * departure**2).sum(0), jnp.where(jnp.isfinite(by_sequence), by_sequence, jnp.inf)


def _solve(task: Task, state: State, normal: Normal) -> tuple[jax.Array, jax.Array]:
    """θ `[trial, p, lane]` and x_0 `[trial, x, seq, lane]`."""
    (low, high, nominal, known), place, k = task.limits, task.place, task.free.shape[1]
    now = jnp.take_along_axis(state.theta, place, 0)  # [k, lane]
    lowest, highest = low[place, 0], high[place, 0]
    held = known[place, 0].T
    back = jnp.where(held > 0, held * (nominal[place, 0] - now).T, 0.0)
    back = jnp.where(task.used & jnp.isfinite(back), back, 0.0)
    direction = task.total(normal.pull[..., :k].sum(0)).T + back.T
    blocked = ((now <= lowest) & (direction < 0)) | ((now >= highest) & (direction > 0))
    moves = task.used & ~blocked.T  # [lane, k]
    delta, delta_x = jax.vmap(lambda d: _damped(task, state, normal, moves, held, back, d * state.damping))(
        task.dampings
    )
    moved = jnp.clip(now.T[None] + delta, lowest.T[None], highest.T[None])  # [trial, lane, k]
    lane = jnp.arange(len(task.free))[:, None]
    to = jnp.where(task.used, task.free, len(low))
    theta = jax.vmap(lambda new: state.theta.T.at[lane, to].set(new, mode="drop").T)(moved)
    return theta, state.x0[None] + jnp.einsum("xs,dqls->dxql", by_start(task.code), delta_x)


def _damped(
    task: Task,
    state: State,
    normal: Normal,
    moves: jax.Array,
    own: jax.Array,
    back: jax.Array,
    damping: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """One damped step of the free numbers `[lane, k]` and of the unknowns of the starts `[seq, lane, s]`: x_0 of every
    sequence eliminated first."""
    k, starts = task.free.shape[1], jnp.asarray(by_start(task.code))
    matrix, pull = normal.matrix, normal.pull
    mask = jnp.where(moves, 1.0, 0.0)
    local = matrix[..., k:, k:]
    known = _TINY + (starts.T @ task.precision[..., 0]).T[:, None, :, None]  # [seq, 1, s, 1]
    damped = (damping[None] * state.held)[..., None, None]
    local = local + jnp.where(identity_like(local) > 0, damped * local + known, 0.0)
    back_x = jnp.einsum("xs,xql->qls", starts, task.precision * (task.guessed - state.x0))
    cross = matrix[..., :k, k:] * mask[None, :, :, None]
    right_x = pull[..., k:] + back_x
    solved = solve(local, jnp.concatenate([jnp.swapaxes(cross, -1, -2), right_x[..., None]], -1))
    whole = task.total(matrix[..., :k, :k].sum(0)) * mask[:, :, None] * mask[:, None, :]
    diagonal = jnp.diagonal(whole, axis1=-2, axis2=-1)
    extra = damping[:, None] * diagonal + jnp.where(moves, own, 1.0) + _TINY
    whole = whole + extra[:, :, None] * identity_like(whole) - task.total((cross @ solved[..., :-1]).sum(0))
    right = task.total(pull[..., :k].sum(0)) + back
    right = mask * right - task.total((cross @ solved[..., -1:])[..., 0].sum(0))
    delta = solve(whole, right[..., None])[..., 0]
    return delta, solved[..., -1] - (solved[..., :-1] @ delta[None, :, :, None])[..., 0]


def _try(task: Task, state: State, theta: jax.Array, x0: jax.Array) -> Trials:
    """A sequence keeps its start where moving it does worse: one that meets a stop or comes to rest must not hold back
    all others."""

    def tried(theta: jax.Array, x0: jax.Array) -> tuple[jax.Array, jax.Array]:
        error = _error(task, free_run(task.code, task.u, theta, x0)[0])
        return _costs(task, theta, x0, (error**2).sum((0, 1)))

    if not task.many:
        own, by_sequence = jax.vmap(tried)(theta, x0)
        return Trials(theta, x0, own + by_sequence[:, 0], jnp.ones(by_sequence.shape, bool))
    kept = jnp.broadcast_to(state.x0[None], x0.shape)
    own, by_sequence = jax.vmap(tried)(jnp.concatenate([theta, theta]), jnp.concatenate([x0, kept]))
    with_move, without = jnp.split(by_sequence, 2)
    moved = with_move < without
    cost = own[: len(theta)] + task.total(jnp.minimum(with_move, without).sum(1))
    return Trials(theta, jnp.where(moved[:, None], x0, kept), cost, moved)


def _accept(task: Task, state: State, now: jax.Array, trials: Trials, tolerance: jax.Array) -> State:
    """The best trial of every lane that it makes better; the damping follows."""

    def chosen(values: jax.Array) -> jax.Array:
        return jnp.take_along_axis(values, best.reshape((1,) * (values.ndim - 1) + (-1,)), 0)[0]

    best = jnp.argmin(trials.cost, 0)
    cost = chosen(trials.cost)
    resting = state.resting | ~jnp.isfinite(now)
    better = (cost < now) & ~resting
    held = jnp.clip(state.held * jnp.where(chosen(trials.moved), 0.1, 10.0), 1.0, _GIVE_UP)
    lost = ~better & (state.damping > _GIVE_UP)
    still = better & (now - cost <= tolerance * now)
    damping = jnp.where(better, task.dampings[best] * state.damping, state.damping * 30.0)
    return State(
        jnp.where(better, chosen(trials.theta), state.theta),
        jnp.where(better, chosen(trials.x0), state.x0),
        jnp.where(better, cost, now),
        jnp.clip(damping, 1e-9, 1e9),
        jnp.where(better, held, state.held),
        resting | still | lost,
        state.taken + 1,
    )
