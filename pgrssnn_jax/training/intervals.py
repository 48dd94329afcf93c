"""Prediction intervals of an ensemble, calibrated on what its members left out of training.

    ŷ_t ± q s_t,      s_t² = v_t (1 + (b · ψ_t)² + ψ_t · C ψ_t),      v_t = d_t² + exp(w · φ_t)
    φ_t = [1, horizon, ŷ_t, ŷ_t², u_t],      ψ_t = [1, horizon, ŷ_t, u_t]

ŷ: mean over members, d: their standard deviation; φ, ψ in scaled units, φ within the range of the calibration;
horizon: log(1 + t) over that of the longest run. w: largest normal likelihood of the left-out errors e, with a normal
prior that pulls towards a constant variance. b, C: mean and covariance of β in e_t / sqrt(v_t) = β · ψ_t + ε_t, ε of
unit variance, β of a unit normal prior, from n independent errors. They make the interval grow with the distance from
what training has seen, the sooner the fewer independent errors there are. q: the conformal quantile of |e| / s, so that
the share of left-out samples inside is the level asked for, whatever the law of the errors, and a little more where few
of them are independent.
Sources: Lei, G'Sell, Rinaldo, Tibshirani, Wasserman, Distribution-free predictive inference for regression, JASA 2018,
section 5.2; Barber, Candès, Ramdas, Tibshirani, Predictive inference with the jackknife+, Annals of Statistics 2021;
Bishop, Pattern recognition and machine learning, 2006, section 3.3.2, for β.
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
    evenly spaced levels; mean `[y, linear]`, covariance `[y, linear, linear]`: b, C."""

    weights: Float[np.ndarray, "y feature"]
    y: Float[np.ndarray, "4 y"]
    u: Float[np.ndarray, "4 u"]
    horizon: np.ndarray
    quantiles: Float[np.ndarray, "y level"]
    mean: Float[np.ndarray, "y linear"]
    covariance: Float[np.ndarray, "y linear linear"]

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
        for k, quantiles in enumerate(self.quantiles):
            scale = self.scale(predicted[..., k], spread[..., k], u, k)
            found[..., k] = np.interp(level, _LEVELS, quantiles) * self.y[1, k] * scale
        return found

    def scale(self, predicted: np.ndarray, spread: np.ndarray, u: np.ndarray, k: int) -> Float[np.ndarray, "run time"]:
        """s of output k, in its scale."""
        near, far = self.within(predicted, u, k), self.features(predicted, u, k)
        variance = (spread / self.y[1, k]) ** 2 + np.exp(near @ self.weights[k])
        unsure = (far @ self.mean[k]) ** 2 + np.einsum("...i,ij,...j->...", far, self.covariance[k], far)
        return np.sqrt(variance * (1.0 + unsure))

    def features(self, predicted: np.ndarray, u: np.ndarray, k: int) -> Float[np.ndarray, "run time linear"]:
        """ψ of output k."""
        passed = np.log1p(np.arange(predicted.shape[1])) / np.log1p(self.horizon)
        (centre, scale, *_), inputs = self.y[:, k], (u - self.u[0]) / self.u[1]
        alike = np.broadcast_arrays(1.0, passed, (predicted - centre) / scale)
        return np.concatenate([np.stack(alike, -1), inputs], -1)

    def within(self, predicted: np.ndarray, u: np.ndarray, k: int) -> Float[np.ndarray, "run time feature"]:
        """φ of output k."""
        found = self.features(np.clip(predicted, *self.y[2:, k]), np.clip(u, *self.u[2:]), k)
        passed, rest = np.minimum(found[..., 1:2], 1.0), np.clip(found[..., 2:], -_FAR, _FAR)
        return np.concatenate([found[..., :1], passed, rest[..., :1], rest[..., :1] ** 2, rest[..., 1:]], -1)


def calibrate(found: LeftOut, seen: Sequence[Record], optimism: float = 1.0) -> Intervals | None:
    """None where an output has no left-out sample. seen: the records of training and validation; optimism: of
    `left_out.optimism`, by which q is multiplied."""
    n_y, counted = found.predicted.shape[-1], found.measured.any(-1)
    if not found.measured.any((0, 1)).all():
        return None
    y = _rows([np.asarray(r.y) for r in seen], [np.asarray(r.mask) for r in seen])
    u = _rows([np.asarray(r.u) for r in seen], [np.ones(r.u.shape, bool) for r in seen])
    horizon = np.array(max(1, int(np.max(np.nonzero(counted)[1]))))
    linear = 3 + found.u.shape[-1]
    zeros = [np.zeros(shape) for shape in ((n_y, linear + 1), (n_y, 0), (n_y, linear), (n_y, linear, linear))]
    begun = Intervals(zeros[0], y, u, horizon, *zeros[1:])
    quantiles = []
    for k in range(n_y):
        measured, runs = found.measured[..., k], (found.predicted[..., k], found.spread[..., k], found.u, k)
        near, far = (features(runs[0], found.u, k)[measured] for features in (begun.within, begun.features))
        error, spread = (a[..., k][measured] / y[1, k] for a in (found.error, found.spread))
        begun.weights[k] = _log_variance(near, spread**2, error**2)
        share = found.independent[k] / len(error)
        standardised = error / begun.scale(*runs)[measured]  # by sqrt(v): b and C are still zero
        begun.covariance[k] = np.linalg.inv(np.eye(linear) + share * far.T @ far)
        begun.mean[k] = begun.covariance[k] @ (share * far.T @ standardised)
        quantiles.append(optimism * _quantiles(np.abs(error) / begun.scale(*runs)[measured], found.independent[k]))
    return begun._replace(quantiles=np.stack(quantiles))


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
