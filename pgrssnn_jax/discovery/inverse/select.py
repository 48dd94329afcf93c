"""Which effects an arm lacks: its structure first, then what predicts, found from two sides.

    backward   all plain effects at once, and out with the one that predicts least
    forward    one after another what predicts most, and out with what it makes superfluous

Going forward, a gain can stand in for a motor's inertia and never leave; going backward, three small effects can stand
in for one. The model that predicts left-out blocks better is kept, of two that do alike the one with fewer effects. An
effect stays where it predicts better by three standard errors, and a joint's torque clearly better.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.inverse.evidence import Samples, Torques
from pgrssnn_jax.discovery.inverse.fit import Fit, Gain, Tangent, fitted, gain, refitted, remembered, weight_of
from pgrssnn_jax.discovery.inverse.structures import STRUCTURE, Structure, Tried, span_of
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.base import Effect, Numbers

_KNOWN = {"viscous_friction": "B", "coulomb_friction": "Tc"}  # effects whose law is that of a number of the physics
_FINALISTS = 4
# Of the logarithm of the RMS error of the joint that gains most: less is not worth a name (docs: sensitivity).
_FALL = 0.1
Active = Mapping[str, Int[np.ndarray, " _"]]
Screened = Mapping[str, tuple[Gain, Float[np.ndarray, " p"]]]


class Model(NamedTuple):
    """active: places in θ of the effects."""

    fit: Fit
    active: Active


class Chosen(NamedTuple):
    """structure: the one that predicts best; recalibrated: the physics with its own numbers free; final: with the
    effects; without: the final model without each in turn, gains: what each predicts; candidates: gain of each over
    the recalibrated physics in its structure; rivals: structures that predict as well; kappa: samples over which errors
    remember."""

    structure: Structure
    recalibrated: Fit
    final: Model
    without: Mapping[str, Fit]
    gains: Mapping[str, Gain]
    candidates: Mapping[str, Gain]
    rivals: list[Tried]
    kappa: Float[np.ndarray, " n"]


class Search(NamedTuple):
    """What does not change while effects come and go. own: numbers of the physics that are free."""

    torques: Torques
    samples: Samples
    own: Int[np.ndarray, " k"]
    kappa: Float[np.ndarray, " n"]
    folds: int
    criteria: Criteria

    @property
    def problem(self) -> Problem:
        return self.torques.problem

    def places(self, active: Active) -> Int[np.ndarray, " k"]:
        return np.concatenate([self.own, *active.values()]).astype(int)

    def fit(self, theta: np.ndarray, active: Active) -> Fit:
        return fitted(self.torques, self.samples, theta, self.places(active), self.kappa, self.folds)

    def gain(self, before: Fit, after: Fit) -> Gain:
        return gain(before.left_out, after.left_out, self.samples, self.kappa)

    def worth(self, one: Gain) -> bool:
        return one.clear(self.criteria.certain) and one.fall >= _FALL

    def linear(self, theta: np.ndarray, active: Active, derivatives: np.ndarray | None = None) -> Fit:
        """One step from θ; derivatives: where they are known."""
        places = self.places(active)
        error, found = self.torques.linearised(theta, self.samples, places if derivatives is None else places[:0])
        at = Tangent(theta, places, error, found if derivatives is None else derivatives)
        weight = weight_of(error, self.samples, self.kappa)
        return refitted(self.torques, self.samples, at, weight, self.kappa, self.folds)


def own_places(problem: Problem) -> Int[np.ndarray, " k"]:
    """Numbers of the physics that it knows: one that is zero is not there."""
    own = problem.of(None)
    return own[problem.theta[own] != 0]


def select(search: Search, tried: Sequence[Tried], notify: Callable[[str], None]) -> Chosen:
    """tried: structures, the best one first, then those that predict as well."""
    problem, (best, *rivals) = search.problem, tried
    theta, structure = _placed(problem, best)
    everything = with_everything(search, best, begun=best.fit.theta)
    search = search._replace(kappa=remembered(everything.fit.error, search.samples))
    everything = Model(search.fit(everything.fit.theta, everything.active), everything.active)
    recalibrated = search.fit(problem.theta, {})
    start = Model(search.fit(theta, structure), structure)
    screened = _screened(search, start)
    candidates = {name: one for name, (one, _) in screened.items()}
    smaller = _pruned(search, everything)
    backward = _grown(search, smaller, _screened(search, smaller), notify)
    forward = _grown(search, start, screened, notify)
    final = _single_pruned(search, _better(search, forward, backward))
    without = {name: _without(search, final, name).fit for name in final.active}
    gains = {name: search.gain(fit, final.fit) for name, fit in without.items()}
    return Chosen(best.structure, recalibrated, final, without, gains, candidates, rivals, search.kappa)


def finalists(search: Search, tried: Sequence[Tried]) -> list[Tried]:
    """The first structures, now fitted with all effects and to more samples: the simplest one that is as good as the
    best, then those that change no more and predict as well."""
    fits = [with_everything(search, one).fit for one in tried[:_FINALISTS]]
    best = max(fits, key=lambda fit: search.gain(fits[0], fit).value)
    alike = [k for k, fit in enumerate(fits) if not search.gain(fit, best).clear(search.criteria.certain)]
    return [tried[k]._replace(fit=fits[k]) for k in alike]


def _placed(problem: Problem, best: Tried) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """θ in a structure, and the places of its numbers."""
    theta, active = problem.theta, dict[str, np.ndarray]()
    for name, numbers in best.structure.numbers().items():
        theta = problem.put(theta, name, numbers)
        active[name] = np.array([place for place in problem.of(name) if theta[place] != problem.theta[place]])
    return theta, active


def with_everything(
    search: Search, best: Tried, without: Sequence[str] = (), begun: Float[np.ndarray, " p"] | None = None
) -> Model:
    """All effects beside the structure, but for those named in `without` and the elaborate ones, of which only those
    come in that predict: masses of all links beside a gain have no scale. begun: numbers of a fit to other samples."""
    problem = search.problem
    theta, structure = _placed(problem, best)
    active = dict(structure)
    for effect in problem.effects:
        if not (effect.elaborate or effect.name in (*STRUCTURE, *without) or _is_own(problem, effect.name)):
            active[effect.name] = problem.of(effect.name)
            if begun is None:
                theta = problem.put(theta, effect.name, _best_guess(search, best, effect))
    return Model(search.fit(theta if begun is None else begun, active), active)


def _best_guess(search: Search, best: Tried, effect: Effect) -> Numbers:
    """From where a fit of one effect beside the structure predicts best: a spring that pulls cannot turn into one that
    pushes on its way."""
    guesses = effect.guesses(span_of(search.samples))
    if len(guesses) == 1:
        return guesses[0]
    theta, structure = _placed(search.problem, best)
    active = {**structure, effect.name: search.problem.of(effect.name)}
    fits = [search.linear(search.problem.put(theta, effect.name, numbers), active) for numbers in guesses]
    return guesses[max(range(len(fits)), key=lambda k: search.gain(fits[0], fits[k]).value)]


def _plainer(problem: Problem, name: str) -> list[str]:
    """Effects that one comes beside, and never in place of: nothing else keeps dry friction from taking any form."""
    return [one for one in problem.effect(name).simpler if any(one == effect.name for effect in problem.effects)]


def _is_own(problem: Problem, name: str) -> bool:
    """Is the effect's law one of the physics, whose number is free already?"""
    symbol = _KNOWN.get(name)
    own = [problem.theta[i] for i in problem.of(None) if problem.slots[i].path == (symbol,)]
    return bool(own) and all(value != 0 for value in own)


