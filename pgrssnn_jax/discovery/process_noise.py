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
from jaxtyping import Bool, Float

from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.likelihood import Linearisation, step_of
from pgrssnn_jax.discovery.noise import white_variance
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.responses import Path, path_of

_SIZES = 10.0 ** np.arange(-1.0, 3.1, 0.5)  # variance of readings by a disturbance, in variances of the white noise
_ROUNDS = 2  # of generalised least squares
_ENOUGH = 4096  # samples of each sequence from which a disturbance is chosen
_TINY = 1e-300


class Plant(NamedTuple):
    """A model along its free run, and where disturbances may enter it. c: of weighted outputs; entering: a unit vector
    of each state, and the input's derivatives; after: are outputs read after the step?"""

    a: Float[np.ndarray, "seq time x x"]
    c: Float[np.ndarray, "seq time y x"]
    measured: Bool[np.ndarray, "seq time y"]
    entering: Float[np.ndarray, "place seq time x"]
    after: bool


class Filter(NamedTuple):
    """gains: by how much x moves with one innovation, 0 where nothing was measured; variance of the innovations."""

    gains: Float[np.ndarray, "seq time y x"]
    variance: Float[np.ndarray, "seq time y"]


class ProcessNoise(NamedTuple):
    """plant: with the place alone where the disturbance enters; innovations `[seq, time, y]`; likelihood:
    log-likelihood of the errors."""

    plant: Plant
    filter: Filter
    innovations: Float[np.ndarray, "seq time y"]
    likelihood: float

    def recoloured(self, draws: int, rng: np.random.Generator) -> Float[np.ndarray, "draw seq time y"]:
        """Errors whose innovations have random signs."""
        signs = rng.integers(0, 2, (draws, *self.innovations.shape[:2], 1)) * 2.0 - 1.0
        drawn = np.moveaxis(signs * self.innovations, 0, -1)
        return np.moveaxis(_through(self.plant, self.filter, drawn, whiten=False), -1, 0)


def plant_along(problem: Problem, signals: Signals, guess: Guess) -> Plant:
    """The model of a guess along its free run."""
    return plant_of(problem, signals, path_of(problem, signals, guess))


def plant_of(problem: Problem, signals: Signals, path: Path) -> Plant:
    n = len(problem.physics.states)
    states = [np.broadcast_to(one, path.x[..., :n].shape) for one in np.eye(n)]
    entering = np.stack([*states, *np.moveaxis(path.b[..., :n, :], -1, 0)])
    after = problem.physics.output_timing == "after_step"
    return Plant(path.a[..., :n, :n], path.c[..., :n] * signals.weight[..., None], signals.weight > 0, entering, after)


def process_noise(plant: Plant, at: Linearisation) -> ProcessNoise | None:
    """The likeliest, at the generalised least squares estimate; None where no disturbance reaches an output."""
    left, chosen, place = at.error, None, 0
    for _ in range(_ROUNDS):
        white = white_variance(left, at.measured) + _TINY
        likeliest = _likeliest(plant, left, white)
        if likeliest is None:
            return None
        place, drive = likeliest
        chosen = _filter(plant, drive, white)
        error, columns = (_through(plant, chosen, one, whiten=True) for one in (at.error[..., None], at.columns))
        scaled = at._replace(error=error[..., 0], columns=columns)
        step = step_of(scaled, at.measured / chosen.variance, at.error.var() + _TINY)
        left = np.where(at.measured, at.error - at.columns @ step, 0.0)
    assert chosen is not None
    plant = plant._replace(entering=plant.entering[[place]])
    innovations = _through(plant, chosen, left[..., None], whiten=True)[..., 0]
    squares = np.where(at.measured, innovations**2 / chosen.variance, 0.0).sum()
    sizes = np.where(at.measured, np.log(chosen.variance), 0.0).sum()
    return ProcessNoise(plant, chosen, innovations, float(_concentrated(squares, sizes, int(at.measured.sum()))))


def _likeliest(
    plant: Plant, error: Float[np.ndarray, "seq time y"], white: Float[np.ndarray, " y"]
) -> tuple[int, Float[np.ndarray, "seq time x"]] | None:
    """Place and disturbance of the likeliest place and size."""
    drives, places = [], []
    for place, g in enumerate(plant.entering):
        with np.errstate(over="ignore", invalid="ignore"):
            reached = (_unmeasured_variance(plant, g) / white)[plant.measured].mean()
        if np.isfinite(reached) and reached > _TINY:
            drives += [g * (size / reached) ** 0.5 for size in _SIZES]
            places += [place] * len(_SIZES)
    if not drives:
        return None
    best = int(np.argmax(_likelihoods(plant, np.stack(drives), error, white)))
    return places[best], drives[best]


