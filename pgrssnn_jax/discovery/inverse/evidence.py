"""The evidence of inverse dynamics: by how much the torque that a model asks for misses the one that was measured.

    e(θ) = u - û(θ; q, q̇, q̈)        motor torque, Nm; zero where the model is right (`arms/residual.py`)

q, q̇, q̈ come from the record (`motion.py`): nothing is simulated, and e is linear in almost all that an arm may lack.
Only the samples in which a joint moves for certain are evidence of its torque. At rest friction holds it against any
torque within its reach, and the noise says which way: a fit to both would trade friction for what happens at rest.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Int

from pgrssnn_jax.acceleration.compiler import quick_jit
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.effects.arm_common import STANDSTILL
from pgrssnn_jax.effects.base import Effect, points_changed
from pgrssnn_jax.physics.arms.points import ArmPoints, along
from pgrssnn_jax.physics.arms.residual import (
    inverse_inputs,
    required_slopes,
    required_torque,
    torque_residual,
    torque_slope,
)
from pgrssnn_jax.physics.base import Physics, extension_of

_STILL = 0.02  # of a joint's highest speed (99 % of the samples are below): slower, it stands still
SMOOTHED = 3 * STANDSTILL  # rad/s: from here on the smoothed dry friction of an effect is 99.5 % of its own
_CERTAIN = 3.0  # standard deviations of a speed whose sign is known
_LEAST_BLOCKS = 24
_AT_ONCE = 32  # derivatives that one program computes: one program for all
_PIECE = 128  # samples of one, compiled once: its arrays stay in a small cache (half the time that 1024 take)
_JUDGED = frozenset(("drive", "torque", "position", "masses", "disturbance"))  # points that a torque depends on
_HEAVY = frozenset(("masses", "position", "disturbance"))  # those that the inverse dynamics depend on
Errors = Float[np.ndarray, "n batch"]


class Samples(NamedTuple):
    """Of all sequences end to end, each of `length` samples. torque: of the motors, Nm; block: those of one number are
    left out together; moving: does the joint, for certain? slow: speed below which it may stand still, rad/s."""

    reading: Errors
    v: Errors
    a: Errors
    torque: Errors
    block: Int[np.ndarray, " batch"]
    moving: Bool[np.ndarray, "n batch"]
    length: int
    slow: Float[np.ndarray, " n"]

    @property
    def blocks(self) -> int:
        return int(self.block.max()) + 1


def samples_of(motion: Motion, fastest: Float[np.ndarray, " n"], least: float = 0.0) -> Samples:
    """fastest: speed of every joint that standstill is relative to; least: speed below which any joint counts as at
    rest, rad/s. Blocks are sequences, or parts of few ones."""
    sequences, time, n = motion.v.shape
    pieces = -(-_LEAST_BLOCKS // sequences)
    within = np.minimum(np.arange(time) * pieces // time, pieces - 1)
    blocks = (np.arange(sequences)[:, None] * pieces + within).ravel()
    reading, v, a, torque = (np.ascontiguousarray(one.reshape(-1, n).T) for one in motion[:4])
    slow = np.maximum(np.maximum(_STILL * fastest, least), _CERTAIN * motion.unsure)
    return Samples(reading, v, a, torque, blocks, np.abs(v) > slow[:, None], time, slow)


def fastest_of(motion: Motion) -> Float[np.ndarray, " n"]:
    return np.quantile(np.abs(motion.v), 0.99, axis=(0, 1))


@dataclass(frozen=True, eq=False)
class Torques:
    """Errors of a problem, and their derivatives by the numbers of θ at `places`, `[place, n, batch]`. moves: the
    places of numbers that the inverse dynamics depend on; all others cost next to nothing. scales: of those that D
    depends on, and with it the derivatives by all others."""

    problem: Problem
    moves: Int[np.ndarray, " m"]
    scales: Int[np.ndarray, " s"]
    _linearised: Callable[..., Sequence[jax.Array]]

    def errors(self, theta: np.ndarray, samples: Samples) -> Errors:
        return self.linearised(theta, samples, np.array([], int))[0]

    def linearised(
        self, theta: np.ndarray, samples: Samples, places: Int[np.ndarray, " k"]
    ) -> tuple[Errors, Float[np.ndarray, "k n batch"]]:
        """Errors and their derivatives."""
        heavy = np.isin(places, self.moves)
        moving, still = (_directions(places[kind], len(theta)) for kind in (heavy, ~heavy))
        found = _in_pieces(partial(self._linearised, moving, still, jnp.asarray(theta)), samples)
        derivatives = np.empty((len(places), *found.shape[1:]))
        derivatives[heavy] = found[1 : 1 + heavy.sum()]
        derivatives[~heavy] = found[1 + _AT_ONCE * len(moving) :][: (~heavy).sum()]
        return found[0], derivatives


def _directions(places: Int[np.ndarray, " k"], count: int) -> list[jax.Array]:
    """Unit vectors along numbers of θ, as many in each group as one program takes; the last group repeats some."""
    along = np.eye(count)[np.resize(places, -(-len(places) // _AT_ONCE) * _AT_ONCE)]
    return [jnp.asarray(group) for group in along.reshape(-1, _AT_ONCE, count)]


def _in_pieces(function: Callable[..., Sequence[jax.Array]], samples: Samples) -> Float[np.ndarray, "row n batch"]:
    """function: rows `[row, n, piece]` of reading, v, a and torque; a last piece that is not full repeats its last
    sample."""
    batch = samples.torque.shape[1]
    signals = [np.pad(one, ((0, 0), (0, -batch % _PIECE)), mode="edge") for one in samples[:4]]
    pieces = [function(*(one[:, k : k + _PIECE] for one in signals)) for k in range(0, batch, _PIECE)]
    return np.concatenate([np.concatenate(parts) for parts in pieces], -1)[..., :batch]


def torques(problem: Problem) -> Torques:
    """Of a problem about an arm whose dynamics are in JAX."""
    known = extension_of(problem.full)
    assert known is not None
    points: ArmPoints = known.points
    dt = problem.physics.dt
    nothing = jnp.zeros((_AT_ONCE, points.tables.n, _PIECE))

    @quick_jit()
    def required(theta: jax.Array, *motion: jax.Array) -> jax.Array:
        return required_torque(points, problem.code.unravel(theta), dt, *motion)

    @quick_jit()
    def slopes(theta: jax.Array, *motion: jax.Array) -> tuple[jax.Array, jax.Array]:
        return required_slopes(points, problem.code.unravel(theta), dt, *motion)

    @quick_jit()
    def required_along(theta: jax.Array, matrix: jax.Array, directions: jax.Array, *motion: jax.Array) -> jax.Array:
        def inputs(numbers: jax.Array) -> tuple[Any, ...]:
            return inverse_inputs(points, problem.code.unravel(numbers), dt, *motion)

        return jax.vmap(lambda one: along(matrix, *jax.jvp(inputs, (theta,), (one,))[1]))(directions)

    def error(theta: jax.Array, needed: jax.Array, *signals: jax.Array) -> jax.Array:
        return torque_residual(points, problem.code.unravel(theta), needed, *signals)

    @quick_jit()
    def residual(theta: jax.Array, needed: jax.Array, *signals: jax.Array) -> jax.Array:
        return error(theta, needed, *signals)[None]

    @quick_jit()
    def residual_along(
        theta: jax.Array, directions: jax.Array, needed: jax.Array, moved: jax.Array, *signals: jax.Array
    ) -> jax.Array:
        def at(numbers: jax.Array, needed: jax.Array) -> jax.Array:
            return error(numbers, needed, *signals)

        return jax.vmap(lambda *one: jax.jvp(at, (theta, needed), one)[1])(directions, moved)

    # Programs of parts compile in less time than one of all: each part once.
    def linearised(
        moving: Sequence[jax.Array], still: Sequence[jax.Array], theta: jax.Array, *signals: ArrayLike
    ) -> list[jax.Array]:
        """Errors, derivatives along directions that change what a motion requires, and along those that do not."""
        reading, v, a, u = signals
        motion, found = (reading, v, a), (reading, v, u)
        needed, matrix = slopes(theta, *motion) if moving else (required(theta, *motion), None)
        changes = [(group, required_along(theta, matrix, group, *motion)) for group in moving]
        changes += [(group, nothing) for group in still]
        by = [residual_along(theta, group, needed, moved, *found) for group, moved in changes]
        return [residual(theta, needed, *found), *by]

    def slope(theta: jax.Array) -> jax.Array:
        one = jnp.ones(len(problem.physics.inputs))
        return torque_slope(points, problem.code.unravel(theta), one, one, one)

    heavies = [e.name for e in problem.effects if (points_changed(problem.physics, e) or set()) & _HEAVY]
    moves = np.concatenate([[], *map(problem.of, heavies)]).astype(int)
    scales = np.flatnonzero(np.asarray(jax.jit(jax.jacfwd(slope))(jnp.asarray(problem.theta))).any((0, 1)))
    return Torques(problem, moves, scales, linearised)


def judged(physics: Physics, effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Those that change a torque and nothing else of a step: inverse dynamics sees all that they do."""
    return tuple(e for e in effects if (points_changed(physics, e) or {"none"}) <= _JUDGED)
