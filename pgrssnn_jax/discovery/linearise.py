"""Free runs with their derivatives, and what follows from them without another simulation.

    e(θ + δ) ≈ e - J δ        J: sensitivities of the free run by the free numbers and the initial states

What an effect adds to what is free anyway, and whether it does anything at all.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.estimate import Guess, Settings, free_places
from pgrssnn_jax.discovery.least_squares import Lanes, sensitivity
from pgrssnn_jax.discovery.likelihood import Linearisation
from pgrssnn_jax.discovery.null import beside, orthonormal
from pgrssnn_jax.discovery.problem import Problem, Signals

Linearised = tuple[Linearisation, Int[np.ndarray, " k"]]  # and the positions in θ of its first columns
_NOTHING = 1e-20  # of an energy: a change that is none, in any unit of a number
_RUN_AWAY = 1e100  # error of a free run that has left the range: squares of larger ones leave it too


class Run(NamedTuple):
    """places `[k]`: free positions of θ; error `[seq, time, y]`: weighted; columns `[seq, time, y, k + s]`:
    weighted sensitivities of the free run."""

    places: Int[np.ndarray, " k"]
    error: Float[np.ndarray, "seq time y"]
    columns: Float[np.ndarray, "seq time y d"]


def runs(problem: Problem, signals: Signals, guesses: Sequence[Guess], settings: Settings) -> list[Run]:
    """Of guesses at their present numbers."""
    if not guesses:
        return []
    found = []
    at_once = settings.at_once(problem, signals, len(guesses))
    for i in range(0, len(guesses), at_once):
        part = list(guesses[i : i + at_once])
        padded = part + [part[-1]] * (at_once - len(part))
        places = free_places(problem, padded, settings)
        lanes = Lanes(np.stack([g.theta for g in padded]), np.stack([g.x0 for g in padded]), places)
        y, dy = sensitivity(problem, signals, lanes)
        error, dy = signals.weight * (signals.y - y), signals.weight[..., None] * dy
        error = np.where(signals.weight > 0, np.where(np.abs(error) < _RUN_AWAY, error, _RUN_AWAY), 0.0)
        dy = np.where(np.abs(dy) < _RUN_AWAY, dy, 0.0)
        for k in range(len(part)):
            used = np.flatnonzero(places[k] >= 0)
            columns = dy[k][..., np.concatenate([used, np.arange(places.shape[1], dy.shape[-1])])]
            found.append(Run(places[k][used], error[k], columns))
    return found


def linearisation(problem: Problem, signals: Signals, guess: Guess, run: Run) -> Linearised:
    """Of a model at its present numbers, without those that stand at a bound; with the positions that are left."""
    theta = guess.theta[run.places]
    inside = (theta > problem.low[run.places]) & (theta < problem.high[run.places])
    free = run.places[inside]
    starts = np.arange(len(run.places), run.columns.shape[-1])
    columns = _starts_apart(run.columns[..., np.concatenate([np.flatnonzero(inside), starts])], len(free))
    precision, pull = np.zeros((2, columns.shape[-1]))
    precision[: len(free)] = problem.precision[free]
    given = np.where(problem.precision[free] > 0, problem.theta[free], guess.theta[free])  # may be infinite without
    pull[: len(free)] = precision[: len(free)] * (given - guess.theta[free])
    return Linearisation(run.error, columns, signals.weight > 0, precision, pull), free


def linearised(problem: Problem, signals: Signals, guess: Guess, settings: Settings) -> Linearised:
    """The same of a guess that was not run yet."""
    (run,) = runs(problem, signals, [guess], settings)
    return linearisation(problem, signals, guess, run)


def _starts_apart(dy: Float[np.ndarray, "seq time y d"], k: int) -> Float[np.ndarray, "seq time y m"]:
    """Derivatives by θ as they are, and columns of their own for the initial state of every sequence."""
    n_seq, time, n_y, width = dy.shape
    local = np.zeros((n_seq, time, n_y, n_seq, width - k))
    for i in range(n_seq):
        local[i, :, :, i] = dy[i, ..., k:]
    return np.concatenate([dy[..., :k], local.reshape(n_seq, time, n_y, -1)], -1)


def added(here: Run, run: Run) -> Float[np.ndarray, "n m"]:
    """What an effect adds at its start: displacement of the free run, and derivatives by its own numbers."""
    own = np.flatnonzero(~np.isin(run.places, here.places))
    moved = (here.error - run.error)[..., None]
    columns = np.concatenate([moved, run.columns[..., own]], -1)
    return columns.reshape(here.error.size, -1)


def visible(at: Linearisation, added: Sequence[tuple[str, Float[np.ndarray, "n _"]]]) -> dict[str, tuple[float, float]]:
    """Per effect the energy of its displacement, and what of it the model's free numbers cannot take up: of the
    displacement itself, or of the change by one number of the effect, of which more is left. Gains of all sensors
    together may be what the physics can do, and those of one sensor not."""
    measured = at.measured.ravel()
    nuisance = orthonormal(at.columns.reshape(at.error.size, -1) * measured[:, None])
    found: dict[str, tuple[float, float]] = {}
    for name, columns in added:
        columns = columns * measured[:, None]
        energy, left = (columns**2).sum(0), (beside(columns, nuisance) ** 2).sum(0)
        there = energy > _NOTHING * energy.max(initial=0.0)
        part = float((left[there] / energy[there]).max(initial=0.0))
        seen = found.get(name, (0.0, 0.0))
        found[name] = (max(seen[0], float(energy[0])), max(seen[1], part * float(energy[0])))
    return found
