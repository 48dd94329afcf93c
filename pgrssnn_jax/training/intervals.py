"""Prediction intervals of an ensemble, calibrated on what its members left out of training.

    ŷ_t ± q s_t,      s_t² = d_t² + exp(w · φ_t),      φ_t = [1, horizon, ŷ_t, ŷ_t², u_t]

ŷ: mean over members, d: their standard deviation; φ in scaled units and within the range of the calibration; horizon:
log(1 + t) over that of the longest run. w: largest normal likelihood of the left-out errors, with a normal prior that
pulls towards a constant variance. q: the quantile of |left-out error| / s, so that the share of left-out samples inside
is the level asked for, whatever the law of the errors.
Sources: Lei, G'Sell, Rinaldo, Tibshirani, Wasserman, Distribution-free predictive inference for regression, JASA 2018,
section 5.2; Barber, Candès, Ramdas, Tibshirani, Predictive inference with the jackknife+, Annals of Statistics 2021.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from pgrssnn_jax.records.record import Record

_LEVELS = np.linspace(0.0, 1.0, 401)
_PRIOR = 1.0  # standard deviation of w: a signal's deviation changes the variance by a factor of e, give or take
_BLOCK = 32  # samples that count as one, because errors of a free run follow each other; as `DataSettings.block`
_TINY = 1e-12  # of the variance of an output: errors of a model that is exact


class LeftOut(NamedTuple):
    """Predictions of samples by members that did not train on them, `[run, time, channel]`: predicted, spread (standard
    deviation over all members), errors, inputs; measured: which of them count."""

    predicted: Float[np.ndarray, "run time y"]
    spread: Float[np.ndarray, "run time y"]
    error: Float[np.ndarray, "run time y"]
    u: Float[np.ndarray, "run time u"]
    measured: Bool[np.ndarray, "run time y"]


class Intervals(NamedTuple):
    """What an interval needs beside the prediction. weights `[y, feature]`: w; y, u: rows centre, scale, low and high
    of outputs and inputs; horizon: samples of the longest run; quantiles `[y, level]`: q at evenly spaced levels."""

    weights: Float[np.ndarray, "y feature"]
    y: Float[np.ndarray, "4 y"]
    u: Float[np.ndarray, "4 u"]
    horizon: np.ndarray
    quantiles: Float[np.ndarray, "y level"]

    def half_width(
        self,
        predicted: Float[np.ndarray, "run time y"],
        spread: Float[np.ndarray, "run time y"],
        u: Float[np.ndarray, "run time u"],
        level: float,
    ) -> Float[np.ndarray, "run time y"]:
        """q s of the level, 0 to 1, in the units of the outputs. Raises `ValueError` for another level."""
        if not 0.0 < level < 1.0:
            raise ValueError(f"interval: expected a level between 0 and 1, for example 0.9, found {level}")
        found = np.empty(predicted.shape)
        for k, (weights, quantiles) in enumerate(zip(self.weights, self.quantiles, strict=True)):
            log_variance = self._features(predicted[..., k], u, k) @ weights
            scale = np.sqrt((spread[..., k] / self.y[1, k]) ** 2 + np.exp(log_variance))
            found[..., k] = np.interp(level, _LEVELS, quantiles) * self.y[1, k] * scale
        return found

    def _features(self, predicted: np.ndarray, u: np.ndarray, output: int) -> Float[np.ndarray, "run time feature"]:
        z = _scaled(predicted, self.y[:, output])
        inputs = _scaled(u, self.u)
        passed = np.log1p(np.minimum(np.arange(predicted.shape[1]), self.horizon)) / np.log1p(self.horizon)
        passed = np.broadcast_to(passed, predicted.shape)
        return np.concatenate([np.stack([np.ones_like(z), passed, z, z**2], -1), inputs], -1)


def _scaled(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    centre, scale, low, high = rows
    return (np.clip(values, low, high) - centre) / scale


def left_out(
    validated: Float[np.ndarray, "member seq time y"], validation: Record, datasets: Sequence[int], usable: Sequence[int]
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
        parts.append(LeftOut(predicted, y_hat.std(0), np.where(count, y - predicted, 0.0), u, count > 0))
    return LeftOut(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def calibrate(found: LeftOut) -> Intervals | None:
    """None where an output has no left-out sample."""
    n_y = found.predicted.shape[-1]
    if not found.measured.any((0, 1)).all():
        return None
    outputs = [found.measured[..., k] for k in range(n_y)]
    rows_y = np.stack([_rows(found.predicted[..., k][seen]) for k, seen in enumerate(outputs)], -1)
    seen = found.measured.any(-1)
    rows_u = np.stack([_rows(found.u[..., i][seen]) for i in range(found.u.shape[-1])], -1)
    horizon = np.array(max(1, int(np.max(np.nonzero(seen)[1]))))
    empty = Intervals(np.zeros((n_y, 0)), rows_y, rows_u, horizon, np.zeros((n_y, 0)))
    weights, quantiles = [], []
    for k, measured in enumerate(outputs):
        features = empty._features(found.predicted[..., k], found.u, k)[measured]
        spread, error = (a[..., k][measured] / rows_y[1, k] for a in (found.spread, found.error))
        weights.append(_log_variance(features, spread**2, error**2))
        scores = np.abs(error) / np.sqrt(spread**2 + np.exp(features @ weights[-1]))
        quantiles.append(_quantiles(scores))
    return empty._replace(weights=np.stack(weights), quantiles=np.stack(quantiles))


def _rows(values: np.ndarray) -> np.ndarray:
    scale = float(np.std(values))
    return np.array([np.mean(values), scale if scale > 0 else 1.0, np.min(values), np.max(values)])


def _log_variance(features: np.ndarray, spread: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """w of the largest likelihood, with its prior, of errors whose squares are given; spread: d²."""

    def cost(w: np.ndarray) -> tuple[float, np.ndarray]:
        own = np.exp(np.clip(features @ w, -60.0, 60.0))
        variance = own + spread + _TINY
        value = 0.5 * np.mean(np.log(variance) + squares / variance)
        slope = 0.5 * features.T @ ((1.0 / variance - squares / variance**2) * own) / len(squares)
        pull = np.r_[0.0, w[1:]] * _BLOCK / (len(squares) * _PRIOR**2)
        return value + 0.5 * pull @ w, slope + pull

    start = np.zeros(features.shape[1])
    start[0] = np.log(np.mean(squares) + _TINY)
    return minimize(cost, start, jac=True, method="L-BFGS-B").x


def _quantiles(scores: np.ndarray) -> np.ndarray:
    """The conformal quantiles of n scores: of level (1 + 1/n) level, the largest score above."""
    n = len(scores)
    return np.quantile(scores, np.minimum(_LEVELS * (n + 1) / n, 1.0))


def covered(
    y: np.ndarray, mask: np.ndarray, predicted: np.ndarray, half_width: np.ndarray, n_init: int
) -> tuple[list[float], list[float]]:
    """Share of the measured samples inside, and mean width of the interval, per output; without the first `n_init`."""
    y, mask, predicted, half_width = (a[..., n_init:, :] for a in (y, mask, predicted, half_width))
    inside = np.abs(y - predicted) <= half_width
    axes = tuple(range(y.ndim - 1))
    counts = np.maximum(mask.sum(axes), 1)
    return list((inside & mask).sum(axes) / counts), list(2 * (half_width * mask).sum(axes) / counts)
