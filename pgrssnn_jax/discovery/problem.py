"""The estimation problem of discovery: one record, one physics with all candidate effects in it, every number in a row.

    θ = (parameters of the physics, parameters of every effect)        neutral effects change nothing

so that one compiled program fits any choice of effects: a fit is told which numbers of θ are free.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.code import Code, code_of
from pgrssnn_jax.effects.base import Effect, SignalRange, WithEffects, add, effects_of, own_of
from pgrssnn_jax.physics.base import Parameter, Physics, is_parameter
from pgrssnn_jax.physics.signals import unit_at
from pgrssnn_jax.physics.simulate import first_output_state
from pgrssnn_jax.records.record import Record

_MATRIX_REACH = 0.5  # of a matrix's largest entry
_BEGINNING = 8  # one part in so many of a short sequence is in every fit
HELD = 1e250  # precision of a start that a fit leaves as it is, in any unit of a state
ALWAYS = -2  # fold of samples that are never left out


class Slot(NamedTuple):
    """What one number of θ is: path of names in the physics' own params or in those of effects, its place in an array,
    label (names and indices, from 1), its meaning, the effect it belongs to, None: the nominal physics."""

    path: tuple[str, ...]
    element: tuple[int, ...]
    label: str
    meaning: Parameter
    effect: str | None


@dataclass(frozen=True, eq=False)
class Problem:
    """What does not change during a discovery. slots: one per number of θ; theta: the nominal physics, effects
    neutral; precision: of the nominal physics (0: nothing is held), where the weighted errors have the variance noise;
    code: shared by problems that differ in numbers alone (`with_numbers`)."""

    physics: Physics
    code: Code
    effects: tuple[Effect, ...]
    slots: tuple[Slot, ...]
    theta: Float[np.ndarray, " p"]
    low: Float[np.ndarray, " p"]
    high: Float[np.ndarray, " p"]
    precision: Float[np.ndarray, " p"]
    noise: float = 1.0

    @property
    def full(self) -> Physics:
        return self.code.full

    def with_numbers(self, params: Any) -> "Problem":
        """The same problem for other numbers of the same physics; compiled programs serve both."""
        physics = self.physics._replace(params=params)
        whole = _double(_with_known(self.full.params, params))
        theta = np.asarray(ravel_pytree(whole)[0], np.float64)
        low, high = _bounds(whole, self.slots)
        return replace(self, physics=physics, theta=theta, low=low, high=high, precision=np.zeros(len(theta)))

    def held(self, tolerance: float, noise: float) -> "Problem":
        """The same problem whose physics is known by a prior: the relative standard deviation of what was
        given (of a matrix: relative to its largest entry), where `noise` is the variance of the weighted errors. A zero
        says nothing about its size and is not held."""
        own = self.of(None)
        deviation = np.zeros(len(self.theta))
        deviation[own] = tolerance * self.scales(own)
        held = deviation > 0
        return replace(self, precision=np.where(held, noise / np.where(held, deviation, 1.0) ** 2, 0.0), noise=noise)

    def scales(self, places: Int[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Sizes of nominal numbers; of an entry of a matrix, of its largest one."""
        paths = [slot.path for slot in self.slots]
        same = [[i for i, path in enumerate(paths) if path == paths[place]] for place in places]
        return np.array([np.abs(self.theta[alike]).max() for alike in same])

    def penalty(self, theta: np.ndarray) -> float:
        """Σ (θ - given)² precision."""
        held = self.precision > 0
        return float((self.precision[held] * (theta[held] - self.theta[held]) ** 2).sum())

    def of(self, effect: str | None) -> Int[np.ndarray, " k"]:
        """Positions in θ of the numbers of an effect that a fit may move; None: of the physics itself."""
        return np.array([i for i, s in enumerate(self.slots) if s.effect == effect and s.meaning.trainable], int)

    def put(self, theta: np.ndarray, effect: str, numbers: Mapping[str, Any]) -> np.ndarray:
        """θ with all numbers of an effect."""
        places = [i for i, s in enumerate(self.slots) if s.effect == effect]
        theta = theta.copy()
        theta[places] = np.concatenate([np.ravel(numbers[name]) for name in sorted(numbers)])
        return theta

    def effect(self, name: str) -> Effect:
        return next(effect for effect in self.effects if effect.name == name)

    def beginnings(self, effects: Sequence[str], x0: np.ndarray) -> list[Float[np.ndarray, "seq x"]]:
        """x_0 with the states of effects that begin anew in every record at each of their guesses; x_0 itself where the
        effects have none."""
        guesses = {k: v for name in effects for k, v in self.effect(name).memory_guesses.items()}
        found = [x0.copy() for _ in range(max(map(len, guesses.values()), default=1))]
        for i, state in enumerate(self.full.states):
            for k, begun in enumerate(found):
                if state.name in guesses:
                    begun[:, i] = guesses[state.name][k % len(guesses[state.name])]
        return found

    def credible(self, effects: Sequence[str], theta: np.ndarray, span: SignalRange) -> bool:
        """Are the numbers of all these effects credible, beside the range of the data?"""
        rules = {name: rule for name in effects if (rule := self.effect(name).credible) is not None}
        numbers = self.params(theta).effects if rules else {}
        return all(rule(numbers[name], span) for name, rule in rules.items())

    def params(self, theta: np.ndarray) -> Any:
        """θ as params of `full`, in NumPy."""
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, self.code.unravel(jnp.asarray(theta)))

    def known(self, theta: np.ndarray) -> Any:
        """θ as params of `physics`: without the numbers of the effects that are looked for."""
        whole, given = self.params(theta), self.physics.params
        if not isinstance(given, WithEffects):
            return own_of(whole)
        return WithEffects(whole.own, {name: whole.effects[name] for name in given.effects})


