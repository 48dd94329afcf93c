"""Is there more than the named effects, or something better than they? Corrections without a name, lines, and whether
the errors follow the signals at all.

Whole records: flexible corrections beside what was found and in its place. Stretches: beside it, because one of a
single joint does not take the place of an effect on all of them.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.discovery.cuts import cut, in_one
from pgrssnn_jax.discovery.estimate import Settings, Validated
from pgrssnn_jax.discovery.follows import Follows, follows
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.linear import look_linear
from pgrssnn_jax.discovery.look import Rules, Stage, look_at
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.search import Found
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.unknown import Line, in_flexible, spectral_line
from pgrssnn_jax.records.record import Record

_LANES = 16  # fits with a correction at a time: the fastest number
_FINALISTS = 2
_AT_NOISE = 1.2  # energy of the errors over that of the noise, below which no line is looked for


class Beyond(NamedTuple):
    """The best correction without a name, beside the named effects and beside nothing; a line in the spectrum; how far
    errors far above the noise follow the signals."""

    beside: Stage | None
    alone: Stage | None
    line: Line | None
    follows: Follows | None = None


def look_beyond(
    problem: Problem,
    flexible: Problem,
    estimation: Record,
    found: Found,
    chosen: DiscoverySettings,
    settings: Settings,
    rng: np.random.Generator,
    start: Start,
) -> tuple[Beyond, Signals]:
    """With the signals that corrections were fitted to. flexible: `flexible_problem(problem)`."""
    active = found.final.estimate.active
    record = cut(flexible, estimation, chosen, min(len(active), max(len(chosen.stretches) - 1, 0)), start)
    common = {"rng": rng, "without": [effect.name for effect in problem.effects]}
    if chosen.stretches:
        whole = in_one(flexible, estimation, chosen, start)
        base = in_flexible(problem, flexible, found.last.base, record.start)
        beside = look_linear(flexible, [record], base, settings, chosen.rules, whole=whole, **common)
        return Beyond(beside, None, None), record
    few = for_corrections(settings)
    rules = chosen.rules._replace(finalists=_FINALISTS)
    look = partial(look_at, flexible, record, settings=few, rules=rules, **common)
    beside = look(in_flexible(problem, flexible, found.final, record.start))
    alone = look(in_flexible(problem, flexible, found.recalibrated, record.start)) if active else None
    driven = _follows(problem, record, found, chosen.rules, rng)
    return Beyond(beside, alone, _line(problem, record, found.final), driven), record


def for_corrections(settings: Settings) -> Settings:
    """Of fits to whole records."""
    return settings._replace(lanes=_LANES, spare=2 * settings.spare)


def _line(problem: Problem, record: Signals, final: Validated) -> Line | None:
    """A line in the spectrum of errors that are not at the noise already."""
    error = final.estimate.error
    if final.estimate.cost <= _AT_NOISE * noise_floor(error, record.weight):
        return None
    return spectral_line(record, error, problem.physics.dt)


def _follows(problem: Problem, record: Signals, found: Found, rules: Rules, rng: np.random.Generator) -> Follows | None:
    final = found.final.estimate
    if found.final.cost <= rules.far * found.floor:
        return None
    _, x = simulate(problem, record.u, final.theta[None], final.x0[None])
    return follows(record, x[0][..., : len(problem.physics.states)], final.error, rng)
