"""Errors of a free run that a disturbance of the dynamics leaves, under white noise: the innovations form.

    x_t = A_t (x_{t-1} + K_{t-1} ε_{t-1})        e_t = C_t x_t + ε_t        cov ε_t = C_t P_t C_tᵀ + R

x: error of the simulated state; A, C: derivatives of the model along its own free run; K, P: of the Kalman filter for a
white disturbance that enters one equation, or with one input, in every sample. The equation and the size of the
disturbance are those under which the errors are likeliest; R: white noise of every output. An autoregression of few
coefficients does not describe such errors: they are slow ones under white ones, and those of an integrating axis grow.
Source: Ljung, System Identification, 1999, sections 4.3 and 7.4.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.likelihood import Linearisation, sandwich, step_of
from pgrssnn_jax.discovery.noise import white_variance
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.responses import Path, path_of

_SIZES = 10.0 ** np.arange(-1.0, 3.1, 0.5)  # variance of readings by a disturbance, in variances of the white noise
_ENOUGH = 4096  # samples of all sequences from which a disturbance is chosen
_TINY = 1e-300


class Plant(NamedTuple):
    """A model along its free run. c: of weighted outputs; entering: a unit vector of each state, and the derivatives by
    each input; after: are outputs read after the step?"""

    a: Float[np.ndarray, "seq time x x"]
    c: Float[np.ndarray, "seq time y x"]
    measured: Bool[np.ndarray, "seq time y"]
    entering: Float[np.ndarray, "place seq time x"]
    after: bool


class Filters(NamedTuple):
    """Kalman filters. gains: by how much x moves with one innovation, 0 where nothing was measured; variance of the
    innovations."""

    gains: Float[np.ndarray, "filter seq time y x"]
    variance: Float[np.ndarray, "filter seq time y"]


class Disturbances(NamedTuple):
    """What may have disturbed a plant: drives, one for each place and size that is tried, with their places and the
    variances of the white noise of outputs that they were made for; filters: over the first `time` samples."""

    plant: Plant
    white: Float[np.ndarray, " y"]
    drives: Float[np.ndarray, "filter seq time x"]
    places: Int[np.ndarray, " filter"]
    filters: Filters
    time: int

    def at(self, place: int) -> "Disturbances":
        """Those that enter there."""
        own = self.places == place
        filters = Filters(self.filters.gains[own], self.filters.variance[own])
        return self._replace(drives=self.drives[own], places=self.places[own], filters=filters)


class ProcessNoise(NamedTuple):
    """The likeliest of some disturbances. innovations `[seq, time, y]`; likelihood: log-likelihood of the errors."""

    plant: Plant
    place: int
    filters: Filters
    innovations: Float[np.ndarray, "seq time y"]
    likelihood: float

    def recoloured(self, draws: int, rng: np.random.Generator) -> Float[np.ndarray, "draw seq time y"]:
        """Errors whose innovations have random signs."""
        signs = rng.integers(0, 2, (draws, *self.innovations.shape[:2], 1)) * 2.0 - 1.0
        drawn = np.moveaxis(signs * self.innovations, 0, -1)
        return np.moveaxis(_through(self.plant, self.filters, drawn, whiten=False), -1, 0)

    def covariance(self, at: Linearisation, variance: float) -> Float[np.ndarray, "k k"]:
        """Of the least squares estimate; variance: of the weighted errors that the prior's precision belongs to."""
        count, k = at.measured.sum(), at.columns.shape[-1]
        squares = self.innovations**2 * count / max(count - k, 1)
        moved = _answered(self.plant, self.filters, at.columns * at.measured[..., None])
        meat = np.einsum("sty,styk,styl->kl", squares, moved, moved, optimize=True)
        return sandwich(at, meat + np.diag(at.precision * variance))


def plant_along(problem: Problem, signals: Signals, guess: Guess) -> Plant:
    """The model of a guess along its free run."""
    return plant_of(problem, signals, path_of(problem, signals, guess))


