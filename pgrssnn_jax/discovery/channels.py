"""The fewest channels of each effect that predict as well.

    one channel after another is taken out, as long as    log L(with it) - log L(without it) <= its standard error

An effect has a number for every input, output or state. Two of them may do the same: offsets of three inputs of a
system with two states, disturbances of two inputs that reach one output. Then the data determine a combination alone,
and the channel that acts more is kept. L: of left-out blocks, after all other numbers are fitted again. Which channel
comes first is told by the linearised model: by the rise of the cost without it, where that is more than nothing.
Source of the standard error: Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2009, section 7.10.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.candidates import Model, fitted_models, moved
from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.likelihood import Linearisation
from pgrssnn_jax.discovery.linearise import linearisation, runs
from pgrssnn_jax.discovery.null import LEAST_GAIN
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.settings import Criteria

_RIDGE = 1e-10  # of a column's energy


class Channel(NamedTuple):
    """Of an effect. places: of its numbers in θ; rise: of the log-likelihood that it is worth, by the linearised model;
    energy: of what it does to the free run; without: the numbers of θ without it, and x_0."""

    effect: str
    places: Int[np.ndarray, " n"]
    rise: float
    energy: float
    without: Guess


def with_fewest_channels(
    problem: Problem, signals: Signals, model: Model, settings: Settings, criteria: Criteria
) -> tuple[Problem, Model]:
    """model: at its optimum. The problem in which the numbers of other channels are neutral and stay so."""
    whole, settled = model, set[str]()
    while True:
        channels = [one for one in _channels(problem, signals, model, settings) if one.effect not in settled]
        if not channels:
            return problem, model
        least = min(channels, key=lambda one: (max(one.rise, LEAST_GAIN), one.energy))
        smaller = _held(problem, least.places)
        ((guess, _),) = fit_all(smaller, signals, [least.without], settings)
        (fewer,) = fitted_models(smaller, signals, [guess], settings, criteria.block)
        worse, error = whole.better_than(fewer)
        if worse <= criteria.standard_errors * error:
            problem, model = smaller, fewer
        else:
            settled.add(least.effect)


def _channels(problem: Problem, signals: Signals, model: Model, settings: Settings) -> Iterator[Channel]:
    """Of all effects that have several."""
    guess = model.estimate.guess
    several = {name: _places(problem, guess, name) for name in guess.active}
    if not any(len(places) > 1 for places in several.values()):
        return
    (run,) = runs(problem, signals, [guess], settings)
    at, free = linearisation(problem, signals, guess, run)
    inverse = _inverse(at)
    for name, places in several.items():
        for own in places if len(places) > 1 else ():
            here = np.flatnonzero(np.isin(free, own))
            change = problem.theta[free[here]] - guess.theta[free[here]]
            force = np.linalg.solve(inverse[np.ix_(here, here)], change)
            step, theta = (inverse[:, here] @ force)[: len(free)], guess.theta.copy()
            theta[free] = np.clip(theta[free] + step, problem.low[free], problem.high[free])
            rise = 0.5 * float(change @ force) * signals.size / max(model.estimate.cost, 1e-300)
            energy = float(((at.columns[..., here] @ change) ** 2).sum())
            yield Channel(name, own, rise, energy, Guess(guess.active, moved(theta, own, problem.theta[own]), guess.x0))


def _places(problem: Problem, guess: Guess, name: str) -> list[Int[np.ndarray, " n"]]:
    """Positions in θ of the free numbers of every channel that has some. Limits are not among them (`limits.py`)."""
    owners = [one for one in problem.effect(name).channels.split(", ") if one and one != "point"]
    found: dict[tuple[int, ...], list[int]] = {}
    for i in problem.of(name):
        index = problem.slots[i].element[: len(owners)]
        if len(index) == len(owners) > 0 and np.isfinite(problem.theta[i]):
            found.setdefault(index, []).append(int(i))
    return [np.array(own) for own in found.values()]


def _inverse(at: Linearisation) -> Float[np.ndarray, "k k"]:
    k = at.columns.shape[-1]
    columns = at.columns.reshape(-1, k)
    normal = columns.T @ columns + np.diag(at.precision)
    size = np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))  # 0: what changes nothing
    return np.linalg.inv(normal / size / size[:, None] + _RIDGE * np.eye(k)) / size / size[:, None]


def _held(problem: Problem, places: Int[np.ndarray, " n"]) -> Problem:
    """The same problem in which these numbers stay as they are."""
    chosen = set(places.tolist())
    slots = tuple(
        slot._replace(meaning=slot.meaning._replace(trainable=False)) if i in chosen else slot
        for i, slot in enumerate(problem.slots)
    )
    return replace(problem, slots=slots)
