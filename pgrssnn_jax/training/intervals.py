"""Prediction intervals of an ensemble, calibrated on what its members left out of training.

    ŷ_t ± q s_t,      s_t² = d_t² + exp(w · φ_t),      φ_t = [1, horizon, ŷ_t, ŷ_t², u_t]

ŷ: mean over members, d: their standard deviation; φ in scaled units and within the range of the calibration; horizon:
log(1 + t) over that of the longest run. w: largest normal likelihood of the left-out errors, with a normal prior that
pulls towards a constant variance. q: the conformal quantile of |left-out error| / s, so that the share of left-out
samples inside is the level asked for, whatever the law of the errors, and a little more where few of them are
independent.
Sources: Lei, G'Sell, Rinaldo, Tibshirani, Wasserman, Distribution-free predictive inference for regression, JASA 2018,
section 5.2; Barber, Candès, Ramdas, Tibshirani, Predictive inference with the jackknife+, Annals of Statistics 2021.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.records.arguments import shown
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training.left_out import LeftOut

LEVEL = 0.9  # of the intervals that a run reports
N_LEVELS = 401  # at which quantiles are stored
_LEVELS = np.linspace(0.0, 1.0, N_LEVELS)
_PRIOR = 0.5  # standard deviation of w: a signal's deviation changes the variance by a factor of 1.6, give or take
_FAR = 2.0  # deviations from the mean: beyond, the variance is as there, because few samples say what it is
_BLOCK = 32  # samples that count as one, because errors of a free run follow each other; as `DataSettings.block`
_TINY = 1e-12  # of the variance of an output: errors of a model that is exact


class Intervals(NamedTuple):
    """What an interval needs beside the prediction. weights `[y, feature]`: w; y, u: centre, scale, and lowest and
    highest value in training, of outputs and inputs; horizon: samples of the longest run; quantiles `[y, level]`: q at
    evenly spaced levels."""

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
        if isinstance(level, bool) or not isinstance(level, int | float | np.number) or not 0.0 < level < 1.0:
            raise ValueError(f"interval: expected a level between 0 and 1, for example 0.9, found {shown(level)}")
        found = np.empty(predicted.shape)
        for k, (weights, quantiles) in enumerate(zip(self.weights, self.quantiles, strict=True)):
            log_variance = self.features(predicted[..., k], u, k) @ weights
            scale = np.sqrt((spread[..., k] / self.y[1, k]) ** 2 + np.exp(log_variance))
            found[..., k] = np.interp(level, _LEVELS, quantiles) * self.y[1, k] * scale
        return found

    def features(self, predicted: np.ndarray, u: np.ndarray, output: int) -> Float[np.ndarray, "run time feature"]:
        """φ of one output."""
        z = _scaled(predicted, self.y[:, output])
        inputs = _scaled(u, self.u)
        passed = np.log1p(np.minimum(np.arange(predicted.shape[1]), self.horizon)) / np.log1p(self.horizon)
        passed = np.broadcast_to(passed, predicted.shape)
        return np.concatenate([np.stack([np.ones_like(z), passed, z, z**2], -1), inputs], -1)


def _scaled(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    centre, scale, low, high = rows
    return np.clip((np.clip(values, low, high) - centre) / scale, -_FAR, _FAR)


def calibrate(found: LeftOut, seen: Sequence[Record], optimism: float = 1.0) -> Intervals | None:
    """None where an output has no left-out sample. seen: the records of training and validation; optimism: of
    `left_out.optimism`, by which q is multiplied."""
    n_y, counted = found.predicted.shape[-1], found.measured.any(-1)
    if not found.measured.any((0, 1)).all():
        return None
    y = _rows([np.asarray(r.y) for r in seen], [np.asarray(r.mask) for r in seen])
    u = _rows([np.asarray(r.u) for r in seen], [np.ones(r.u.shape, bool) for r in seen])
    horizon = np.array(max(1, int(np.max(np.nonzero(counted)[1]))))
    begun = Intervals(np.zeros((n_y, 0)), y, u, horizon, np.zeros((n_y, 0)))
    weights, quantiles = [], []
    for k in range(n_y):
        measured = found.measured[..., k]
        features = begun.features(found.predicted[..., k], found.u, k)[measured]
        spread, error = (a[..., k][measured] / y[1, k] for a in (found.spread, found.error))
        weights.append(_log_variance(features, spread**2, error**2))
        scores = np.abs(error) / np.sqrt(spread**2 + np.exp(features @ weights[-1]))
        quantiles.append(optimism * _quantiles(scores, found.independent[k]))
    return begun._replace(weights=np.stack(weights), quantiles=np.stack(quantiles))


def _rows(values: Sequence[np.ndarray], counted: Sequence[np.ndarray]) -> Float[np.ndarray, "4 c"]:
    """Centre, scale, lowest and highest of every channel, over all samples that count."""
    chosen = [
        np.concatenate([v[..., k][c[..., k]] for v, c in zip(values, counted, strict=True)]).astype(np.float64)
        for k in range(values[0].shape[-1])
    ]
    return np.array([[one.mean(), one.std() or 1.0, one.min(), one.max()] for one in chosen]).T


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
    return scipy.optimize.minimize(cost, start, jac=True, method="L-BFGS-B").x


def _quantiles(scores: np.ndarray, independent: float) -> np.ndarray:
    """The conformal quantiles of n independent scores: of level (1 + 1/n) level, the largest score above."""
    return np.quantile(scores, np.minimum(_LEVELS * (1.0 + 1.0 / independent), 1.0))


def inside(
    record: Record, predicted: Float[np.ndarray, "seq time y"], half_width: Float[np.ndarray, "seq time y"], n_init: int
) -> tuple[list[float], list[float]]:
    """Share of the measured samples inside and mean width, per output, without the first `n_init` samples."""
    y, mask, middle, half = (np.asarray(a)[:, n_init:] for a in (record.y, record.mask, predicted, half_width))
    count = np.maximum(mask.sum((0, 1)), 1)
    held = mask & (np.abs(y - middle) <= half)
    return (held.sum((0, 1)) / count).tolist(), (2.0 * np.where(mask, half, 0.0).sum((0, 1)) / count).tolist()