def _better(search: Search, one: Model, other: Model) -> Model:
    """The one that predicts better; of two that do alike the one with fewer effects."""
    fewer, more = sorted((one, other), key=lambda model: len(model.active))
    return more if search.worth(search.gain(fewer.fit, more.fit)) else fewer


def _grown(search: Search, now: Model, screened: Screened, notify: Callable[[str], None]) -> Model:
    """With whatever else predicts, one effect after another, elaborate ones when no plain one does; what has been
    superfluous once does not come back. screened: beside the model from which it grows."""
    refused, superfluous = set[str](), set[str]()
    while True:
        worth = [
            (search.problem.effect(name).elaborate, -one.value, name)
            for name, (one, _) in screened.items()
            if name not in refused | superfluous and search.worth(one)
        ]
        if not worth:
            return now
        *_, name = min(worth)
        refused.add(name)
        active = {**now.active, name: search.problem.of(name)}
        grown = Model(search.fit(screened[name][1], active), active)
        better = search.gain(now.fit, grown.fit)
        if search.worth(better):
            notify(f"{name}: log-likelihood + {better.value:.0f} ± {better.error:.0f}")
            now, refused = _pruned(search, grown), set()
            screened = _screened(search, now)
            superfluous |= set(active) - set(now.active)


def _screened(search: Search, now: Model) -> Screened:
    """Gain of every effect that is not there, by one linear step from where its fit begins, and θ there."""
    problem, span = search.problem, span_of(search.samples)
    found: dict[str, tuple[Gain, np.ndarray]] = {}
    for effect in problem.effects:
        places = problem.of(effect.name)
        if _is_own(problem, effect.name) or len(now.active.get(effect.name, ())) == len(places):
            continue
        if any(name not in now.active and not _is_own(problem, name) for name in _plainer(problem, effect.name)):
            continue
        starts = [] if effect.name in now.active else effect.guesses(span)
        for theta in [problem.put(now.fit.theta, effect.name, numbers) for numbers in starts] or [now.fit.theta]:
            active = {**now.active, effect.name: places}
            fit = search.linear(theta, active, _derivatives(search, now, theta, active))
            better = search.gain(now.fit, fit)
            if effect.name not in found or better.value > found[effect.name][0].value:
                found[effect.name] = better, theta
    return found


