"""Records cut into short stretches, for systems whose free run over a whole record has no usable gradient.

Every stretch starts from its own state: a local polynomial of the outputs gives positions and, as their derivatives,
the states that are rates; the fit then moves it within what that polynomial leaves open (multiple shooting without
continuity). A first stretch of a record that starts at rest keeps that start.
Source of the filter: Savitzky, Golay, Smoothing and differentiation of data, Analytical Chemistry 36, 1964.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.discovery.problem import Problem, Signals, start_guess
from pgrssnn_jax.physics.base import measured_rate
from pgrssnn_jax.records.record import Record

_LONG, _SHORT, _ORDER = 15, 9, 3  # samples of the two filters, and their degree
_CERTAIN = 1e8  # precision of a start that is known


class Smoothed(NamedTuple):
    """value and rate `[seq, time, y]` of outputs, and their standard errors `[y]`; noise `[y]` of the outputs."""

    value: Float[np.ndarray, "seq time y"]
    rate: Float[np.ndarray, "seq time y"]
    value_error: Float[np.ndarray, " y"]
    rate_error: Float[np.ndarray, " y"]
    noise: Float[np.ndarray, " y"]


def smoothed(y: Float[np.ndarray, "seq time y"], dt: float) -> Smoothed:
    """Standard errors are those of the noise and of what a shorter filter finds different."""
    weights = scipy.signal.savgol_coeffs
    noise, found, errors = np.zeros(0), [], []
    for order in (0, 1):
        long, short = (_filtered(y, n, order, dt) for n in (_LONG, _SHORT))
        gains = [float((weights(n, _ORDER, deriv=order, delta=dt) ** 2).sum()) for n in (_LONG, _SHORT)]
        if order == 0:
            noise = np.sqrt(np.mean((y - long) ** 2, (0, 1)) / (1.0 - weights(_LONG, _ORDER)[_LONG // 2]))
        bias = np.maximum(np.mean((short - long) ** 2, (0, 1)) - (gains[1] - gains[0]) * noise**2, 0.0)
        found.append(long)
        errors.append(np.sqrt(gains[0] * noise**2 + bias))
    return Smoothed(found[0], found[1], errors[0], errors[1], noise)


def _filtered(y: np.ndarray, samples: int, order: int, dt: float) -> np.ndarray:
    return np.asarray(scipy.signal.savgol_filter(y, samples, _ORDER, deriv=order, delta=dt, axis=1))


def check_stretches(record: Record, length: int) -> None:
    """Raises `ValueError` for records shorter than the filter or a stretch, or with samples that are missing."""
    time, measured = record.u.shape[1], bool(np.asarray(record.mask).all())
    if time < max(length, _LONG) or not measured:
        raise ValueError(
            f"data: train: expected sequences of at least {max(length, _LONG)} measured samples for "
            f"discovery.stretches={length}, found {time}{'' if measured else ' with some that were not measured'}"
        )


def stretches(problem: Problem, record: Record, length: int, folds: int, *, at_rest: bool) -> Signals:
    """Signals of all stretches `[stretch, length, ...]`; whole records go into one fold. at_rest: records start from
    zero. Raises `ValueError` as `check_stretches`."""
    check_stretches(record, length)
    u, y = np.asarray(record.u), np.asarray(record.y, np.float64)
    n_seq, time = u.shape[:2]
    filtered = smoothed(y, problem.physics.dt)
    begins = np.arange(0, time - length + 1, length)
    state, error = _states(problem, filtered)
    before = state  # the state that u_t meets
    if problem.physics.output_timing == "after_step":
        before = np.concatenate([2.0 * state[:, :1] - state[:, 1:2], state[:, :-1]], 1)

    def cut(a: np.ndarray) -> np.ndarray:
        return np.concatenate([a[:, t : t + length] for t in begins], 1).reshape(-1, length, a.shape[-1])

    weight = np.broadcast_to(1.0 / y.std((0, 1)), y.shape)
    own = len(problem.physics.states)
    cut_u, cut_y = cut(u.astype(np.float64)), cut(y)
    start = start_guess(problem.full, cut_u, cut_y, np.ones(cut_y.shape, bool))
    start[:, :own] = before[:, begins].reshape(-1, own)
    # in units of the weighted errors, whose noise is that of the outputs
    relative = float(np.sqrt(np.mean((filtered.noise * weight[0, 0]) ** 2)))
    precision = np.zeros(start.shape)
    precision[:, :own] = (relative / np.maximum(error, 1e-9)) ** 2
    if at_rest:
        first = np.tile(begins == 0, n_seq)
        start[first, :own], precision[first, :own] = 0.0, _CERTAIN
    block = np.repeat(np.arange(n_seq) % folds, len(begins))[:, None].repeat(length, 1)
    return Signals(cut_u, cut_y, cut(weight), block, start, precision)


def end_to_end(a: np.ndarray, pieces: int, *, axis: int = 1) -> np.ndarray:
    """Signals of stretches, `[..., stretch, time, ...]` with stretches on `axis`, as those of sequences of `pieces`."""
    shape = a.shape
    return a.reshape(*shape[:axis], shape[axis] // pieces, pieces * shape[axis + 1], *shape[axis + 2 :])


def _states(problem: Problem, filtered: Smoothed) -> tuple[Float[np.ndarray, "seq time x"], Float[np.ndarray, " x"]]:
    """States that resemble outputs or their rates, and the standard errors of these guesses."""
    names = [output.name for output in problem.physics.outputs]
    columns, errors = [], []
    for state in problem.physics.states:
        if state.like is not None:
            j = names.index(state.like)
            columns.append(filtered.value[..., j])
            errors.append(filtered.value_error[j])
        elif (rated := measured_rate(problem.physics, state)) is not None:
            j = names.index(rated)
            columns.append(filtered.rate[..., j])
            errors.append(filtered.rate_error[j])
        else:
            columns.append(np.zeros_like(filtered.value[..., 0]))
            errors.append(np.inf)
    return np.stack(columns, -1), np.array(errors)
