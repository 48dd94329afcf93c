"""The test record, touched once, after everything has been decided.

Every model (nominal, recalibrated, with the effects) is simulated from its start: that of the estimation record where
both share it, else one fitted to the first n_init samples of the test record, which then do not count (more where the
error of that start would outweigh the noise: `starts.py`). The phase of a periodic disturbance is shared by no records,
and always fitted. Intervals come from a block bootstrap whose blocks are longer than the errors remember.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.noise import longest_memory, white_variance
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.discovery.starts import begins_anew, fitted_start, samples_for_start
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training import metrics

_RESAMPLED = 400
_SHORTEST, _LEAST_BLOCKS = 16, 8  # samples of a block at least, and blocks of a sequence


class Metric(NamedTuple):
    """name: RMSE, or NRMSE (RMSE / standard deviation) for several outputs; n_init: samples that do not count."""

    name: str
    unit: str
    n_init: int

    def of(self, record: Record, y: Float[np.ndarray, "seq time y"]) -> float:
        function = metrics.nrmse if self.name == "NRMSE" else metrics.rmse
        found = function(measured=record.y, predicted=_lost(y), mask=record.mask, n_init=self.n_init)
        return float(np.mean(found))

    def scale(self, record: Record) -> Float[np.ndarray, " y"]:
        """What an RMS error of each output is divided by."""
        if self.name != "NRMSE":
            return np.ones(record.y.shape[-1])
        measured = np.where(record.mask, np.asarray(record.y, np.float64), np.nan)
        return np.nanstd(measured[:, self.n_init :], axis=(0, 1))


class Validation(NamedTuple):
    """y `[seq, time, y]` and x of the free run on a record; error: the metric, mean over outputs; interval: 95 %."""

    y: Float[np.ndarray, "seq time y"]
    x: Float[np.ndarray, "seq time x"]
    error: float
    interval: tuple[float, float]


class Validations(NamedTuple):
    """The same record by the nominal physics, recalibrated, and with what was found. improvement: 95 % interval of
    the fall of the error from the better one of the first two to the third; relative: error of the third over the
    standard deviation of the record; without: errors of the final model without each effect in turn; scale: what an
    RMS error of each output is divided by."""

    before: Validation
    recalibrated: Validation
    after: Validation
    metric: Metric
    improvement: tuple[float, float]
    relative: float
    without: Mapping[str, float]
    scale: Float[np.ndarray, " y"]

    @property
    def models(self) -> dict[str, Validation]:
        return {"before": self.before, "recalibrated": self.recalibrated, "after": self.after}


class Proved(NamedTuple):
    """The estimation record uncut, and all models on it and on the test record."""

    estimation: Record
    train: Validations
    test: Validations

    @property
    def least_error(self) -> float:
        """On the test record, of the model that predicts it best."""
        return min(one.error for one in self.test.models.values())

    @property
    def floor(self) -> float:
        """The white noise that the final model leaves in the estimation record, in the metric of the test record."""
        return white_noise(self.estimation, self.train.after.y, self.test.scale)

    def closed(self, error: float, better: float) -> float:
        """Part of the recalibrated gap on the test record between two errors."""
        gap = self.test.recalibrated.error - self.floor
        if np.isinf(gap):
            return float(np.isinf(error) and np.isfinite(better))
        return (error - better) / gap if gap > 0 else 0.0

    @property
    def closed_fraction(self) -> float:
        """By the final model."""
        return self.closed(self.test.recalibrated.error, self.test.after.error)


def train_validations(
    problem: Problem, record: Record, guesses: Sequence[Guess], start: Float[np.ndarray, "seq x"] | None
) -> Validations:
    """start: of sequences whose fits saw segments; None: as fitted."""
    starts = [guess.x0 if start is None else start for guess in guesses]
    return _validations(problem, record, guesses, starts, _metric(record, 0), {})


def validations_on_test(
    problem: Problem,
    setup: Setup,
    guesses: Sequence[Guess],
    without: Mapping[str, Guess],
    settings: Settings,
    memory: float,
) -> Validations:
    """memory: correlation time of the errors of the last guess on the estimation record, in samples."""
    test, n_init = setup.test, min(setup.settings.n_init, setup.test.u.shape[1] - 1)
    fitted = setup.start is Start.UNKNOWN or any(begins_anew(problem, guess).any() for guess in guesses)

    def start(guess: Guess, n_init: int) -> Float[np.ndarray, "seq x"]:
        given = {Start.UNKNOWN: np.nan, Start.AT_REST: 0.0, Start.SHARED: guess.x0[:1]}[setup.start]
        known = np.broadcast_to(given, (len(test.u), guess.x0.shape[1]))
        known = np.where(begins_anew(problem, guess), np.nan, known)
        return fitted_start(problem, test, guess, n_init, settings, known) if np.isnan(known).any() else known

    if setup.start is Start.UNKNOWN:
        n_init = samples_for_start(problem, test, guesses[-1], start(guesses[-1], n_init), n_init, memory)
    metric = _metric(test, n_init if fitted else 0)

    alone = {name: _simulated(problem, test, guess, start(guess, n_init)) for name, guess in without.items()}
    errors = {name: metric.of(test, y) for name, (y, _) in alone.items()}
    return _validations(problem, test, guesses, [start(guess, n_init) for guess in guesses], metric, errors)


def _validations(
    problem: Problem,
    record: Record,
    guesses: Sequence[Guess],
    starts: Sequence[Float[np.ndarray, "seq x"]],
    metric: Metric,
    without: Mapping[str, float],
) -> Validations:
    runs = [_simulated(problem, record, guess, x0) for guess, x0 in zip(guesses, starts, strict=True)]
    drawn = _resampled(record, [y for y, _ in runs], metric)
    found = [
        Validation(y, x, metric.of(record, y), _interval(errors)) for (y, x), errors in zip(runs, drawn, strict=True)
    ]
    relative = metric._replace(name="NRMSE").of(record, runs[-1][0])
    before, recalibrated, after = found
    better = drawn[0] if before.error < recalibrated.error else drawn[1]  # a physics that nobody fitted is one, too
    with np.errstate(invalid="ignore"):
        fall = _interval(better - drawn[2])
    return Validations(before, recalibrated, after, metric, fall, relative, without, metric.scale(record))


def _metric(record: Record, n_init: int) -> Metric:
    if len(record.info.outputs) > 1:
        return Metric("NRMSE", "", n_init)
    return Metric("RMSE", "".join(channel.unit for channel in record.info.outputs), n_init)


def white_noise(record: Record, y: Float[np.ndarray, "seq time y"], scale: Float[np.ndarray, " y"]) -> float:
    """RMS of the white noise that a free run leaves in a record, over a scale of each output; mean over outputs."""
    mask = np.asarray(record.mask)
    error = np.where(mask & np.isfinite(y), record.y - y, 0.0)
    return float(np.mean(np.sqrt(white_variance(error, mask)) / scale))


def _simulated(
    problem: Problem, record: Record, guess: Guess, x0: Float[np.ndarray, "seq x"]
) -> tuple[Float[np.ndarray, "seq time y"], Float[np.ndarray, "seq time x"]]:
    y, x = simulate(problem, np.asarray(record.u, np.float64), guess.theta[None], x0[None])
    return y[0], x[0]


def _interval(drawn: Float[np.ndarray, " draw"]) -> tuple[float, float]:
    method = "linear" if np.isfinite(drawn).all() else "inverted_cdf"  # nothing lies between infinite errors
    low, high = np.quantile(drawn, [0.025, 0.975], method=method)
    return float(low), float(high)


def _lost(y: Float[np.ndarray, "seq time y"]) -> Float[np.ndarray, "seq time y"]:
    """A run that has left the range is infinitely wrong."""
    return np.where(np.isfinite(y), y, np.inf)


def _resampled(
    record: Record, predicted: Sequence[Float[np.ndarray, "seq time y"]], metric: Metric
) -> list[Float[np.ndarray, " draw"]]:
    """The metric of every model on the same blocks, drawn with replacement."""
    n_seq, time = record.u.shape[:2]
    measured, mask = np.asarray(record.y, np.float64), np.asarray(record.mask)
    left = np.where(mask, measured - predicted[-1], 0.0)
    length = _block(left)
    blocks = [(s, t) for s in range(n_seq) for t in range(metric.n_init, time, length)]
    drawn = np.random.default_rng(0).integers(0, len(blocks), (_RESAMPLED, len(blocks)))
    scale = metric.scale(record)
    counts = np.stack([mask[s, t : t + length].sum(0) for s, t in blocks])[drawn].sum(1)
    found = []
    for y in predicted:
        with np.errstate(invalid="ignore", over="ignore"):
            squares = np.where(mask, (measured - _lost(y)) ** 2, 0.0)
            sums = np.stack([squares[s, t : t + length].sum(0) for s, t in blocks])
            found.append((np.sqrt(sums[drawn].sum(1) / counts) / scale).mean(-1))
    return found


def _block(error: Float[np.ndarray, "seq time y"]) -> int:
    """Samples over which errors forget twice over; a sequence keeps some blocks."""
    if not np.isfinite(error).all():
        return _SHORTEST
    return int(np.clip(2.0 * longest_memory(error), _SHORTEST, max(_SHORTEST, error.shape[1] // _LEAST_BLOCKS)))
