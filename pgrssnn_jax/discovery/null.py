"""How much the best of the whole catalogue gains by luck alone.

Under the null the present model is right and its errors are noise of the spectrum seen. The fit of a candidate is then
linear about its starting values: an error e falls by ‖Qᵀ e‖², Q an orthonormal basis of what the candidate adds to the
free run (its displacement at the start and the derivatives by its numbers there) once everything that is free anyway
has been taken out. The law is that of the largest fall over all candidates and starts, relative to ‖e‖².
Source: Davies, Hypothesis testing when a nuisance parameter is present only under the alternative, 1987.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.estimate import Estimate, Guess, Settings, free_places
from pgrssnn_jax.discovery.least_squares import Lanes, sensitivity
from pgrssnn_jax.discovery.noise import surrogates
from pgrssnn_jax.discovery.problem import Problem, Signals

_AT_ONCE = 1_000_000  # samples of noise held in memory
_RUN_AWAY = 1e100  # a free run that has left the range, and whose square would
_NEGLIGIBLE = 1e-6  # of a column: what is left of it after a projection is rounding


class Added(NamedTuple):
    """What a candidate at one start adds to the free run: basis Q `[seq · time · y, m]` of it, without what is free
    anyway, as far as its precision lets it be; moved and left: energy of its displacement before and after all of that
    was taken out."""

    basis: Float[np.ndarray, "n m"]
    moved: float
    left: float


def null_law(
    current: Estimate,
    weight: Float[np.ndarray, "seq time y"],
    added: Sequence[Added],
    draws: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, " draw"]:
    """Relative fall of Σ (w e)² by the best candidate, one value per draw, sorted."""
    bases = [a.basis for a in added if a.basis.shape[1]]
    if not bases:
        return np.zeros(draws)
    law: list[np.ndarray] = []
    at_once = max(1, _AT_ONCE // current.error.size)
    for i in range(0, draws, at_once):
        noise = surrogates(current.error, min(at_once, draws - i), rng)
        noise = np.where(weight > 0, noise, 0.0).reshape(len(noise), -1)
        energy = np.maximum((noise**2).sum(1), 1e-300)
        law.append(np.max([((noise @ basis) ** 2).sum(1) / energy for basis in bases], 0))
    return np.sort(np.concatenate(law))


def what_is_added(
    problem: Problem, signals: Signals, current: Estimate, guesses: Sequence[Guess], settings: Settings
) -> list[Added]:
    """Of every guess, at its starting values beside the present numbers of everything else."""
    here = current.guess
    everyone = [here, *guesses]
    everyone += [here] * (settings.lanes - len(everyone) % settings.lanes)
    places = free_places(problem, everyone, settings)
    y, dy = [], []
    for i in range(0, len(everyone), settings.lanes):
        part = everyone[i : i + settings.lanes]
        lanes = Lanes(
            np.stack([g.theta for g in part]),
            np.stack([g.x0 for g in part]),
            places[i : i + settings.lanes],
            np.full(len(part), -1),
        )
        found = sensitivity(problem, signals, lanes)
        y.append(found[0])
        dy.append(found[1])
    outputs, columns = np.concatenate(y), np.concatenate(dy)
    weight = signals.weight.ravel()
    n = weight.size
    k = places.shape[1]
    nuisance = _starts_apart(columns[0], k) * weight[:, None]
    taken_up = _orthonormal(nuisance)
    held = _orthonormal(np.concatenate([nuisance, _held(problem, places[0], nuisance.shape[1])]))
    found = []
    for i in range(1, len(guesses) + 1):
        own = [j for j, p in enumerate(places[i]) if p >= 0 and p not in places[0]]
        added = np.concatenate([(outputs[i] - outputs[0]).reshape(n, 1), columns[i].reshape(n, -1)[:, own]], 1)
        added = np.where(np.abs(added) < _RUN_AWAY, added, 0.0) * weight[:, None]
        size = np.linalg.norm(added, axis=0)
        left = _beside(added, taken_up)
        longer = _beside(np.concatenate([added, np.zeros((k, added.shape[1]))]), held)
        keep = np.linalg.norm(longer, axis=0) > _NEGLIGIBLE * np.where(size > 0, size, 1.0) + 1e-12
        basis = _orthonormal(longer[:, keep])[:n]
        found.append(Added(basis, float(size[0] ** 2), float(np.linalg.norm(left[:, 0]) ** 2)))
    return found


def _held(problem: Problem, places: Int[np.ndarray, " k"], columns: int) -> Float[np.ndarray, "k n"]:
    """What was given, as further samples: a shift of a number costs its precision times its square."""
    precision = np.where(places >= 0, problem.precision[places], 0.0)
    return np.diag(np.sqrt(precision)) @ np.eye(len(places), columns)


def _beside(columns: Float[np.ndarray, "n d"], basis: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n d"]:
    return columns - basis @ (basis.T @ columns)


def _starts_apart(dy: Float[np.ndarray, "seq time y d"], k: int) -> Float[np.ndarray, "n m"]:
    """Derivatives by θ as they are, and one set of columns for the initial state of every sequence."""
    n_seq = len(dy)
    flat = dy.reshape(n_seq, -1, dy.shape[-1])
    shared = flat[..., :k].reshape(-1, k)
    local = np.zeros((n_seq, flat.shape[1], n_seq, dy.shape[-1] - k))
    for i in range(n_seq):
        local[i, :, i] = flat[i, :, k:]
    return np.concatenate([shared, local.reshape(len(shared), -1)], 1)


def _orthonormal(columns: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n m"]:
    """Basis of the columns' span without directions that are only rounding."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 1e-12]
    if not columns.shape[1]:
        return columns
    u, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return u[:, s > 1e-7 * s[0]]
