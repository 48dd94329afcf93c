"""Figures of merit of a predicted output. Keyword-only, because NRMSE is not symmetric.

All take `measured` and `predicted` of shape `[seq, time, y]`, an optional `mask` of that shape and
`n_init`, the number of first samples of every sequence that do not count, and give one value per
output, shape `[y]`. NumPy in float64, whatever the rollout used.
"""

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.records import Array


def _counted(measured: Array, predicted: Array, mask: Array | None, n_init: int) -> tuple[np.ma.MaskedArray, ...]:
    measured, predicted = np.asarray(measured, np.float64), np.asarray(predicted, np.float64)
    if measured.shape != predicted.shape:
        raise ValueError(f"metrics: predicted: expected shape {measured.shape}, found {predicted.shape}")
    if not 0 <= n_init < measured.shape[1]:
        raise ValueError(f"metrics: n_init: expected 0 to {measured.shape[1] - 1}, found {n_init}")
    hidden = np.zeros(measured.shape, bool) if mask is None else ~np.broadcast_to(mask, measured.shape)
    keep = np.s_[:, n_init:, :]
    return np.ma.array(measured[keep], mask=hidden[keep]), np.ma.array(predicted[keep], mask=hidden[keep])


def _per_output(values: np.ma.MaskedArray) -> np.ndarray:
    return np.ma.filled(np.ma.asarray(values).astype(np.float64), np.nan)


def rmse(*, measured: Array, predicted: Array, n_init: int, mask: Array | None = None) -> Float[np.ndarray, " y"]:
    """sqrt(mean((y - ŷ)²)), in the unit of y."""
    y, y_hat = _counted(measured, predicted, mask, n_init)
    return _per_output(np.ma.sqrt(((y - y_hat) ** 2).mean((0, 1))))


def nrmse(*, measured: Array, predicted: Array, n_init: int, mask: Array | None = None) -> Float[np.ndarray, " y"]:
    """RMSE / std(y), std of the measured samples that count (population form); NaN for a constant y."""
    y, _ = _counted(measured, predicted, mask, n_init)
    deviation = _per_output(y.std((0, 1)))
    error = rmse(measured=measured, predicted=predicted, n_init=n_init, mask=mask)
    return np.divide(error, deviation, out=np.full_like(error, np.nan), where=deviation > 0)


def fit_percent(
    *, measured: Array, predicted: Array, n_init: int, mask: Array | None = None
) -> Float[np.ndarray, " y"]:
    """100 (1 - ‖y - ŷ‖ / ‖y - mean(y)‖) = 100 (1 - NRMSE), in percent; negative when worse than the mean."""
    return 100.0 * (1.0 - nrmse(measured=measured, predicted=predicted, n_init=n_init, mask=mask))


def correlation(
    *, measured: Array, predicted: Array, n_init: int, mask: Array | None = None
) -> Float[np.ndarray, " y"]:
    """Pearson's correlation coefficient CC of y and ŷ; NaN where one of them is constant."""
    y, y_hat = _counted(measured, predicted, mask, n_init)
    y, y_hat = y - y.mean((0, 1)), y_hat - y_hat.mean((0, 1))
    covariance = _per_output((y * y_hat).mean((0, 1)))
    scale = _per_output(np.ma.sqrt((y**2).mean((0, 1)) * (y_hat**2).mean((0, 1))))
    return np.divide(covariance, scale, out=np.full_like(scale, np.nan), where=scale > 0)


def all_metrics(*, measured: Array, predicted: Array, n_init: int, mask: Array | None = None) -> dict[str, list[float]]:
    """The four figures under the names of `metrics.json`: rmse, nrmse, fit_percent, cc; one value per output."""
    named = {"rmse": rmse, "nrmse": nrmse, "fit_percent": fit_percent, "cc": correlation}
    return {
        name: metric(measured=measured, predicted=predicted, n_init=n_init, mask=mask).tolist()
        for name, metric in named.items()
    }
