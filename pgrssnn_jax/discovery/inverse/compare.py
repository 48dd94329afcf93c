"""Models of an arm compared by the torques that they ask for, on one record."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.inverse.evidence import SMOOTHED, Errors, Samples, Torques, samples_of
from pgrssnn_jax.discovery.inverse.fit import Gain, gain
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.records.record import continues, join

_RESAMPLED = 400


class Stage(NamedTuple):
    """Torques of a record as one model asks for them, motor Nm `[seq, time, n]`; nrmse: RMS error over the standard
    deviation of the measured torque, of all, of moving and of resting samples, per joint; interval: 95 % of the mean
    over joints."""

    torque: Float[np.ndarray, "seq time n"]
    nrmse: Float[np.ndarray, "regime n"]
    interval: tuple[float, float]

    @property
    def error(self) -> float:
        return float(self.nrmse[0].mean())

    @property
    def moving(self) -> float:
        """Mean over the joints that move, NaN where none does."""
        known = self.nrmse[1][np.isfinite(self.nrmse[1])]
        return float(known.mean()) if known.size else np.nan


class Compared(NamedTuple):
    """The models on one record. gains: of the final model over each, in the log-likelihood; improvement: 95 % interval
    of the fall of the error from recalibrated to after; spread: standard deviation of the torques that errors are
    relative to, Nm."""

    motion: Motion
    spread: Float[np.ndarray, " n"]
    models: Mapping[str, Stage]
    gains: Mapping[str, Gain]
    improvement: tuple[float, float]


def spreads(setup: Setup) -> dict[str, Float[np.ndarray, " n"]]:
    """Standard deviation of the torques of each record; of both where one is the end of the other, so that a joint that
    hardly works there is not judged by how little it does."""
    records = {"train": setup.estimation, "test": setup.test}
    if continues(setup.estimation, setup.test):
        records = dict.fromkeys(records, join(setup.estimation, setup.test))
    return {part: np.asarray(one.u, np.float64).std(axis=(0, 1)) for part, one in records.items()}


def compared(
    model: Torques,
    motion: Motion,
    fastest: Float[np.ndarray, " n"],
    numbers: Mapping[str, Float[np.ndarray, " p"]],
    spread: Float[np.ndarray, " n"],
    kappa: Float[np.ndarray, " n"],
) -> Compared:
    """numbers: θ before, recalibrated and after."""
    samples, judged = samples_of(motion, fastest), samples_of(motion, fastest, SMOOTHED)
    errors = {name: model.errors(theta, samples) for name, theta in numbers.items()}
    stages = {name: _stage(error, samples, motion, spread) for name, error in errors.items()}
    drawn = _resampled(samples, motion, [stage.torque for stage in stages.values()], spread)
    stages = {
        name: stage._replace(interval=_interval(means))
        for (name, stage), means in zip(stages.items(), drawn, strict=True)
    }
    gains = {name: gain(one, errors["after"], judged, kappa) for name, one in errors.items()}
    return Compared(motion, spread, stages, gains, _interval(drawn[1] - drawn[2]))


def error_of(model: Torques, one: Compared, fastest: Float[np.ndarray, " n"], theta: Float[np.ndarray, " p"]) -> float:
    samples = samples_of(one.motion, fastest)
    return _stage(model.errors(theta, samples), samples, one.motion, one.spread).error


def _stage(error: Errors, samples: Samples, motion: Motion, spread: Float[np.ndarray, " n"]) -> Stage:
    regimes = (np.ones_like(samples.moving), samples.moving, ~samples.moving)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = [np.sqrt((error**2 * among).sum(1) / among.sum(1)) / spread for among in regimes]
    asked = motion.torque - error.T.reshape(motion.torque.shape)
    return Stage(asked, np.stack(rms), (np.nan, np.nan))


def _resampled(
    samples: Samples,
    motion: Motion,
    asked: Sequence[Float[np.ndarray, "seq time n"]],
    spread: Float[np.ndarray, " n"],
) -> list[Float[np.ndarray, " draw"]]:
    """The mean over joints of every model's error, over blocks that are drawn with replacement."""
    drawn = np.random.default_rng(0).integers(0, samples.blocks, (_RESAMPLED, samples.blocks))
    count = np.bincount(samples.block, minlength=samples.blocks)
    found = []
    for one in asked:
        squares = ((motion.torque - one) ** 2).reshape(-1, len(spread))
        sums = np.stack([np.bincount(samples.block, joint, samples.blocks) for joint in squares.T], 1)
        found.append((np.sqrt(sums[drawn].sum(1) / count[drawn].sum(1)[:, None]) / spread).mean(1))
    return found


def _interval(drawn: Float[np.ndarray, " draw"]) -> tuple[float, float]:
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)
