"""What members predict of the samples that they did not train on, and how far it can be believed."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training.blocks import correlation_time

_LEAST = 0.5  # of the squared errors: a few members that are far off make d larger than any error


class LeftOut(NamedTuple):
    """Predictions of samples by members that did not train on them, `[run, time, channel]`: predicted, spread (standard
    deviation over all members), errors, inputs; measured: which of them count.

    Errors are those of a mean over all n members: where only c of them left a sample out, their mean has d² (1/c - 1/n)
    more variance, d: spread, and errors are as much smaller, on average over the record, by half at most."""

    predicted: Float[np.ndarray, "run time y"]
    spread: Float[np.ndarray, "run time y"]
    error: Float[np.ndarray, "run time y"]
    u: Float[np.ndarray, "run time u"]
    measured: Bool[np.ndarray, "run time y"]

    @property
    def independent(self) -> Float[np.ndarray, " y"]:
        """Σ n / (1 + 2 Σ_{j>0} ρ_j) over runs: how many independent errors the n measured ones of an output are worth;
        ρ: their autocorrelation."""
        counts = np.zeros(self.error.shape[-1])
        for error, measured in zip(self.error, self.measured, strict=True):
            for k, which in enumerate(measured.T):
                counts[k] += which.sum() / (1.0 + 2.0 * correlation_time(np.where(which, error[:, k], 0.0)))
        return np.maximum(counts, 1.0)


def left_out(
    validated: Float[np.ndarray, "member seq time y"],
    validation: Record,
    datasets: Sequence[int],
    usable: Sequence[int],
) -> LeftOut:
    """validated: predictions of the records `validation` `[member, seq, time, channel]`, whose mask says what each
    member left out; usable: members that have not failed. Members of one dataset share its record."""
    parts = []
    for dataset in sorted({datasets[i] for i in usable}):
        own = [i for i in usable if datasets[i] == dataset]
        y_hat, mask = validated[own].astype(np.float64), np.asarray(validation.mask)[own]
        count = mask.sum(0)
        predicted = np.where(count, (y_hat * mask).sum(0) / np.maximum(count, 1), y_hat.mean(0))
        y, u = (np.asarray(a)[own[0]].astype(np.float64) for a in (validation.y, validation.u))
        error, spread, measured = np.where(count, y - predicted, 0.0), y_hat.std(0), count > 0
        more = np.where(measured, spread**2 * (1.0 / np.maximum(count, 1) - 1.0 / len(own)), 0.0).sum((0, 1))
        squares = np.maximum((error**2).sum((0, 1)), np.finfo(float).tiny)
        parts.append(LeftOut(predicted, spread, error * np.sqrt(np.maximum(1.0 - more / squares, _LEAST)), u, measured))
    return LeftOut(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def at_epoch_of_others(losses: Float[np.ndarray, "member epoch"]) -> Float[np.ndarray, " member"]:
    """The losses of members at the epoch that is best for all others, by the mean of their logarithms, so that what a
    member leaves out has no part in the choice of its epoch; of one member alone the least."""
    if len(losses) == 1:
        return losses.min(1)
    logs = np.log(losses)
    others = logs.sum(0) - logs
    return losses[np.arange(len(others)), np.argmin(others, axis=1)]


def optimism(losses: Float[np.ndarray, "member epoch"]) -> float:
    """How many times larger left-out errors are than they look, because each member keeps the epoch at which they are
    least: the ratio of both, mean over members; losses: mean squared errors, NaN where a member was not validated."""
    carried = _carried(losses)
    if not carried.size or not carried.min() > 0:
        return 1.0
    return float(np.exp(0.5 * np.mean(np.log(at_epoch_of_others(carried)) - np.log(carried.min(1)))))


def by_long_blocks(losses: Float[np.ndarray, "member epoch"], nrmse: float, epochs: int) -> float:
    """E_long / E_short, at least 1: NRMSE of members that leave out blocks as long as the system remembers, after so
    many epochs (`race.Tried`), and that of the trained members on short ones, after as many. In short blocks the
    samples around them hold a model in place; another record has none."""
    carried = _carried(losses[:, :epochs])
    if not carried.size or not carried.min() > 0:
        return 1.0
    return max(1.0, float(nrmse / np.exp(0.5 * np.mean(np.log(at_epoch_of_others(carried))))))


def _carried(losses: Float[np.ndarray, "member epoch"]) -> Float[np.ndarray, "member validation"]:
    """Every validation of every member that was validated; a member that has stopped stays as it was."""
    return pd.DataFrame(losses).dropna(axis=1, how="all").ffill(axis=1).dropna().to_numpy()