def _derivatives(search: Search, now: Model, theta: np.ndarray, active: Active) -> Float[np.ndarray, "k n batch"]:
    """By all numbers of more effects; those by the others are as good as before, wherever a fit begins."""
    places = search.places(active)
    new = ~np.isin(places, now.fit.places)
    known = dict(zip(now.fit.places.tolist(), now.fit.derivatives, strict=True))
    found = np.empty((len(places), *now.fit.error.shape))
    found[new] = search.torques.linearised(theta, search.samples, places[new])[1]
    for row in np.flatnonzero(~new):
        found[row] = known[int(places[row])]
    return found


def _pruned(search: Search, now: Model) -> Model:
    """Without effects that do not predict, the least one first; those of the structure when no other is idle."""
    while True:
        needed = {plain for name in now.active for plain in _plainer(search.problem, name)}
        for names in (set(now.active) - STRUCTURE - needed, set(now.active) & STRUCTURE):
            without = {name: _without(search, now, name) for name in sorted(names)}
            gains = {name: search.gain(one.fit, now.fit) for name, one in without.items()}
            idle = [name for name, one in gains.items() if not search.worth(one)]
            if idle:
                rest = without[min(idle, key=lambda one: gains[one].value)]
                now = Model(search.fit(rest.fit.theta, rest.active), rest.active)
                break
        else:
            return now


def _without(search: Search, now: Model, name: str) -> Model:
    """The others refitted in one step. Derivatives by their numbers do not depend on an effect that adds a torque, but
    on one that scales it."""
    problem = search.problem
    theta = problem.put(now.fit.theta, name, problem.effect(name).neutral())
    active = {other: places for other, places in now.active.items() if other != name}
    keeps = np.isin(now.fit.places, search.places(active))
    changed = name in STRUCTURE or np.isin(problem.of(name), search.torques.scales).any()
    known = None if changed else now.fit.derivatives[keeps]
    return Model(search.linear(theta, active, known), active)


def _single_pruned(search: Search, now: Model) -> Model:
    """Without single numbers that do not predict: of joints, of the parts of a coupling."""
    problem = search.problem
    alone = {name: _acting_alone(search, now, name) for name in now.active}
    while True:
        idle: list[tuple[float, str, int]] = []
        for name, places in now.active.items():
            parts = places[np.isin(places, alone[name])]
            for place in parts if len(parts) > 1 else ():
                theta, active, keeps = _one_less(problem, now, name, int(place))
                fit = search.linear(theta, active, now.fit.derivatives[keeps])
                if not (found := search.gain(fit, now.fit)).clear(search.criteria.certain):
                    idle.append((found.value, name, int(place)))
        if not idle:
            break
        theta, active, keeps = _one_less(problem, now, *min(idle)[1:])
        now = Model(search.linear(theta, active, now.fit.derivatives[keeps]), active)
    idling = now.fit.places[~np.abs(now.fit.derivatives).any((1, 2))]  # how fast what has been pruned would turn
    active = {name: places[~np.isin(places, idling)] for name, places in now.active.items()}
    return Model(search.fit(now.fit.theta, active), active)


def _acting_alone(search: Search, now: Model, name: str) -> Int[np.ndarray, " _"]:
    """Numbers of an effect that change a torque while its others are neutral: parts of a sum, not of a product."""
    problem, places = search.problem, now.active[name]
    theta = problem.put(now.fit.theta, name, problem.effect(name).neutral())
    return places[np.abs(search.torques.linearised(theta, search.samples, places)[1]).any((1, 2))]


def _one_less(problem: Problem, now: Model, name: str, place: int) -> tuple[np.ndarray, Active, np.ndarray]:
    """θ with one number neutral, the places that are left, and which of the free ones they are."""
    theta = now.fit.theta.copy()
    theta[place] = problem.put(theta, name, problem.effect(name).neutral())[place]
    return theta, {**now.active, name: now.active[name][now.active[name] != place]}, now.fit.places != place
