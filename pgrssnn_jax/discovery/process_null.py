"""p-values where a disturbance of the dynamics explains the errors better than coloured noise of the sensors does.

Such a disturbance passes the same modes as effects do, so errors by it alone often look like an effect. The gain of a
candidate is then that of the likelihood, each side with the likeliest size of the disturbance,

    gain = log L₁ - log L₀

and its null distribution (`null.py`) is the gain of whitened columns on innovations ε* with random signs:

    gain* = ½ n log(‖ε*‖² / ‖ε* - Q Qᵀ ε*‖²),  ε*_t = s_t ε_t,  s_t = ±1
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.kalman import Models
from pgrssnn_jax.discovery.likelihood import Linearisation, noise_of
from pgrssnn_jax.discovery.linearise import Linearised
from pgrssnn_jax.discovery.noise import ORDER
from pgrssnn_jax.discovery.null import Known, Null, null_distribution
from pgrssnn_jax.discovery.process_noise import ProcessNoise, likelier, process_noise
from pgrssnn_jax.discovery.settings import Criteria

_LONG = 32  # coefficients of an autoregression that describes slow errors under white ones too, if roughly
_CERTAIN = 20.0  # nats: no disturbance is tried then, which takes 0.1 s

Added = Sequence[tuple[str, Float[np.ndarray, "n _"]]]  # name of an effect, and its columns at one start


class Fitted(NamedTuple):
    """A candidate at its fit. at: linearised there."""

    name: str
    gain: float
    at: Callable[[], Linearised]


def against_process_noise(
    null: Null,
    at: Linearisation,
    added: Added,
    candidates: Sequence[Fitted],
    models: Callable[[], Models | None],
    criteria: Criteria,
    rng: np.random.Generator,
) -> Null:
    """null: of coloured noise, kept where that is likelier or nothing counts under it; at, models: of the base."""
    doubtful = [one for one in candidates if null.p_value(one.name, one.gain) <= criteria.further]
    found = None if _beyond_doubt(doubtful, at) else likelier(models(), at, noise_of(at))
    if found is None:
        return null
    tried, disturbed = found
    law = _law(disturbed, at, added, criteria, rng)
    same = tried.like(disturbed.filter)
    known = dict[str, Known]()
    for one in doubtful:
        gain = process_noise(same, one.at()[0]).likelihood - disturbed.likelihood
        known[one.name] = Known(one.gain, law.p_value(one.name, gain))
    return null._replace(known=known)


def _beyond_doubt(doubtful: Sequence[Fitted], at: Linearisation) -> bool:
    """Are errors far likelier with the best of them than without it in noise of almost any kind?"""
    best = max(doubtful, key=lambda one: one.gain, default=None)
    if best is None:
        return True
    (fitted, _), order = best.at(), min(_LONG, max(ORDER, at.error.shape[1] // 2))  # of short sequences a shorter one
    gain = noise_of(fitted).likelihood(fitted.measured) - noise_of(at, order).likelihood(at.measured)
    return gain > _CERTAIN


def _law(noise: ProcessNoise, at: Linearisation, added: Added, criteria: Criteria, rng: np.random.Generator) -> Null:
    shape, width = at.error.shape, [columns.shape[1] for _, columns in added]
    together = np.concatenate([at.columns, *(columns.reshape(*shape, -1) for _, columns in added)], -1)
    own, *others = np.split(noise.whitened(together), np.cumsum([at.columns.shape[-1], *width[:-1]]), -1)
    innovations = noise.innovations / noise.filter.variance[0] ** 0.5
    white = Linearisation(innovations, own, at.measured, at.precision / at.error.var(), at.pull)
    passed = [(name, one.reshape(innovations.size, -1)) for (name, _), one in zip(added, others, strict=True)]

    def drawn(draws: int, rng: np.random.Generator) -> Float[np.ndarray, "draw seq time y"]:
        return (rng.integers(0, 2, (draws, *shape[:2], 1)) * 2.0 - 1.0) * innovations

    return null_distribution(white, drawn, passed, criteria.draws, int(np.ceil(1.0 / criteria.p_value)), rng)
