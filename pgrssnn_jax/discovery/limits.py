"""Limits that an effect does not need: of several channels or sides, those that no sample asks for.

A limit that is not there is at infinity. An effect with one number per channel brings one for every channel, and at the
edge of the record a limit fits as well as none; beyond it, on new data, it does harm.
"""

import numpy as np

from pgrssnn_jax.discovery.candidates import Model, fitted_models, moved
from pgrssnn_jax.discovery.estimate import Settings, fit_all
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria


def without_idle_limits(
    problem: Problem, signals: Signals, selection: Selection, settings: Settings, criteria: Criteria
) -> Selection:
    """Taken away one by one: limits that close less than `share` of the gap and do not predict left-out blocks better
    by `certain` standard errors. A limit that a few samples reach, all in one block, is not certain in that sense."""
    model, least = selection.final, criteria.share * max(selection.first.rms() - selection.floor, 0.0)
    while places := _spare(problem, model):
        guess = model.estimate.guess
        rivals = [guess._replace(theta=moved(guess.theta, place, problem.theta[place])) for place in places]
        fitted = [guess for guess, _ in fit_all(problem, signals, rivals, settings)]
        best = max(fitted_models(problem, signals, fitted, settings, criteria.block), key=lambda one: one.score)
        better, error = model.better_than(best)
        closed = selection.last.rms(best) - selection.last.rms(model)
        if better > criteria.certain * error or closed >= least > 0.0:
            break
        model = best
    return selection._replace(final=model, last=selection.last._replace(base=model))


def _spare(problem: Problem, model: Model) -> list[int]:
    """Places in θ of limits that are there, of effects that have another one."""
    found = []
    for name in model.estimate.active:
        places = problem.of(name)
        there = places[np.isinf(problem.theta[places]) & np.isfinite(model.estimate.theta[places])]
        found += there.tolist() if len(there) > 1 else []
    return found
