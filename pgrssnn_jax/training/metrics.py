"""Figures of merit of a predicted output. Keyword-only, because NRMSE is not symmetric.

All take `measured` and `predicted` of shape `[seq, time, y]`, an optional `mask` of that shape and
`n_init`, the number of first samples of every sequence that do not count, and give one value per
output, shape `[y]`. NumPy in float64, whatever the rollout used.
"""

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.records.record import Array


def _counted(measured: Array, predicted: Array, mask: Array | None, n_init: int) -> tuple[np.ndarray, ...]:
    """y, ŷ and which samples count, without the first n_init."""
    measured, predicted = np.asarray(measured, np.float64), np.asarray(predicted, np.float64)
    if measured.ndim != 3:
        raise ValueError(f"metrics: measured: expected shape [seq, time, y], found {measured.shape}")
    if measured.shape != predicted.shape:
        raise ValueError(f"metrics: predicted: expected shape {measured.shape}, found {predicted.shape}")
    if not 0 <= n_init < measured.shape[1]:
        raise ValueError(f"metrics: n_init: expected 0 to {measured.shape[1] - 1}, found {n_init}")
    counts = np.ones(measured.shape, bool) if mask is None else np.broadcast_to(mask, measured.shape)
    keep = np.s_[:, n_init:, :]
    return measured[keep], predicted[keep], counts[keep]


def _mean(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Per output, over the samples that count; NaN if none does, not finite if one of them is not."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return np.where(counts, values, 0.0).sum((0, 1)) / counts.sum((0, 1))


def _varies(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    low, high = np.where(counts, values, np.inf).min((0, 1)), np.where(counts, values, -np.inf).max((0, 1))
    return high > low


def rmse(*, measured: Array, predicted: Array, n_init: int, mask: Array | None = None) -> Float[np.ndarray, " y"]:
    """sqrt(mean((y - ŷ)²)), in the unit of y."""
    y, y_hat, counts = _counted(measured, predicted, mask, n_init)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sqrt(_mean((y - y_hat) ** 2, counts))


def nrmse(*, measured: Array, predicted: Array, n_init: int, mask: Array | None = None) -> Float[np.ndarray, " y"]:
    """RMSE / std(y), std of the measured samples that count (population form); NaN for a constant y."""
    y, _, counts = _counted(measured, predicted, mask, n_init)
    deviation = np.sqrt(_mean((y - _mean(y, counts)) ** 2, counts))
    error = rmse(measured=measured, predicted=predicted, n_init=n_init, mask=mask)
    return np.divide(error, deviation, out=np.full_like(error, np.nan), where=_varies(y, counts))


def fit_percent(
    *, measured: Array, predicted: Array, n_init: int, mask: Array | None = None
) -> Float[np.ndarray, " y"]:
    """100 (1 - ‖y - ŷ‖ / ‖y - mean(y)‖) = 100 (1 - NRMSE), in percent; negative when worse than the mean."""
    return 100.0 * (1.0 - nrmse(measured=measured, predicted=predicted, n_init=n_init, mask=mask))


def correlation(
    *, measured: Array, predicted: Array, n_init: int, mask: Array | None = None
) -> Float[np.ndarray, " y"]:
    """Pearson's correlation coefficient CC of y and ŷ; NaN where one of them is constant."""
    y, y_hat, counts = _counted(measured, predicted, mask, n_init)
    usable = _varies(y, counts) & _varies(y_hat, counts)
    with np.errstate(invalid="ignore", over="ignore"):
        y, y_hat = y - _mean(y, counts), y_hat - _mean(y_hat, counts)
        covariance = _mean(y * y_hat, counts)
        scale = np.sqrt(_mean(y**2, counts) * _mean(y_hat**2, counts))
    return np.divide(covariance, scale, out=np.full_like(scale, np.nan), where=usable & (scale > 0))


def all_metrics(*, measured: Array, predicted: Array, n_init: int, mask: Array | None = None) -> dict[str, list[float]]:
    """The four figures under the names of `metrics.json`: rmse, nrmse, fit_percent, cc; one value per output."""
    named = {"rmse": rmse, "nrmse": nrmse, "fit_percent": fit_percent, "cc": correlation}
    return {
        name: metric(measured=measured, predicted=predicted, n_init=n_init, mask=mask).tolist()
        for name, metric in named.items()
    }
