"""How well a fitted model predicts, how sure its numbers are, and what its noise is like, all from one linearisation.

    e(β) = e - J β                                  log L = -½ n log Σ e²        (free-run errors, weighted)
    A_j(z) e_j = ε_j                                A_j(z) = 1 - a_1 z⁻¹ - ... - a_p z⁻ᵖ, one per output
    cov β = H⁻¹ (Σ_t ε_t² g_t g_tᵀ + Λ σ²) H⁻¹      H = JᵀJ + Λ,  g = A⁻ᵀ J,  Λ: precision of the prior
    var β = (B - 1) / B Σ_b (β_b - β)²              β_b: without block b of B equal ones

Models are fitted by least squares, because they are to simulate; their noise may have a colour A of its own and be
larger at some times than at others, which the sandwich keeps. The colour is estimated beside β by generalised least
squares, or the fit would have bleached it. A disturbance of the dynamics gives errors that such a colour does not
describe, because they pass the same modes as the sensitivities; the jackknife only asks that errors forget within a
block. Sources: Cochrane, Orcutt, J. Am. Stat. Assoc. 44, 1949; White, Econometrica 48, 1980; MacKinnon, Nielsen, Webb,
J. Appl. Econometrics 38, 2023 (few blocks, Student's t).
"""

from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from pgrssnn_jax.discovery.noise import ORDER, autoregression, correlation_time, recoloured

_ROUNDS = 3  # of Cochrane and Orcutt: with one, 10 % of tests at the 5 % level reject in AR(0.9) noise
_RIDGE = 1e-10  # of a column's energy
_TINY = 1e-300
_NOTHING = 1e-280  # of an energy, whose inverse over the ridge is still a number
_BLOCKS = 8  # of the jackknife, in a record; of 360 parameters 93, 95, 93, 93, 89 % are covered with 6, 8, 12, 20, 40
_TOLD_BY_ONE = 4.0  # growth of a variance without one fold, which tells three quarters: a line does not reach that far
_SAID_BY_ONE = 2.0  # growth of a variance without one block, above which the jackknife cannot judge a number


class Linearisation(NamedTuple):
    """error `[seq, time, y]`, 0 where not measured; columns `[seq, time, y, k]`; measured; precision `[k]`: Λ, in units
    of the weighted errors; pull `[k]`: Λ times what the prior expects of β."""

    error: Float[np.ndarray, "seq time y"]
    columns: Float[np.ndarray, "seq time y k"]
    measured: Bool[np.ndarray, "seq time y"]
    precision: Float[np.ndarray, " k"]
    pull: Float[np.ndarray, " k"]


class Noise(NamedTuple):
    """filters `[y, p + 1]`: 1, -a_1, ...; innovations `[seq, time, y]`."""

    filters: Float[np.ndarray, "y lag"]
    innovations: Float[np.ndarray, "seq time y"]

    def recoloured(self, draws: int, rng: np.random.Generator) -> Float[np.ndarray, "draw seq time y"]:
        """Errors whose innovations have random signs."""
        return recoloured(self.innovations, self.filters, draws, rng)

    def likelihood(self, measured: Bool[np.ndarray, "seq time y"]) -> float:
        """Log-likelihood of the errors."""
        squares = np.where(measured, self.innovations**2, 0.0).sum((0, 1))
        return float(concentrated(squares, measured.sum((0, 1))).sum())


def concentrated(squares: Any, count: Any, sizes: Any = 0.0) -> Any:
    """Log-likelihood of normal errors at the likeliest size of all of them together.

        -½ (n log(2π Σ ε²/v / n) + n + Σ log v)

    squares: Σ ε²/v; count: n; sizes: Σ log v, v: their variances up to that size."""
    return -0.5 * (count * (np.log(2.0 * np.pi * squares / np.maximum(count, 1) + _TINY) + 1.0) + sizes)


def left_out(
    at: Linearisation, fold: Int[np.ndarray, "seq time"], block: int
) -> tuple[Float[np.ndarray, " block"], Int[np.ndarray, " block"]]:
    """Squared errors of every block of `block` samples by fits to the other folds, and how many samples they are. A
    number that one fold tells by three quarters stays as it is there: a line would lead it far, and not to what a fit
    without that fold finds."""
    squares, counts = np.zeros(at.error.shape), at.measured & (fold >= 0)[..., None]
    every = _variances(at, np.where(at.measured, 1.0, 0.0))
    for f in range(int(fold.max(initial=0)) + 1):
        rest = np.where(at.measured & (fold != f)[..., None], 1.0, 0.0)
        told = _variances(at, rest) < _TOLD_BY_ONE * every
        step = step_of(at._replace(columns=at.columns * told), rest)
        left = at.error - at.columns @ np.where(told, step, 0.0)
        squares = np.where(counts & (fold == f)[..., None], left**2, squares)
    edges = np.arange(0, at.error.shape[1], block)
    return _sums(squares, edges), _sums(counts * 1, edges)


