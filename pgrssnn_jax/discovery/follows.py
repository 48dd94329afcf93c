"""Do the errors follow the signals, whatever the law? What chance, or noise in the system itself, makes does not.

    e_t ≈ Σ_{s, j, k} c_{sjk} (h_k * φ_j(s))_t          s: a state of the free run or an input

φ_j: hat functions over the reach of s; h_k: low-pass filters of several time constants, so that a curve may have acted
some time ago. Ridge regression, judged on blocks left out, beside errors of the same spectrum and random phases.
Source: Wiener, Nonlinear problems in random theory, 1958 (filters and curves).
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.discovery.estimate import Estimate
from pgrssnn_jax.discovery.flexible import nearness
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.noise import surrogates
from pgrssnn_jax.discovery.problem import Problem, Signals

_KNOTS = 8  # of a hat function's grid; with the filters 32 features for every signal
_SAMPLES = (0, 4, 16, 64)  # time constants of the filters, 0: none
_RIDGE = 1e-2  # per sample, of features with unit variance
_DRAWS = 200


class Follows(NamedTuple):
    """share: of the error energy in blocks left out that the signals explain; p_value: of as much by luck."""

    share: float
    p_value: float


def errors_follow(problem: Problem, signals: Signals, estimate: Estimate, rng: np.random.Generator) -> Follows:
    """Of a model."""
    _, x = simulate(problem, signals.u, estimate.theta[None], estimate.x0[None])
    return follows(signals, x[0][..., : len(problem.physics.states)], estimate.error, rng)


def follows(
    signals: Signals,
    x: Float[np.ndarray, "seq time x"],
    error: Float[np.ndarray, "seq time y"],
    rng: np.random.Generator,
) -> Follows:
    """x: states of the free run whose weighted errors are given."""
    rates = np.diff(signals.u, axis=1, prepend=signals.u[:, :1])
    features = _features(np.concatenate([x, signals.u, rates], -1))
    samples = features.shape[0] * features.shape[1]
    columns, fold = features.reshape(samples, -1), signals.block.reshape(samples)
    left, whole = 0.0, 0.0
    error = error - error.mean((0, 1))  # a constant follows nothing
    tried = np.concatenate([error[None], surrogates(error, _DRAWS, rng)])
    for j in range(error.shape[-1]):
        counted = ((signals.weight[..., j] > 0) & (signals.block >= 0)).reshape(samples)
        targets = tried[..., j].reshape(1 + _DRAWS, samples).T[counted]
        predicted = _left_out(columns[counted], targets, fold[counted])
        left = left + ((targets - predicted) ** 2).sum(0)
        whole = whole + (targets**2).sum(0)
    share = 1.0 - left / np.maximum(whole, 1e-300)
    return Follows(float(share[0]), float((1 + (share[1:] >= share[0]).sum()) / (1 + _DRAWS)))


def _features(s: Float[np.ndarray, "seq time s"]) -> Float[np.ndarray, "seq time feature"]:
    low, high = s.min((0, 1)), s.max((0, 1))
    hats = nearness(s, low, np.where(high > low, high, low + 1.0), _KNOTS).reshape(*s.shape[:2], -1)
    hats = hats - hats.mean((0, 1))  # filters begin at rest
    filtered = [scipy.signal.lfilter([1.0 / (1 + k)], [1.0, -k / (1 + k)], hats, axis=1) for k in _SAMPLES]
    found = np.concatenate(filtered, -1)
    return found / np.maximum(found.std((0, 1)), 1e-12)


def _left_out(columns: np.ndarray, targets: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Predictions of the samples of each fold from the others."""
    columns = np.column_stack([columns, np.ones(len(columns))])
    predicted = np.zeros_like(targets)
    for k in np.unique(fold):
        own = fold == k
        seen = columns[~own]
        normal = seen.T @ seen + _RIDGE * len(seen) * np.eye(columns.shape[1])
        predicted[own] = columns[own] @ np.linalg.solve(normal, seen.T @ targets[~own])
    return predicted
