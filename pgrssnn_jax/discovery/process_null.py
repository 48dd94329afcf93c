"""The null where a disturbance of the dynamics explains the errors better than coloured noise of the sensors does.

Such a disturbance passes the same modes as effects do, so errors by it alone often look like an effect. A candidate
counts beside it where its gain is no luck under the disturbance of the base, or under what its own fit leaves of it,
provided that the errors are likelier with the candidate:

    p = m P(χ²_k >= 2 (log L₁ - log L₀))        L₀, L₁: each with its own disturbance

m effects in the catalogue, k numbers of this one. Source: Wilks, Annals of Mathematical Statistics 9, 1938; Bonferroni.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.linearise import linearisation, runs
from pgrssnn_jax.discovery.null import Null, null_distribution
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.process_noise import Plant, ProcessNoise, disturbances, process_noise
from pgrssnn_jax.discovery.settings import Criteria

Added = Sequence[tuple[str, Float[np.ndarray, "n _"]]]  # name of an effect, and its columns at one start


class Fitted(NamedTuple):
    """A candidate at its fit. at: its linearisation there, and how many numbers it adds."""

    name: str
    gain: float
    at: Callable[[], tuple[Linearisation, int]]


def linearised(problem: Problem, signals: Signals, guess: Guess, settings: Settings) -> tuple[Linearisation, int]:
    """A guess, and how many free numbers the effect that came in last has."""
    (run,) = runs(problem, signals, [guess], settings)
    at, free = linearisation(problem, signals, guess, run)
    return at, int(np.isin(free, problem.of(guess.active[-1])).sum()) if guess.active else 0


def against_process_noise(
    null: Null,
    at: Linearisation,
    added: Added,
    candidates: Sequence[Fitted],
    plant: Callable[[], Plant],
    criteria: Criteria,
    rng: np.random.Generator,
) -> Null:
    """null: of coloured noise, kept where that is likelier or where nothing counts under it; at, plant: of the base."""
    doubtful = [one for one in candidates if null.p_value(one.name, one.gain) <= criteria.further]
    tried = disturbances(plant(), at) if doubtful else None
    disturbed = process_noise(tried, at) if tried else None
    if tried is None or disturbed is None or disturbed.likelihood <= noise_of(at).likelihood(at.measured):
        return null
    catalogue, least = len({name for name, _ in added}), int(np.ceil(1.0 / criteria.p_value))
    luck, left = dict[str, float](), dict[str, ProcessNoise]()
    for one in doubtful:
        fitted, numbers = one.at()
        left[one.name] = process_noise(tried.at(disturbed.place), fitted)
        likelier = left[one.name].likelihood - disturbed.likelihood
        luck[one.name] = min(1.0, catalogue * float(scipy.stats.chi2.sf(2.0 * likelier, max(1, numbers))))

    def beside(noise: ProcessNoise) -> Null:
        return null_distribution(at, noise.recoloured, added, criteria.draws, least, rng)._replace(luck=luck)

    base = beside(disturbed)
    best = max((one for one in doubtful if luck[one.name] <= criteria.p_value), key=lambda one: one.gain, default=None)
    if best is None or base.p_value(best.name, best.gain) <= criteria.p_value:
        return base
    return min(base, beside(left[best.name]), key=lambda one: one.p_value(best.name, best.gain))