def _sums(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return np.add.reduceat(values.sum(-1), edges, axis=1).ravel()


def noise_of(at: Linearisation, order: int = ORDER) -> Noise:
    """Colour and innovations, at the generalised least squares estimate of β."""

    def colour(left: Float[np.ndarray, "seq time y"]) -> Float[np.ndarray, "y lag"]:
        return np.stack([autoregression(left[..., j], at.measured[..., j], order) for j in range(left.shape[-1])])

    left, filters = at.error, colour(at.error)
    for _ in range(_ROUNDS):
        variance = np.maximum((_filtered(left, filters) ** 2).mean((0, 1)), _TINY)
        scaled = at._replace(error=_filtered(at.error, filters), columns=_filtered(at.columns, filters))
        step = step_of(scaled, at.measured / variance, at.error.var() + _TINY)
        left = np.where(at.measured, at.error - at.columns @ step, 0.0)
        filters = colour(left)
    return Noise(filters, _filtered(left, filters))


@np.errstate(over="ignore", invalid="ignore")  # of a run that nearly leaves the range
def covariance(at: Linearisation, noise: Noise, variance: float) -> tuple[Float[np.ndarray, "k k"], float]:
    """Covariance of the least squares estimate, and its degrees of freedom: independent samples less numbers. variance:
    of the weighted errors that the prior's precision belongs to."""
    k = at.columns.shape[-1]
    meat, independent = np.diag(at.precision * variance), 0.0
    for j, colour in enumerate(noise.filters):
        n = int(at.measured[..., j].sum())
        columns = at.columns[..., j, :] * at.measured[..., j, None]
        g = np.asarray(scipy.signal.lfilter([1.0], colour, columns[:, ::-1], axis=1))[:, ::-1]
        own = _filtered(at.error, noise.filters)[..., j] ** 2 * n / max(n - k - len(colour) + 1, 1)
        meat = meat + np.einsum("st,stk,stl->kl", own, g, g, optimize=True)
        independent += n / correlation_time(colour)
    return sandwich(at, meat), max(independent - k, 3.0)


def sandwich(at: Linearisation, meat: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """H⁻¹ M H⁻¹"""
    columns = at.columns * at.measured[..., None]
    normal = np.einsum("styk,styl->kl", columns, columns, optimize=True) + np.diag(at.precision)
    size = np.sqrt(np.maximum(np.diag(normal), _TINY))
    inverse = np.linalg.pinv(normal / size / size[:, None], rcond=1e-10, hermitian=True) / size / size[:, None]
    return inverse @ meat @ inverse


def deviations(at: Linearisation, noise: Noise, variance: float) -> tuple[Float[np.ndarray, " k"], float]:
    """Standard deviations of the estimate for 95 % intervals, and their degrees of freedom: the larger one of the
    sandwich and the jackknife."""
    coloured, freedom = covariance(at, noise, variance)
    by_colour, by_blocks = np.sqrt(np.maximum(np.diag(coloured), 0.0)), _jackknifed(at)
    wider = scipy.stats.t.ppf(0.975, _BLOCKS - 1) / scipy.stats.t.ppf(0.975, freedom)
    return np.maximum(by_colour, wider * by_blocks), freedom


def _jackknifed(at: Linearisation) -> Float[np.ndarray, " k"]:
    """0 for a number about which one block says as much as all others together."""
    n_seq, time = at.error.shape[:2]
    place = (np.arange(n_seq)[:, None] + np.arange(time) / time) / n_seq  # of a sample in the record, 0 to 1
    if n_seq >= _BLOCKS:
        place = np.repeat(np.arange(n_seq)[:, None] / n_seq, time, 1)
    block = (place * _BLOCKS).astype(int)
    parts = [np.where(at.measured & (block != b)[..., None], 1.0, 0.0) for b in range(_BLOCKS)]
    every = np.where(at.measured, 1.0, 0.0)
    changes = np.stack([step_of(at, part) for part in parts]) - step_of(at, every)
    growth = np.max([_variances(at, part) for part in parts], 0) / _variances(at, every)
    found = np.sqrt((_BLOCKS - 1) / _BLOCKS * (changes**2).sum(0))
    return np.where(growth < _SAID_BY_ONE, found, 0.0)


def _variances(at: Linearisation, weight: Float[np.ndarray, "seq time y"]) -> Float[np.ndarray, " k"]:
    """Of the estimate in white noise of unit size."""
    _, normal, size = _normal(at, weight, 1.0)
    return np.maximum(np.diag(np.linalg.inv(normal)), _TINY) / size**2


def step_of(at: Linearisation, weight: Float[np.ndarray, "seq time y"], unit: float = 1.0) -> Float[np.ndarray, " k"]:
    """β of weighted least squares; unit: variance that the prior's precision belongs to."""
    weighted, normal, size = _normal(at, weight, unit)
    return np.linalg.solve(normal, (weighted.T @ at.error.ravel() + at.pull / unit) / size) / size


def _normal(
    at: Linearisation, weight: Float[np.ndarray, "seq time y"], unit: float
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
    """Weighted columns; the normal matrix of columns of unit size, with a ridge; their sizes."""
    k = at.columns.shape[-1]
    columns = at.columns.reshape(-1, k)
    weighted = columns * np.broadcast_to(weight, at.error.shape).reshape(-1, 1)
    normal = weighted.T @ columns + np.diag(at.precision) / unit
    size = np.sqrt(np.maximum(np.diag(normal), _NOTHING))
    return weighted, normal / size / size[:, None] + _RIDGE * np.eye(k), size


def _filtered(values: np.ndarray, filters: Float[np.ndarray, "y lag"]) -> np.ndarray:
    """A_j(z) of values `[seq, time, y, ...]`. By shifts, because scipy.signal.lfilter takes four times longer here."""
    found = values.copy()
    for lag in range(1, filters.shape[1]):
        weight = filters[:, lag].reshape(-1, *(1,) * (values.ndim - 3))
        found[:, lag:] += weight * values[:, :-lag]
    return found
