"""Errors of a free run that a disturbance of the dynamics leaves, under white noise of the sensors.

    δx_t = A_t δx_{t-1} + g_t d_t        e_t = C_t δx_t + v_t        d_t = a d_{t-1} + w_t

δx: error of the simulated state; A, C: derivatives of the model along its own free run; g: a unit vector of one state,
or the derivatives by one input. Place, size and memory of the disturbance d are those under which the errors are
likeliest (Kalman filters, `kalman.py`). An autoregression of few coefficients does not describe such errors: they are
slow ones under white ones, and those of an integrating axis grow. Source: Ljung, System Identification, 1999, sections
4.3 and 7.4.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery import kalman
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.kalman import Filters, Models
from pgrssnn_jax.discovery.likelihood import Linearisation, Noise, concentrated, sandwich, step_of
from pgrssnn_jax.discovery.noise import white_variance
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.responses import Path, path_of

_SIZES = 10.0 ** np.arange(-1.0, 3.1, 0.5)  # variance of readings by a disturbance, in variances of the white noise
_POLES = np.exp([-np.inf, -1.0 / 10.0, -1.0 / 100.0])  # a: no memory, 10 and 100 samples
_ENOUGH = 4096  # samples of all sequences from which a disturbance is chosen
_MOST = 20_000_000  # numbers of all models: of longer records the noise is coloured, and nothing else is tried
_TINY = 1e-300


class Disturbances(NamedTuple):
    """What may have disturbed a model: filters for every place, memory and size that is tried, over a part of the
    record. white: variances of the sensors' noise that they were made for."""

    models: Models
    part: Models
    white: Float[np.ndarray, " y"]
    filters: Filters

    def like(self, other: Filters) -> "Disturbances":
        """Those of the same place and memory, of every size."""
        return self._replace(filters=self.filters.some(self.filters.model == other.model[0]))


class ProcessNoise(NamedTuple):
    """The likeliest of some disturbances: its filter over the whole record. innovations `[seq, time, y]`; likelihood:
    log-likelihood of the errors."""

    models: Models
    filter: Filters
    innovations: Float[np.ndarray, "seq time y"]
    likelihood: float

    def whitened(self, values: Float[np.ndarray, "seq time y k"]) -> Float[np.ndarray, "seq time y k"]:
        """In standard deviations of the innovations."""
        return kalman.innovations(self.models, self.filter, values)[0] / self.filter.variance[0, ..., None] ** 0.5

    def covariance(self, at: Linearisation, variance: float) -> Float[np.ndarray, "k k"]:
        """Of the least squares estimate; variance: of the weighted errors that the prior's precision belongs to."""
        count, k = at.measured.sum(), at.columns.shape[-1]
        squares = self.innovations**2 * count / max(count - k, 1)
        moved = kalman.answers(self.models, self.filter, at.columns * at.measured[..., None])
        meat = np.einsum("sty,styk,styl->kl", squares, moved, moved, optimize=True)
        return sandwich(at, meat + np.diag(at.precision * variance))


def models_along(problem: Problem, signals: Signals, guess: Guess) -> Models | None:
    """The model of a guess along its free run, None where the record is too long."""
    return models_of(problem, signals, path_of(problem, signals, guess))


def models_of(problem: Problem, signals: Signals, path: Path) -> Models | None:
    """With every disturbance as one more state, behind those of the physics."""
    n, (n_seq, time) = len(problem.physics.states), path.x.shape[:2]
    if n_seq * time * len(_POLES) * (n + path.b.shape[-1]) * (n + 1) ** 2 > _MOST:
        return None
    states = [np.broadcast_to(one, (n_seq, time, n)) for one in np.eye(n)]
    places = np.stack([*states, *np.moveaxis(path.b[..., :n, :], -1, 0)])
    c = path.c[..., :n] * signals.weight[..., None]
    return with_disturbances(path.a[..., :n, :n], places, c, signals.weight > 0, problem.physics.output_timing)


