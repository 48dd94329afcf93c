"""How sure the effects of an arm are: chance, deviations, friction that left its prior.

    p = m (1 + #{Σ_b s_b g_b >= Σ_b g_b}) / (1 + draws),   s_b = ±1

g_b: gain of an effect in the log-likelihood of block b, which had no part in the fit; where the effect means nothing
either sign is as likely. m: effects that were looked for. Source of the test: Fisher, The Design of Experiments, 1935,
section 21.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.inverse.evidence import Samples
from pgrssnn_jax.discovery.inverse.fit import Fit, Gain, gains_by_block
from pgrssnn_jax.discovery.inverse.select import Chosen, Model, Search, own_places
from pgrssnn_jax.discovery.problem import Problem

_CERTAIN = 3.0  # standard deviations
_FRICTION = 0.1  # relative deviation of a known friction: with load, warmth and age it varies by so much
_DRAWS = 20_000


def chances(problem: Problem, samples: Samples, chosen: Chosen, seed: int) -> dict[str, float]:
    """p-value of every effect of the final model."""
    signs = np.random.default_rng(seed).integers(0, 2, (_DRAWS, samples.blocks)) * 2.0 - 1.0
    final, found = chosen.final.fit, {}
    for name, without in chosen.without.items():
        gains = gains_by_block(without.left_out, final.left_out, samples, chosen.kappa).sum(0)
        beaten = int((signs @ gains >= gains.sum()).sum())
        found[name] = min(1.0, len(problem.effects) * (1 + beaten) / (1 + _DRAWS))
    return found


def deviations(problem: Problem, fit: Fit, samples: Samples) -> Float[np.ndarray, " p"]:
    """Standard deviation of every number of θ: the larger one of that by the size of the errors and how long they
    remember, and that by how much blocks differ (sandwich); 0 where a number was not free, infinite where nothing
    depends on it."""
    found = np.zeros(len(problem.theta))
    if not len(fit.places):
        return found
    root = np.sqrt(fit.weight)
    columns = (fit.derivatives * root).reshape(len(fit.places), root.size)
    precision = problem.precision[fit.places]
    normal = columns @ columns.T + np.diag(precision)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / scale / scale[:, None], rcond=1e-12, hermitian=True) / scale / scale[:, None]
    terms = (columns * (fit.error * root).ravel()).reshape(len(columns), *fit.error.shape).sum(1)
    pulls = np.stack([np.bincount(samples.block, one, samples.blocks) for one in terms], 1)
    count = samples.blocks
    between = inverse @ (pulls.T @ pulls * count / (count - 1)) @ inverse
    larger = np.sqrt(np.maximum(np.maximum(np.diag(inverse), np.diag(between)), 0.0))
    found[fit.places] = np.where(np.diag(normal) > 0, larger, np.inf)
    return found


def departed(problem: Problem, fit: Fit) -> Int[np.ndarray, " k"]:
    """Own numbers outside the 95 % interval of their prior."""
    own = own_places(problem)
    own = own[problem.precision[own] > 0]
    away = np.abs(fit.theta[own] - problem.theta[own]) * np.sqrt(problem.precision[own])
    return own[away > 1.96]


def changed_friction(
    search: Search, final: Model, std: Float[np.ndarray, " p"], names: Mapping[str, str]
) -> dict[str, Int[np.ndarray, " _"]]:
    """Places of own numbers that left their prior for certain, and without which a joint's torque is predicted clearly
    worse, by the effect that has their law; names: the number of each effect."""
    problem, fit, own = search.problem, final.fit, search.own
    away, known = np.abs(fit.theta[own] - problem.theta[own]), _FRICTION * np.abs(problem.theta[own])
    gone = own[(away > 1.96 * known) & (away > _CERTAIN * std[own])]
    gone = gone[[search.worth(_gain_of(search, final, int(place))) for place in gone]]
    # a parameter of the physics, or of an effect that an earlier discovery has found
    paths = {name: ((symbol,), (name, symbol)) for name, symbol in names.items()}
    found = {name: gone[[problem.slots[i].path in known for i in gone]] for name, known in paths.items()}
    return {name: places for name, places in found.items() if len(places)}


def _gain_of(search: Search, final: Model, place: int) -> Gain:
    """Gain from a fitted parameter of the physics over its given value; all other parameters are refitted."""
    theta = final.fit.theta.copy()
    theta[place] = search.problem.theta[place]
    others = search._replace(own=search.own[search.own != place])
    known = final.fit.derivatives[final.fit.places != place]
    return search.gain(others.linear(theta, final.active, known), final.fit)