def plant_of(problem: Problem, signals: Signals, path: Path) -> Plant:
    n = len(problem.physics.states)
    states = [np.broadcast_to(one, path.x[..., :n].shape) for one in np.eye(n)]
    entering = np.stack([*states, *np.moveaxis(path.b[..., :n, :], -1, 0)])
    after = problem.physics.output_timing == "after_step"
    return Plant(path.a[..., :n, :n], path.c[..., :n] * signals.weight[..., None], signals.weight > 0, entering, after)


def disturbances(plant: Plant, at: Linearisation) -> Disturbances | None:
    """Of every size at every place; None where none of them reaches an output. at: of any model of the record."""
    white = white_variance(at.error, at.measured) + _TINY
    with np.errstate(over="ignore", invalid="ignore"):
        reached = (_unmeasured_variance(plant) / white)[:, plant.measured].mean(1)
    places = np.repeat(np.flatnonzero(np.isfinite(reached) & (reached > _TINY)), len(_SIZES))
    if not len(places):
        return None
    size = np.tile(_SIZES, len(places) // len(_SIZES)) / reached[places]
    drives = plant.entering[places] * size[:, None, None, None] ** 0.5
    time = min(plant.a.shape[1], max(1, _ENOUGH // len(plant.a)))
    return Disturbances(plant, white, drives, places, _filters(plant, drives, white, time), time)


def process_noise(tried: Disturbances, at: Linearisation) -> ProcessNoise:
    """The likeliest of the disturbances: of the errors as they are, then of what generalised least squares leave of
    them. A third choice changes likelihoods by a nat at most (seeds 886 and 887)."""
    first = _likeliest(tried, at.error)
    found, left = _fitted(tried, first, at)
    second = _likeliest(tried, left)
    return found if second == first else _fitted(tried, second, at)[0]


def _fitted(
    tried: Disturbances, chosen: int, at: Linearisation
) -> tuple[ProcessNoise, Float[np.ndarray, "seq time y"]]:
    """Generalised least squares by one of the disturbances, and the errors that it leaves."""
    filters = _whole(tried, chosen)
    variance = filters.variance[0]
    passed = _through(tried.plant, filters, np.concatenate([at.error[..., None], at.columns], -1), whiten=True)
    scaled = at._replace(error=passed[..., 0], columns=passed[..., 1:])
    step = step_of(scaled, at.measured / variance, at.error.var() + _TINY)
    innovations = scaled.error - scaled.columns @ step
    squares = np.where(at.measured, innovations**2 / variance, 0.0).sum()
    sizes = np.where(at.measured, np.log(variance), 0.0).sum()
    likelihood = float(_concentrated(squares, sizes, int(at.measured.sum())))
    found = ProcessNoise(tried.plant, int(tried.places[chosen]), filters, innovations, likelihood)
    return found, np.where(at.measured, at.error - at.columns @ step, 0.0)


def _whole(tried: Disturbances, best: int) -> Filters:
    """One of the filters over the whole record."""
    time = tried.plant.a.shape[1]
    if tried.time == time:
        return Filters(tried.filters.gains[[best]], tried.filters.variance[[best]])
    return _filters(tried.plant, tried.drives[[best]], tried.white, time)


def _likeliest(tried: Disturbances, error: Float[np.ndarray, "seq time y"]) -> int:
    (a, c, measured, _, after), (gains, variance) = tried.plant, tried.filters
    x, squares = np.zeros((*gains.shape[:2], a.shape[-1])), np.zeros(len(gains))
    for t in range(tried.time):
        x = (a[:, t] @ x[..., None])[..., 0] if after else x
        for j in range(c.shape[2]):
            innovation = np.where(measured[:, t, j], error[:, t, j] - (x * c[:, t, j]).sum(-1), 0.0)
            x = x + gains[:, :, t, j] * innovation[..., None]
            squares += (innovation**2 / variance[:, :, t, j]).sum(-1)
        x = x if after else (a[:, t] @ x[..., None])[..., 0]
    sizes = np.log(variance).sum((1, 2, 3))
    return int(np.argmax(_concentrated(squares, sizes, int(measured[:, : tried.time].sum()))))


def _concentrated(squares: Any, sizes: Any, count: int) -> Any:
    """Log-likelihood at the likeliest size of all noise together."""
    return -0.5 * (count * (np.log(2.0 * np.pi * squares / count + _TINY) + 1.0) + sizes)


def _unmeasured_variance(plant: Plant) -> Float[np.ndarray, "place seq time y"]:
    """C P Cᵀ of a disturbance of unit size at every place, when nothing is measured."""
    g, c = plant.entering, plant.c
    p, found = np.zeros((*g.shape[:2], g.shape[-1], g.shape[-1])), np.zeros((len(g), *c.shape[:3]))
    for t in range(g.shape[2]):
        old = p
        p = _propagated(plant, p, g, t)
        found[:, :, t] = np.einsum("syi,psij,syj->psy", c[:, t], p if plant.after else old, c[:, t])
    return found


def _propagated(plant: Plant, p: np.ndarray, drives: Float[np.ndarray, "filter seq time x"], t: int) -> np.ndarray:
    """A P Aᵀ + g gᵀ"""
    a, g = plant.a[:, t], drives[:, :, t]
    return a @ p @ a.swapaxes(1, 2) + g[..., None] * g[..., None, :]


def _filters(
    plant: Plant, drives: Float[np.ndarray, "filter seq time x"], white: Float[np.ndarray, " y"], time: int
) -> Filters:
    """Outputs are read one after the other, because their noise is independent."""
    (count, n_seq, _, n), n_y = drives.shape, len(white)
    gains, variance = np.zeros((count, n_seq, time, n_y, n)), np.ones((count, n_seq, time, n_y))
    p = np.zeros((count, n_seq, n, n))
    for t in range(time):
        p = _propagated(plant, p, drives, t) if plant.after else p
        for j in range(n_y):
            c, there = plant.c[:, t, j], plant.measured[:, t, j]
            moved = np.where(there[:, None], (p @ c[..., None])[..., 0], 0.0)
            spread = (moved * c).sum(-1) + white[j]
            gain = moved / spread[..., None]
            gains[:, :, t, j], variance[:, :, t, j] = gain, np.where(there, spread, 1.0)
            p = p - moved[..., None] * gain[..., None, :]
        p = p if plant.after else _propagated(plant, p, drives, t)
    return Filters(gains, variance)


def _through(
    plant: Plant, chosen: Filters, values: Float[np.ndarray, "seq time y k"], *, whiten: bool
) -> Float[np.ndarray, "seq time y k"]:
    """Innovations of errors, or errors of innovations, of independent columns, by one filter."""
    gains = chosen.gains[0]
    x, found = np.zeros((len(plant.a), plant.a.shape[-1], values.shape[-1])), np.zeros(values.shape)
    for t in range(plant.a.shape[1]):
        x = plant.a[:, t] @ x if plant.after else x
        for j in range(values.shape[2]):
            expected = (plant.c[:, t, j, None] @ x)[:, 0]
            there, now = plant.measured[:, t, j, None], values[:, t, j]
            innovation = np.where(there, now - expected if whiten else now, 0.0)
            found[:, t, j] = np.where(there, innovation if whiten else now + expected, 0.0)
            x = x + gains[:, t, j, :, None] * innovation[:, None]
        x = x if plant.after else plant.a[:, t] @ x
    return found


def _answered(plant: Plant, chosen: Filters, columns: Float[np.ndarray, "seq time y k"]) -> np.ndarray:
    """Lᵀ of columns, where L makes errors of innovations: what every innovation changes in their products with
    errors."""
    gains = chosen.gains[0]
    x, found = np.zeros((len(plant.a), plant.a.shape[-1], columns.shape[-1])), np.zeros(columns.shape)
    for t in reversed(range(plant.a.shape[1])):
        back = plant.a[:, t].swapaxes(1, 2)
        x = x if plant.after else back @ x
        for j in reversed(range(columns.shape[2])):
            now = columns[:, t, j]
            found[:, t, j] = now + (gains[:, t, j, None] @ x)[:, 0]
            x = x + plant.c[:, t, j, :, None] * now[:, None]
        x = back @ x if plant.after else x
    return found