class Signals(NamedTuple):
    """The record as arrays: u `[seq, time, u]`, y and weight `[seq, time, y]` (weight 0: not measured), block
    `[seq, time]` the fold that a sample belongs to in cross-validation, ALWAYS where it is never left out; start
    `[seq, x]`: a first guess of x_0; precision `[seq, x]`: of that guess, inverse variance for unit variance of the
    weighted errors."""

    u: Float[np.ndarray, "seq time u"]
    y: Float[np.ndarray, "seq time y"]
    weight: Float[np.ndarray, "seq time y"]
    block: Int[np.ndarray, "seq time"]
    start: Float[np.ndarray, "seq x"]
    precision: Float[np.ndarray, "seq x"]

    @property
    def size(self) -> int:
        """Measured samples, at least 1."""
        return max(1, int((self.weight > 0).sum()))


def build_problem(
    physics: Physics, effects: Sequence[Effect], *, fixed: Sequence[str] = (), accelerate: bool = True
) -> Problem:
    """fixed: names of parameters of the physics that no fit moves; accelerate: False without the tricks of
    `pgrssnn_jax.acceleration`."""
    full = add(physics, *effects)
    names = {effect.name for effect in effects}
    params = _double(full.params)
    theta, unravel = ravel_pytree(params)
    slots: list[Slot] = []
    meanings = jax.tree.leaves(full.parameters, is_leaf=is_parameter)
    for (path, value), meaning in zip(jax.tree_util.tree_leaves_with_path(params), meanings, strict=True):
        keys = tuple(jax.tree_util.keystr((key,), simple=True) for key in path)
        place, keys = (keys[0], keys[1:]) if isinstance(params, WithEffects) else ("own", keys)
        if place == "own" and keys[0] in fixed:
            meaning = meaning._replace(trainable=False)
        effect = keys[0] if place == "effects" and keys[0] in names else None
        for index in np.ndindex(np.shape(value)):
            label = ".".join(keys) + "".join(f"[{i + 1}]" for i in index)
            own_unit = unit_at(meaning.unit, index, np.shape(value))
            slots.append(Slot(keys, index, label, meaning._replace(unit=own_unit), effect))
    low, high = _bounds(params, tuple(slots))
    own = len(physics.states)
    free = np.array([i < own or state.fit_initial for i, state in enumerate(full.states)])
    theta = np.asarray(theta, np.float64)
    return Problem(
        physics,
        code_of(full, unravel, len(theta), free, accelerate),
        tuple(effects),
        tuple(slots),
        theta,
        low,
        high,
        np.zeros(len(theta)),
    )


