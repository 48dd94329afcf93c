"""Models and screenings made by hand, for rules that need no fit: errors in units of the noise."""

from collections.abc import Mapping, Sequence

import numpy as np

from pgrssnn_jax.discovery.candidates import Candidate, Model, Screening
from pgrssnn_jax.discovery.estimate import Estimate, Guess
from pgrssnn_jax.discovery.null import Null, nats
from pgrssnn_jax.discovery.problem import Problem

SAMPLES, BLOCK, DRAWS = 640, 32, 400
CERTAIN, LIKELY = 1e-9, 0.03  # p-values: of no chance, and of one that is enough beside others only
NOISE = np.random.default_rng(0).standard_normal((1, SAMPLES, 1))
NOISE /= np.sqrt((NOISE**2).mean())
_LAW = np.log((np.arange(DRAWS) + 0.5) / DRAWS)


def model(problem: Problem, energy: float, active: Sequence[str] = (), error: np.ndarray = NOISE) -> Model:
    """energy: of the errors, in units of the noise's."""
    error = np.sqrt(energy) * error
    squares = (error**2).reshape(-1, BLOCK).sum(1)
    estimate = Estimate(tuple(active), problem.theta, np.zeros((1, 2)), error)
    return Model(estimate, squares, np.full(len(squares), BLOCK), np.zeros(len(problem.theta)), 100.0)


def screening(
    base: Model,
    models: Mapping[str, Model],
    p_value: Mapping[str, float] | None = None,
    visible: Mapping[str, tuple[float, float]] | None = None,
) -> Screening:
    """Of candidates by name, as `score_candidates` orders them; p_value: of their gains, CERTAIN unless given."""
    found = [
        Candidate(name, float(nats(1.0 - one.estimate.cost / base.estimate.cost, SAMPLES)), one.estimate.guess, one)
        for name, one in models.items()
    ]
    found.sort(key=lambda c: (-c.score, -c.gain))
    chance = dict.fromkeys(models, CERTAIN) | dict(p_value or {})
    scale = {c.name: max(c.gain, 1e-9) / -np.log(chance[c.name]) for c in found}  # exp(-gain / scale) is the p-value
    null = Null(_LAW, dict.fromkeys(scale, 1.0), scale)
    return Screening(base, tuple(found), null, dict(visible or {}), SAMPLES, 1.0)


def neutral(problem: Problem) -> Guess:
    return Guess((), problem.theta, np.zeros((1, 2)))