def _unmeasured_variance(plant: Plant, g: Float[np.ndarray, "seq time x"]) -> Float[np.ndarray, "seq time y"]:
    """C P Cᵀ of a disturbance along g when nothing is measured."""
    p, found = np.zeros((len(plant.a), *plant.a.shape[2:])), np.zeros(plant.c.shape[:3])
    for t in range(plant.a.shape[1]):
        old, c = p, plant.c[:, t]
        p = _propagated(plant, p, g, t)
        found[:, t] = np.einsum("syi,sij,syj->sy", c, p if plant.after else old, c)
    return found


def _propagated(plant: Plant, p: np.ndarray, drives: Float[np.ndarray, "*batch seq time x"], t: int) -> np.ndarray:
    """A P Aᵀ + g gᵀ"""
    a, g = plant.a[:, t], drives[..., t, :]
    return a @ p @ a.swapaxes(1, 2) + g[..., None] * g[..., None, :]


def _updated(plant: Plant, p: np.ndarray, white: float, t: int, j: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """P, gain and variance of the innovation once output j is read: one after the other, their noise is independent."""
    c, there = plant.c[:, t, j], plant.measured[:, t, j]
    moved = np.where(there[:, None], (p @ c[..., None])[..., 0], 0.0)
    variance = (moved * c).sum(-1) + white
    gain = moved / variance[..., None]
    return p - moved[..., None] * gain[..., None, :], gain, np.where(there, variance, 1.0)


def _likelihoods(
    plant: Plant,
    drives: Float[np.ndarray, "batch seq time x"],
    error: Float[np.ndarray, "seq time y"],
    white: Float[np.ndarray, " y"],
) -> Float[np.ndarray, " batch"]:
    count, n_seq, time, n = drives.shape
    time = min(time, _ENOUGH)
    p, x = np.zeros((count, n_seq, n, n)), np.zeros((count, n_seq, n))
    squares, sizes = np.zeros((2, count))
    for t in range(time):
        if plant.after:
            p, x = _propagated(plant, p, drives, t), (plant.a[:, t] @ x[..., None])[..., 0]
        for j, size in enumerate(white):
            p, gain, variance = _updated(plant, p, size, t, j)
            there = plant.measured[:, t, j]
            innovation = np.where(there, error[:, t, j] - (x * plant.c[:, t, j]).sum(-1), 0.0)
            x = x + gain * innovation[..., None]
            squares += (innovation**2 / variance).sum(-1)
            sizes += np.log(variance).sum(-1)
        if not plant.after:
            p, x = _propagated(plant, p, drives, t), (plant.a[:, t] @ x[..., None])[..., 0]
    return _concentrated(squares, sizes, int(plant.measured[:, :time].sum()))


def _concentrated(squares: Any, sizes: Any, count: int) -> Any:
    """Log-likelihood at the likeliest size of all noise together."""
    return -0.5 * (count * (np.log(2.0 * np.pi * squares / count + _TINY) + 1.0) + sizes)


def _filter(plant: Plant, drive: Float[np.ndarray, "seq time x"], white: Float[np.ndarray, " y"]) -> Filter:
    n_seq, time, n_y, n = plant.c.shape
    gains, variance, p = np.zeros((n_seq, time, n_y, n)), np.ones((n_seq, time, n_y)), np.zeros((n_seq, n, n))
    for t in range(time):
        p = _propagated(plant, p, drive, t) if plant.after else p
        for j, size in enumerate(white):
            p, gains[:, t, j], variance[:, t, j] = _updated(plant, p, size, t, j)
        p = p if plant.after else _propagated(plant, p, drive, t)
    return Filter(gains, variance)


def _through(
    plant: Plant, chosen: Filter, values: Float[np.ndarray, "seq time y k"], *, whiten: bool
) -> Float[np.ndarray, "seq time y k"]:
    """Innovations of errors, or errors of innovations, of independent columns."""
    x, found = np.zeros((len(plant.a), plant.a.shape[-1], values.shape[-1])), np.zeros(values.shape)
    for t in range(plant.a.shape[1]):
        x = plant.a[:, t] @ x if plant.after else x
        for j in range(values.shape[2]):
            expected = (plant.c[:, t, j, None] @ x)[:, 0]
            there, now = plant.measured[:, t, j, None], values[:, t, j]
            innovation = np.where(there, now - expected if whiten else now, 0.0)
            found[:, t, j] = np.where(there, innovation if whiten else now + expected, 0.0)
            x = x + chosen.gains[:, t, j, :, None] * innovation[:, None]
        x = x if plant.after else plant.a[:, t] @ x
    return found
