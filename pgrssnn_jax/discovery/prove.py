"""The test record, touched once, after everything has been decided.

Every model (nominal, recalibrated, with the effects) is simulated from its start: that of the estimation record where
both share it, else one fitted to the first n_init samples of the test record, which then do not count.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.problem import Problem, Signals, start_guess
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training import metrics

_RESAMPLED = 400
_BLOCK = 32  # samples that are drawn together in the bootstrap


class Proof(NamedTuple):
    """y `[seq, time, y]` and x of the free run on a record; error: the figure of merit, mean over outputs; interval: of
    its block bootstrap, 95 %."""

    y: Float[np.ndarray, "seq time y"]
    x: Float[np.ndarray, "seq time x"]
    error: float
    interval: tuple[float, float]


class Merit(NamedTuple):
    """name: RMSE, or NRMSE (RMSE / standard deviation) for several outputs; n_init: samples that do not count."""

    name: str
    unit: str
    n_init: int

    def of(self, record: Record, y: Float[np.ndarray, "seq time y"]) -> float:
        function = metrics.nrmse if self.name == "NRMSE" else metrics.rmse
        found = function(measured=record.y, predicted=y, mask=record.mask, n_init=self.n_init)
        return float(np.mean(found))


def merit_for(record: Record, n_init: int) -> Merit:
    if len(record.info.outputs) > 1:
        return Merit("NRMSE", "", n_init)
    return Merit("RMSE", "".join(channel.unit for channel in record.info.outputs), n_init)


def prove(problem: Problem, record: Record, guess: Guess, x0: Float[np.ndarray, "seq x"], merit: Merit) -> Proof:
    """Free run of one model over a record, with its error and the interval that its blocks allow."""
    u = np.asarray(record.u, np.float64)
    y, x = simulate(problem, u, guess.theta[None], x0[None])
    return Proof(y[0], x[0], merit.of(record, y[0]), _interval(record, y[0], merit))


def fitted_start(
    problem: Problem, record: Record, guess: Guess, n_init: int, settings: Settings
) -> Float[np.ndarray, "seq x"]:
    """x_0 of every sequence from its first n_init samples, with θ as it is."""
    part = [np.asarray(a)[:, :n_init] for a in (record.u, record.y, record.mask)]
    u, y, mask = part[0].astype(np.float64), part[1].astype(np.float64), part[2]
    spread = np.nanstd(np.where(record.mask, record.y, np.nan), axis=(0, 1))
    weight = np.where(mask, 1.0 / np.where(spread > 0, spread, 1.0), 0.0)
    start = start_guess(problem.full, u, y, mask)
    signals = Signals(u, y, weight, np.zeros(u.shape[:2], int), start, np.zeros(start.shape))
    ((fitted, _),) = fit_all(problem, signals, [guess._replace(x0=start)], settings, only_start=True)
    return fitted.x0


def fitted_nominal(problem: Problem, signals: Signals, settings: Settings) -> Guess:
    """The nominal physics, with the best initial state for the estimation record."""
    ((given, _),) = fit_all(problem, signals, [Guess((), problem.theta, signals.start)], settings, only_start=True)
    return given


def recalibrated_from_spread(
    problem: Problem, signals: Signals, start: Guess, settings: Settings, rng: np.random.Generator, starts: int
) -> Guess:
    """The physics' own parameters fitted from several starting values: nominal, and drawn about it."""
    own = problem.of(None)
    guesses = [start]
    for _ in range(starts - 1):
        theta = start.theta.copy()
        theta[own] = np.clip(
            theta[own] * np.exp(0.3 * rng.standard_normal(len(own))), problem.low[own], problem.high[own]
        )
        guesses.append(start._replace(theta=theta))
    found = fit_all(problem, signals, guesses, settings)
    return min(found, key=lambda item: item[1])[0]


def _interval(record: Record, y: np.ndarray, merit: Merit) -> tuple[float, float]:
    rng = np.random.default_rng(0)
    n_seq, time = y.shape[:2]
    blocks = [(s, t) for s in range(n_seq) for t in range(merit.n_init, time, _BLOCK)]
    measured, mask = np.asarray(record.y, np.float64), np.asarray(record.mask)
    squares = np.where(mask, (measured - y) ** 2, 0.0)
    scale = np.ones(y.shape[-1])
    if merit.name == "NRMSE":
        scale = np.nanstd(np.where(mask, measured, np.nan)[:, merit.n_init :], axis=(0, 1))
    sums = np.stack([squares[s, t : t + _BLOCK].sum(0) for s, t in blocks])
    counts = np.stack([mask[s, t : t + _BLOCK].sum(0) for s, t in blocks])
    drawn = rng.integers(0, len(blocks), (_RESAMPLED, len(blocks)))
    with np.errstate(invalid="ignore", over="ignore"):
        errors = (np.sqrt(sums[drawn].sum(1) / counts[drawn].sum(1)) / scale).mean(-1)
        low, high = np.quantile(errors, [0.025, 0.975])
    return float(low), float(high)
