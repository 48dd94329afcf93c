"""What is discrete in an arm: the direction of gravity and the zeros of its encoders, in quarter turns.

Every combination is compared with all that is linear beside it free (payload, counterbalance, friction, motor inertia,
constant torques, and angles near the quarter turns): a wrong structure hides behind such stand-ins, and a right one
must not need them. A structure whose angles have to leave its quarter turns is none. Structures that predict as well
are told apart by how little they change.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.inverse.evidence import Samples, Torques
from pgrssnn_jax.discovery.inverse.fit import Fit, Gain, Tangent, gain, refitted, weight_of
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.effects.base import SignalRange

GRAVITY, HOME = "gravity_direction", "home_offset"
STRUCTURE = frozenset((GRAVITY, HOME))
QUARTERS = (0.0, np.pi / 2, np.pi, -np.pi / 2)
DIRECTIONS = ((0.0, 0.0), (np.pi, 0.0), (np.pi / 2, 0.0), (-np.pi / 2, 0.0), (0.0, np.pi / 2), (0.0, -np.pi / 2))
BESIDE = ("torque_bias", "rotor_inertia", "payload", "gravity_counterbalance", "viscous_friction", "coulomb_friction")
_CERTAIN = 3.0  # standard errors by which a structure that changes more must predict better
_NEAR = 0.35  # rad from a quarter turn: 20 degrees
_FREE = np.pi / 4  # rad from what is described, where no quarter turn is
_TOGETHER = 2  # joints whose zeros are tried together with gravity: those behind the first carry the arm


class Structure(NamedTuple):
    """tilt: of gravity about x and y; zeros: of the encoders, rad."""

    tilt: tuple[float, float]
    zeros: tuple[float, ...]

    @property
    def changes(self) -> int:
        return int(any(self.tilt)) + sum(map(bool, self.zeros))

    def numbers(self) -> dict[str, dict[str, np.ndarray]]:
        """Of the effects that it consists of."""
        found: dict[str, dict[str, np.ndarray]] = {}
        if any(self.tilt):
            found[GRAVITY] = {"about_x": np.asarray(self.tilt[0]), "about_y": np.asarray(self.tilt[1])}
        if any(self.zeros):
            found[HOME] = {"offset": np.array(self.zeros)}
        return found


class Tried(NamedTuple):
    """gain: of the structure over the nominal one."""

    structure: Structure
    gain: Gain
    fit: Fit


def best_structures(
    torques: Torques, samples: Samples, own: Int[np.ndarray, " k"], kappa: Float[np.ndarray, " n"], folds: int
) -> list[Tried]:
    """The best one first, then those that the data cannot tell from it; own: numbers of the physics that are free."""
    problem, n = torques.problem, len(samples.torque)
    names = {effect.name for effect in problem.effects}
    theta = problem.theta
    span = span_of(samples)
    for name in sorted(names & set(BESIDE)):
        theta = problem.put(theta, name, problem.effect(name).guesses(span)[0])
    beside = [problem.of(name) for name in (*BESIDE, *sorted(STRUCTURE)) if name in names]
    places = np.concatenate([own, *beside]).astype(int)

    def fit(structure: Structure) -> Fit:
        at = theta
        for name, numbers in structure.numbers().items():
            at = problem.put(at, name, numbers)
        inside = replace(torques, problem=_either_way(near(problem, structure)))
        tangent = Tangent(at, places, *torques.linearised(at, samples, places))
        weight = weight_of(samples.torque - samples.torque.mean(1, keepdims=True), samples, kappa)
        return refitted(inside, samples, tangent, weight, kappa, folds)

    none = Structure((0.0, 0.0), (0.0,) * n)
    nominal = fit(none)

    def compared(structures: Iterable[Structure]) -> list[Tried]:
        fits = [(one, nominal if one == none else fit(one)) for one in structures]
        return [Tried(s, gain(nominal.left_out, f.left_out, samples, kappa), f) for s, f in fits]

    tried = compared(_first(n, names))
    for joint in range(1 + _TOGETHER, n) if HOME in names else ():
        best = max(tried, key=lambda one: one.gain.value)
        zeros = best.structure.zeros
        others = (Structure(best.structure.tilt, (*zeros[:joint], turn, *zeros[joint + 1 :])) for turn in QUARTERS[1:])
        tried += compared(others)
    return _ranked([one for one in tried if not (one.structure.changes and _leaves(problem, one))], samples, kappa)


def _first(n: int, names: set[str]) -> Iterator[Structure]:
    """Gravity together with the joints that carry most; the first joint's axis is along gravity, or shows nothing."""
    together = range(1, min(1 + _TOGETHER, n)) if HOME in names else ()
    for tilt in DIRECTIONS if GRAVITY in names else DIRECTIONS[:1]:
        for turns in product(QUARTERS, repeat=len(together)):
            zeros = np.zeros(n)
            zeros[list(together)] = turns
            yield Structure(tilt, tuple(zeros.tolist()))


def _ranked(tried: Sequence[Tried], samples: Samples, kappa: Float[np.ndarray, " n"]) -> list[Tried]:
    """The simplest of those that are as good as the best, then the others of them."""
    best = max(tried, key=lambda one: one.gain.value)
    rivals = [one for one in tried if not gain(one.fit.left_out, best.fit.left_out, samples, kappa).clear(_CERTAIN)]
    return sorted(rivals, key=lambda one: (one.structure.changes, -one.gain.value))


def _leaves(problem: Problem, one: Tried) -> bool:
    """Are gravity, or zeros of the joints that carry, as far from the structure as they may be?"""
    bounded = near(problem, one.structure)
    names = {effect.name for effect in problem.effects}
    places = [*problem.of(GRAVITY)] if GRAVITY in names else []
    places += [*problem.of(HOME)][1 : 1 + _TOGETHER] if HOME in names else []
    return bool(np.isin(one.fit.theta[places], [bounded.low[places], bounded.high[places]]).any())


def near(problem: Problem, structure: Structure) -> Problem:
    """The problem in which zeros and gravity stay near a structure. The zero of the first joint turns the whole arm
    about gravity, and stays where it is."""
    low, high, width = problem.low.copy(), problem.high.copy(), _NEAR if structure.changes else _FREE
    for name in STRUCTURE & {effect.name for effect in problem.effects}:
        numbers = {**problem.effect(name).neutral(), **structure.numbers().get(name, {})}
        at = problem.put(problem.theta, name, numbers)
        places = problem.of(name)
        low[places], high[places] = at[places] - width, at[places] + width
        if name == HOME:
            low[places[0]] = high[places[0]] = at[places[0]]
    return replace(problem, low=low, high=high)


def _either_way(problem: Problem) -> Problem:
    """A counterbalance may push as well as pull: one step from where it begins cannot turn its angle round."""
    low = problem.low.copy()
    low[[slot.path == ("gravity_counterbalance", "moment") for slot in problem.slots]] = -np.inf
    return replace(problem, low=low)


def wrapped(problem: Problem, theta: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    """The same angles between -π and π."""
    names = {GRAVITY, HOME, "gravity_counterbalance"} & {effect.name for effect in problem.effects}
    places = [i for name in names for i in problem.of(name) if problem.slots[i].meaning.unit == "rad"]
    found = theta.copy()
    found[places] -= 2 * np.pi * np.round(theta[places] / (2 * np.pi))
    return found


def span_of(samples: Samples) -> SignalRange:
    """Lowest and highest value of every signal."""
    state = np.concatenate([samples.reading, samples.v])
    x, u, y = (np.stack([one.min(1), one.max(1)]) for one in (state, samples.torque, samples.reading))
    return SignalRange(x, u, y)
