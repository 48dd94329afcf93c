"""The fewest channels of each effect that predict as well.

    one channel after another is taken out, as long as    log L(with it) - log L(without it) <= its standard error

An effect has a number for every input, output or state. Two of them may do the same: offsets of three inputs of a
system with two states, disturbances of two inputs that reach one output. Then the data determine a combination alone,
and the channel that acts more is kept. L: of left-out blocks, after all other numbers are fitted again. Which channel
comes first is told by the linearised model: by the rise of the cost without it, where that is more than nothing. Where
another channel in its place does as well, the data do not tell at which one the effect acts.
Source of the standard error: Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2009, section 7.10.
"""

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.candidates import Model, fitted_models, moved
from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.likelihood import Linearisation
from pgrssnn_jax.discovery.linearise import linearised
from pgrssnn_jax.discovery.null import LEAST_GAIN
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.settings import Criteria

_RIDGE = 1e-10  # of a column's energy


class Fewest(NamedTuple):
    """problem: the numbers of channels that were taken out are neutral and stay so; elsewhere: per effect, models that
    have another channel of it in the place of one that is left, and under which the record is as likely."""

    problem: Problem
    model: Model
    elsewhere: dict[str, list[Model]]


class _Linear(NamedTuple):
    """A model and its linearisation. free: places in θ of the first columns; inverse: of the normal matrix."""

    guess: Guess
    at: Linearisation
    free: Int[np.ndarray, " k"]
    inverse: Float[np.ndarray, "d d"]


class _Channel(NamedTuple):
    """Of an effect. places: of its numbers in θ; rise: of the cost without it, by the linearised model; energy: of what
    it does to the free run; without: the numbers of θ without it, and x_0."""

    effect: str
    places: Int[np.ndarray, " n"]
    rise: float
    energy: float
    without: Guess


def with_fewest_channels(
    problem: Problem, signals: Signals, model: Model, settings: Settings, criteria: Criteria
) -> Fewest:
    """model: at its optimum."""
    whole, smaller, settled = model, problem, set[str]()
    nothing = 2.0 * LEAST_GAIN * model.estimate.cost / signals.size  # rise of a cost
    while channels := [one for one in _channels(smaller, signals, model, settings) if one.effect not in settled]:
        least = min(channels, key=lambda one: (max(one.rise, nothing), one.energy))
        held = _held(smaller, least.places)
        fewer = _refitted(held, signals, least.without, settings, criteria)
        worse, error = whole.better_than(fewer)
        if worse <= criteria.standard_errors * error:
            smaller, model = held, fewer
        else:
            settled.add(least.effect)
    return Fewest(smaller, model, _elsewhere(problem, smaller, signals, (whole, model), settings, criteria))


def _refitted(problem: Problem, signals: Signals, guess: Guess, settings: Settings, criteria: Criteria) -> Model:
    ((fitted, _),) = fit_all(problem, signals, [guess], settings)
    (model,) = fitted_models(problem, signals, [fitted], settings, criteria.block)
    return model


def _channels(problem: Problem, signals: Signals, model: Model, settings: Settings) -> list[_Channel]:
    """Of all effects that have several."""
    guess = model.estimate.guess
    several = [(name, places) for name in guess.active if len(places := _places(problem, guess, name)) > 1]
    if not several:
        return []
    linear = _linearised(problem, signals, guess, settings)
    return [_Channel(name, own, *_without(problem, linear, own)) for name, places in several for own in places]


def _elsewhere(
    problem: Problem,
    smaller: Problem,
    signals: Signals,
    models: tuple[Model, Model],
    settings: Settings,
    criteria: Criteria,
) -> dict[str, list[Model]]:
    """models: with all channels, and with the fewest."""
    (whole, model), found = models, dict[str, list[Model]]()
    start = whole.estimate.guess
    places = {name: (_places(problem, start, name), _places(smaller, start, name)) for name in start.active}
    out = {name: [own for own in every if not np.isin(own, kept).any()] for name, (every, kept) in places.items()}
    if not any(out.values()):
        return found
    taken = np.concatenate([own for of_effect in out.values() for own in of_effect])
    linear = _linearised(problem, signals, start, settings)
    for name, of_effect in out.items():
        for own, kept in product(of_effect, places[name][1]):
            held = np.union1d(np.setdiff1d(taken, own), kept)
            other = _refitted(_held(problem, held), signals, _without(problem, linear, held)[-1], settings, criteria)
            less = 0.5 * signals.size * np.log(other.estimate.cost / model.estimate.cost)
            if less <= criteria.alike:
                found.setdefault(name, []).append(other)
    return found


def _linearised(problem: Problem, signals: Signals, guess: Guess, settings: Settings) -> _Linear:
    at, free = linearised(problem, signals, guess, settings)
    k = at.columns.shape[-1]
    columns = at.columns.reshape(-1, k)
    normal = columns.T @ columns + np.diag(at.precision)
    size = np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))  # 0: what changes nothing
    inverse = np.linalg.inv(normal / size / size[:, None] + _RIDGE * np.eye(k)) / size / size[:, None]
    return _Linear(guess, at, free, inverse)


def _without(problem: Problem, linear: _Linear, own: Int[np.ndarray, " n"]) -> tuple[float, float, Guess]:
    """Rise of the cost, energy of the change of the free run, and where a fit without these numbers begins."""
    guess, at, free, inverse = linear
    here = np.flatnonzero(np.isin(free, own))
    change = problem.theta[free[here]] - guess.theta[free[here]]
    force = np.linalg.solve(inverse[np.ix_(here, here)], change)
    step, theta = (inverse[:, here] @ force)[: len(free)], guess.theta.copy()
    theta[free] = np.clip(theta[free] + step, problem.low[free], problem.high[free])
    energy = float(((at.columns[..., here] @ change) ** 2).sum())
    begun = Guess(guess.active, moved(theta, own, problem.theta[own]), guess.x0)
    return float(change @ force), energy, begun


def _places(problem: Problem, guess: Guess, name: str) -> list[Int[np.ndarray, " n"]]:
    """Positions in θ of the free numbers of every channel that has some. Limits are not among them (`limits.py`)."""
    owners = [one for one in problem.effect(name).channels.split(", ") if one and one != "point"]
    found: dict[tuple[int, ...], list[int]] = {}
    for i in problem.of(name):
        index = problem.slots[i].element[: len(owners)]
        if len(index) == len(owners) > 0 and np.isfinite(problem.theta[i]):
            found.setdefault(index, []).append(int(i))
    return [np.array(own) for own in found.values()]


def _held(problem: Problem, places: Int[np.ndarray, " n"]) -> Problem:
    """The same problem in which these numbers stay as they are."""
    chosen = set(places.tolist())
    slots = tuple(
        slot._replace(meaning=slot.meaning._replace(trainable=False)) if i in chosen else slot
        for i, slot in enumerate(problem.slots)
    )
    return replace(problem, slots=slots)