def _bounds(params: Any, slots: tuple[Slot, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of θ. Entries of a matrix without bounds stay near what was given, or the fit of a linear model would turn
    a mode that the system does not have into whatever is missing (a pole at 1 is a constant)."""
    low, high = (np.array([slot.meaning.bounds[k] for slot in slots]) for k in (0, 1))
    given, _ = ravel_pytree(params)
    largest, _ = ravel_pytree(
        jax.tree.map(lambda p: np.full(p.shape, np.abs(p).max() if p.ndim > 1 else np.inf), params)
    )
    near = np.isinf(low) & np.isinf(high) & np.array([slot.effect is None for slot in slots], bool)
    reach = np.where(near & np.isfinite(largest), _MATRIX_REACH * np.asarray(largest), np.inf)
    return np.where(np.isfinite(reach), given - reach, low), np.where(np.isfinite(reach), given + reach, high)


def _with_known(full: Any, known: Any) -> Any:
    """Params with those of the physics replaced, which may have effects of its own."""
    if not isinstance(full, WithEffects):
        return known
    return WithEffects(own_of(known), {**full.effects, **effects_of(known)})


def _double(params: Any) -> Any:
    return jax.tree.map(lambda p: np.asarray(p, np.float64), params)


def weighted_signals(problem: Problem, record: Record, *, folds: int, block: int) -> Signals:
    """Records in float64 with weights 1 / std(y) and interleaved blocks of `block` samples in `folds` folds.

    Blocks are short and folds interleave, so that an effect that acts in one stretch only is in every fold. The
    beginning of a sequence, a block or an eighth of it, stays in every fit: it is what says where the sequence starts.
    """
    u, y = np.asarray(record.u, np.float64), np.asarray(record.y, np.float64)
    mask = np.asarray(record.mask, bool)
    counted = np.where(mask, y, np.nan)
    spread = np.nanstd(counted, axis=(0, 1))
    weight = np.where(mask, 1.0 / np.where(spread > 0, spread, 1.0), 0.0)
    n_seq, time = u.shape[:2]
    turn = time // block + 1
    turn += turn % folds == 0  # or every sequence would leave the same blocks out
    order = np.arange(n_seq)[:, None] * turn + np.arange(time)[None] // block
    fold = np.where(np.arange(time) < min(block, max(1, time // _BEGINNING)), ALWAYS, order % folds)
    start = start_guess(problem.full, u, y, mask)
    return Signals(u, y, weight, fold, start, np.zeros(start.shape))


def carried(
    origin: Problem, target: Problem, theta: np.ndarray, x0: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """θ and x_0 of one problem in another of the same physics with other effects; start: x_0 of states that are new."""
    places = {(slot.effect, slot.label): i for i, slot in enumerate(origin.slots)}
    states = {state.name: i for i, state in enumerate(origin.full.states)}
    moved, begun = target.theta.copy(), start.copy()
    for i, slot in enumerate(target.slots):
        if (slot.effect, slot.label) in places:
            moved[i] = theta[places[slot.effect, slot.label]]
    for i, state in enumerate(target.full.states):
        if state.name in states:
            begun[:, i] = x0[:, states[state.name]]
    return moved, begun


def start_guess(physics: Physics, u: np.ndarray, y: np.ndarray, mask: np.ndarray) -> Float[np.ndarray, "seq x"]:
    """x_0 from the first sample of every output that was measured, and the first input."""
    first = np.take_along_axis(y, mask.argmax(1)[:, None], 1)[:, 0]
    return np.asarray(first_output_state(physics, first, u[:, 0]))