def with_disturbances(
    a: Float[np.ndarray, "seq time x x"],
    places: Float[np.ndarray, "place seq time x"],
    c: Float[np.ndarray, "seq time y x"],
    measured: np.ndarray,
    output_timing: str,
) -> Models:
    n = a.shape[-1]
    g = np.tile(places, (len(_POLES), 1, 1, 1))
    poles = np.repeat(_POLES, len(places))[:, None, None]
    whole = np.zeros((len(g), *a.shape[:2], n + 1, n + 1))
    whole[..., :n, :n], whole[..., :n, n], whole[..., n, n] = a, poles[..., None] * g, poles
    entering = np.concatenate([g, np.ones((*g.shape[:3], 1))], -1)
    seen = np.concatenate([c, np.zeros((*c.shape[:3], 1))], -1)
    return Models(whole, entering, seen, measured, output_timing == "after_step")


def disturbances(models: Models | None, at: Linearisation) -> Disturbances | None:
    """Of every size in every model; None where none of them reaches an output. at: of any model of the record."""
    if models is None:
        return None
    white = white_variance(at.error, at.measured) + _TINY
    with np.errstate(over="ignore", invalid="ignore"):
        reached = (kalman.unmeasured_variance(models) / white)[:, models.measured].mean(1)
    model = np.repeat(np.flatnonzero(np.isfinite(reached) & (reached > _TINY)), len(_SIZES))
    if not len(model):
        return None
    size = (np.tile(_SIZES, len(model) // len(_SIZES)) / reached[model]) ** 0.5
    part = models.first(_ENOUGH)
    return Disturbances(models, part, white, kalman.filters(part, model, size, white))


def likelier(models: Models | None, at: Linearisation, coloured: Noise) -> tuple[Disturbances, ProcessNoise] | None:
    """The likeliest disturbance, where the errors are likelier with it than in coloured noise of the sensors."""
    tried = disturbances(models, at)
    if tried is None:
        return None
    found = process_noise(tried, at)
    return (tried, found) if found.likelihood > coloured.likelihood(at.measured) else None


def process_noise(tried: Disturbances, at: Linearisation) -> ProcessNoise:
    """The likeliest of the disturbances: of the errors as they are, then of what generalised least squares leave of
    them. A third choice changes likelihoods by a nat at most (seeds 886 and 887)."""
    first = _likeliest(tried, at.error)
    found, left = _fitted(tried, first, at)
    second = _likeliest(tried, left)
    return found if second == first else _fitted(tried, second, at)[0]


def _likeliest(tried: Disturbances, error: Float[np.ndarray, "seq time y"]) -> int:
    n_seq, time = tried.part.measured.shape[:2]
    variance = tried.filters.variance
    left = kalman.innovations(tried.part, tried.filters, error[:n_seq, :time, :, None])[..., 0]
    squares, sizes = (one.sum((1, 2, 3)) for one in (left**2 / variance, np.log(variance)))
    likelihood = concentrated(squares, int(tried.part.measured.sum()), sizes)
    return int(np.argmax(np.nan_to_num(likelihood, nan=-np.inf)))  # of a filter that has left the range


def _fitted(
    tried: Disturbances, chosen: int, at: Linearisation
) -> tuple[ProcessNoise, Float[np.ndarray, "seq time y"]]:
    """Generalised least squares by one of the disturbances, and the errors that it leaves."""
    one = _whole(tried, chosen)
    variance = one.variance[0]
    passed = kalman.innovations(tried.models, one, np.concatenate([at.error[..., None], at.columns], -1))[0]
    scaled = at._replace(error=passed[..., 0], columns=passed[..., 1:])
    step = step_of(scaled, at.measured / variance, at.error.var() + _TINY)
    left = scaled.error - scaled.columns @ step
    squares, sizes = np.where(at.measured, (left**2 / variance, np.log(variance)), 0.0).sum((1, 2, 3))
    likelihood = float(concentrated(squares, int(at.measured.sum()), sizes))
    return ProcessNoise(tried.models, one, left, likelihood), np.where(at.measured, at.error - at.columns @ step, 0.0)


def _whole(tried: Disturbances, chosen: int) -> Filters:
    """One of the filters over the whole record."""
    one = tried.filters.some(np.array([chosen]))
    if tried.part.measured.shape == tried.models.measured.shape:
        return one
    return kalman.filters(tried.models, one.model, one.size, tried.white)
