"""The final numbers of the physics, and which of them the data determine.

    minimise  Σ e² + τ σ² Σ_i ((θ_i - given_i) / s_i)²        σ² = Σ e² / n of the same model,  s: prior

The search weighs the prior against the white noise alone: the parameters are to take up whatever they can before an
effect is named. Where errors stay above that noise, the same weight would let a number go far from the nominal one for
a fall of the errors that says little. The final numbers therefore weigh the prior against the errors that are left,
which is the likeliest model where their variance is unknown. τ is the correlation time of these errors: so many of
them say as much as one (Pauli, Racugno, Ventura, Statistica Sinica 21, 2011, on the weight of a composite likelihood).

    C v = λ S v,  S = diag(s²)        C: covariance of the estimate

λ is the part of the prior's variance that is left along v; near 1 the data say nothing about that combination.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from pgrssnn_jax.discovery import likelihood
from pgrssnn_jax.discovery.candidates import Model, fitted_models, moved
from pgrssnn_jax.discovery.channels import with_fewest_channels
from pgrssnn_jax.discovery.deviations import deviations
from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate, fit_all, signal_range_of
from pgrssnn_jax.discovery.linearise import linearised
from pgrssnn_jax.discovery.noise import longest_memory
from pgrssnn_jax.discovery.optimism import optimism
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.scoring import Scoring
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria

_ROUNDS = 4  # τ σ² and the numbers in turn, at most
_STEPS = 200  # of a fit, at most: numbers of which the data see a product alone lie in a long valley
_SAME = 0.1  # relative change of τ σ²: below, the numbers move by less than a tenth of their deviation
_BEYOND = 1.96  # standard deviations of the prior: 95 %
_LEFT = 0.5  # part of the prior's variance, above which the prior says more than the data
_PART = 0.1  # of the largest entry: smaller ones of a combination are left out


class Departure(NamedTuple):
    """A number of the physics that the data take out of its prior. place: in θ; prior: its 95 % interval."""

    place: int
    before: float
    after: float
    prior: tuple[float, float]


class Combination(NamedTuple):
    """changes: relative, of parameters by label, which the data hardly see together (entries of a matrix: relative to
    its largest one); left: part of the prior's variance."""

    changes: dict[str, float]
    left: float


class Numbers(NamedTuple):
    """Of a selection. problem: channels that an effect does not need stay neutral in it; elsewhere: see
    `channels.Fewest`; without: of the models without each effect; optimism: of the final model (`optimism.py`)."""

    problem: Problem
    recalibrated: Model
    final: Model
    elsewhere: dict[str, list[Model]]
    without: dict[str, Guess]
    departures: list[Departure]
    undetermined: list[Combination]
    optimism: float | None


def final_numbers(
    problem: Problem, how: Scoring, selection: Selection, tolerance: float | None, criteria: Criteria
) -> Numbers:
    """Segments have no prior: their numbers stay as they are."""
    without = {name: one.base.estimate.guess for name, one in selection.screenings.items()}
    signals, settings = how.signals(problem), how.settings
    if tolerance is None or how.segmented:
        guess = selection.final.estimate.guess
        more = None if how.segmented else optimism(problem, signals, guess, settings)
        return Numbers(problem, selection.recalibrated, selection.final, {}, without, [], [], more)

    def settled(problem: Problem, model: Model, *, remembering: bool = True) -> tuple[Problem, Model]:
        held, guess = most_likely(problem, signals, model.estimate.guess, tolerance, settings, remembering=remembering)
        (fitted,) = fitted_models(held, signals, [guess], settings, criteria.block)
        found = deviations(held, signals, guess, settings)
        return held, fitted._replace(deviation=moved(np.zeros(len(guess.theta)), found.free, found.widest))

    held, final = settled(problem, selection.final)
    fewest = with_fewest_channels(held, signals, final, settings, criteria)
    if fewest.problem is not held:
        held, final = settled(fewest.problem, fewest.model)
    recalibrated = final
    if selection.screenings:  # what its errors remember is what is missing, and no noise
        _, recalibrated = settled(problem, selection.recalibrated, remembering=False)
    taken = [i for i, slot in enumerate(held.slots) if slot.meaning.trainable != problem.slots[i].meaning.trainable]
    alike = [one._replace(theta=moved(one.theta, taken, problem.theta[taken])) for one in without.values()]
    fitted = fit_all(held, signals, alike, settings)
    without = {name: guess for name, (guess, _) in zip(without, fitted, strict=True)}
    guess = final.estimate.guess
    unseen = undetermined(held, signals, guess, settings)
    more = optimism(held, signals, guess, settings)
    found = replace(problem, slots=held.slots)
    return Numbers(found, recalibrated, final, fewest.elsewhere, without, departures(held, final), unseen, more)


def most_likely(
    problem: Problem, signals: Signals, guess: Guess, tolerance: float, settings: Settings, *, remembering: bool = True
) -> tuple[Problem, Guess]:
    """The minimum above, and the problem whose prior has that weight; remembering: False for τ = 1. Numbers of effects
    stay where they would no longer be credible."""
    settings, span = settings._replace(steps=max(settings.steps, _STEPS)), signal_range_of(problem, signals, guess)
    for _ in range(_ROUNDS):
        now = evaluate(problem, signals, guess)
        variance = now.cost / signals.size * (longest_memory(now.error) if remembering else 1.0)
        if abs(variance - problem.noise) <= _SAME * problem.noise:
            break
        held = problem.held(tolerance, variance)
        ((fitted, _),) = fit_all(held, signals, [guess], settings)
        if not problem.credible(fitted.active, fitted.theta, span):
            break
        problem, guess = held, fitted
    return problem, guess


def departures(problem: Problem, model: Model) -> list[Departure]:
    """A departure lies outside its prior, and the nominal number outside its interval."""
    found, half_width = [], scipy.stats.t.ppf(0.975, model.freedom) * model.deviation
    for i in problem.of(None):
        if problem.precision[i] <= 0:
            continue
        reach = _BEYOND * float(problem.noise / problem.precision[i]) ** 0.5
        before, after = float(problem.theta[i]), float(model.estimate.theta[i])
        if abs(after - before) > max(reach, half_width[i]):
            found.append(Departure(int(i), before, after, (before - reach, before + reach)))
    return found


def undetermined(problem: Problem, signals: Signals, guess: Guess, settings: Settings) -> list[Combination]:
    """Combinations of parameters about which the prior says more than the data."""
    at, free = linearised(problem, signals, guess, settings)
    covariance, _ = likelihood.covariance(at, likelihood.noise_of(at), problem.noise)
    own = np.flatnonzero(problem.precision[free] > 0)
    places = free[own]
    if not len(places):
        return []
    deviation = (problem.noise / problem.precision[places]) ** 0.5
    left, directions = np.linalg.eigh(covariance[np.ix_(own, own)] / deviation / deviation[:, None])
    scale = problem.scales(places)
    found = []
    for share, direction in zip(left[::-1], directions.T[::-1], strict=True):
        if share < _LEFT:
            break
        change = direction * deviation / scale
        change = change / change[np.argmax(np.abs(change))]
        named = {problem.slots[i].label: float(c) for i, c in zip(places, change, strict=True) if abs(c) >= _PART}
        found.append(Combination(named, float(min(share, 1.0))))
    return found
