"""The estimation record as fits see it: whole, or in stretches that grow longer the more is known."""

from dataclasses import replace

import numpy as np

from pgrssnn_jax.discovery.problem import Problem, Signals, weighted_signals
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.stretches import stretches
from pgrssnn_jax.records.record import Record, take

# sequences in which effects are looked for, first and beside others; their numbers are fitted to all
_SEARCHED = (12, 24)


def cut(
    problem: Problem,
    estimation: Record,
    chosen: DiscoverySettings,
    stage: int,
    start: Start,
    *,
    searched: bool = True,
) -> Signals:
    """The record in stretches of a stage's length, or whole. searched: only sequences where effects are looked for."""
    if not chosen.stretches:
        return weighted_signals(problem, estimation, folds=chosen.folds, block=chosen.block)
    if searched:
        count = _SEARCHED[min(stage, len(_SEARCHED) - 1)]
        estimation = take(estimation, np.arange(min(len(estimation.u), count)))
    return stretches(problem, estimation, chosen.stretches[stage], folds=chosen.folds, at_rest=start is Start.AT_REST)


def in_one(problem: Problem, estimation: Record, chosen: DiscoverySettings, start: Start) -> Signals:
    """Its sequences in one piece each, as far as effects are looked for in them."""
    whole = [estimation.u.shape[1]] if chosen.stretches else []
    return cut(problem, estimation, replace(chosen, stretches=whole), 0, start)
