"""Where the free run over a record begins whose start is not known.

    x_0 = argmin Σ_{t < n} ‖w (y_t - ŷ_t(x_0))‖²

Where a plant integrates, a small error of this start grows. With noise of the variance σ² that remembers τ samples it
adds

    mean_{t ≥ n} tr S_t C S_tᵀ,   C = τ σ² (Σ_{t < n} S_tᵀ S_t)⁻¹,   S_t = ∂(w y_t) / ∂x_0

to the squared error of the samples that follow, and may outweigh what a model gains.
"""

import numpy as np
from jaxtyping import Bool, Float

from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.free_runs import by_start
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.problem import HELD, Problem, Signals, start_guess
from pgrssnn_jax.records.record import Record

_ADDED = 0.1  # of the energy of the noise that the error of a start may add: 5 % of an RMS error
_STEP = 1e-4  # of the range of a state: a difference quotient in double precision


def begins_anew(problem: Problem, guess: Guess) -> Bool[np.ndarray, " x"]:
    """States whose start no two records share."""
    names = {name for effect in guess.active for name in problem.effect(effect).memory_guesses}
    return np.array([state.name in names for state in problem.full.states])


def fitted_start(
    problem: Problem,
    record: Record,
    guess: Guess,
    n_init: int,
    settings: Settings,
    known: Float[np.ndarray, "seq x"],
) -> Float[np.ndarray, "seq x"]:
    """x_0 of every sequence from its first n_init samples, with θ as it is; known: x_0 of states whose start is known,
    NaN of the others."""
    u, y, mask = (np.asarray(a)[:, :n_init] for a in (record.u, record.y, record.mask))
    u, y, weight = u.astype(np.float64), y.astype(np.float64), np.where(mask, 1.0 / _spread(record), 0.0)
    start = np.where(np.isnan(known), start_guess(problem.full, u, y, mask), known)
    precision = np.where(np.isnan(known), 0.0, HELD)
    signals = Signals(u, y, weight, np.zeros(u.shape[:2], int), start, precision)
    guesses = [guess._replace(x0=x0) for x0 in problem.beginnings(guess.active, start)]
    fits = fit_all(problem, signals, guesses, settings, only_start=True)
    return min(fits, key=lambda fit: fit[1])[0].x0


def samples_for_start(
    problem: Problem, record: Record, guess: Guess, x0: Float[np.ndarray, "seq x"], least: int, memory: float
) -> int:
    """`least`, doubled until the error of the start adds less than a tenth to the noise, or half of the record is
    reached. x0: of a free run, around which it is linearised; memory: τ. The measured outputs take no part."""
    sensitivities = _sensitivities(problem, record, guess, x0)  # [s, seq, time, y]
    half, n = record.u.shape[1] // 2, least
    while n < half and memory * _added(sensitivities, n) > _ADDED:
        n = min(2 * n, half)
    return n


def _added(sensitivities: Float[np.ndarray, "s seq time y"], n: int) -> float:
    """Squared error that the start adds to each later sample, over the variance of white noise; mean over sequences."""
    found = []
    for own in np.moveaxis(sensitivities, 1, 0):
        seen, later = own[:, :n].reshape(len(own), -1), own[:, n:].reshape(len(own), -1)
        covariance = np.linalg.pinv(seen @ seen.T, rcond=1e-12, hermitian=True)
        found.append(float(((later @ later.T) * covariance).sum()) / later.shape[1])
    return float(np.mean(found))


def _sensitivities(
    problem: Problem, record: Record, guess: Guess, x0: Float[np.ndarray, "seq x"]
) -> Float[np.ndarray, "s seq time y"]:
    """Of the weighted outputs by each unknown of the start, in parts of the range of its state; 0 where nothing was
    measured, or a run leaves the range of numbers."""
    u = np.asarray(record.u, np.float64)
    _, x = simulate(problem, u, guess.theta[None], x0[None])
    size = np.ptp(x[0], axis=(0, 1))
    steps = (_STEP * np.where(size > 0, size, 1.0) * by_start(problem.code).T)[:, None]  # [s, 1, x]
    starts = np.concatenate([x0 + steps, x0 - steps])
    y, _ = simulate(problem, u, np.repeat(guess.theta[None], len(starts), 0), starts)
    ahead, behind = np.split(y, 2)
    quotient = (ahead - behind) / (2.0 * _STEP)
    return np.where(np.asarray(record.mask) & np.isfinite(quotient), quotient / _spread(record), 0.0)


def _spread(record: Record) -> Float[np.ndarray, " y"]:
    spread = np.nanstd(np.where(record.mask, record.y, np.nan), axis=(0, 1), dtype=np.float64)
    return np.where(spread > 0, spread, 1.0)
