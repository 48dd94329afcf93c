"""The contract of everything that may be missing from a physics: named effects as functions `Physics -> Physics`.

    Physics + Effect = Physics          with the effect's parameters at their neutral values it changes nothing

The parameters of an effect live in `physics.params[effect.name]`, a flat dictionary of numbers or of one array per
parameter (one number per channel or joint), with a `Parameter` of the same name in `physics.parameters[effect.name]`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Parameter, Physics, Signal

Numbers = Mapping[str, Any]
Map = Callable[[Any, jax.Array], jax.Array]
After = Callable[[Any, jax.Array, jax.Array, jax.Array], jax.Array]


class SignalRange(NamedTuple):
    """Where the data take the system: lowest and highest value of every state, input and output in a simulation of the
    physics that the effect is to be added to. Thresholds are looked for inside."""

    x: Float[np.ndarray, "2 x"]
    u: Float[np.ndarray, "2 u"]
    y: Float[np.ndarray, "2 y"]


class Effect(NamedTuple):
    """One named physical effect.

    equation: for people; cause: one line; acts_on: where it enters; parameters: what its numbers mean, each with its
    neutral value; shapes: of those that are arrays (per channel or joint); initial_guesses: where fits begin, for
    the range of the data; wrap: the physics with the effect, whose functions find its numbers in `params[name]`;
    active: share of the samples in which it acts, from `(numbers, x, u)` with x `[time, x]`, u `[time, u]`, None where
    it always does; simpler: names of effects that are preferred to this one where they do as well; channels: what
    one number of an array belongs to (`output`, `input`, `joint`; of a matrix `output, input`).
    """

    name: str
    title: str
    equation: str
    cause: str
    acts_on: Literal["input", "dynamics", "measurement"]
    parameters: Mapping[str, Parameter]
    initial_guesses: Callable[[SignalRange], Sequence[Numbers]]
    wrap: Callable[[Physics], Physics]
    shapes: Mapping[str, tuple[int, ...]] = {}
    active: Callable[[Numbers, np.ndarray, np.ndarray], np.ndarray] | None = None
    simpler: tuple[str, ...] = ()
    channels: str = ""

    def neutral(self) -> dict[str, np.ndarray]:
        """Every number at the value at which the effect changes nothing."""
        return {name: np.full(self.shapes.get(name, ()), p.neutral, np.float64) for name, p in self.parameters.items()}


def add(physics: Physics, *effects: Effect, numbers: Mapping[str, Numbers] | None = None) -> Physics:
    """The physics with effects, in the order given; their numbers neutral where `numbers[effect.name]` says nothing.

    Raises `ValueError` for an effect that is already there, and for numbers that are not the effect's.
    """
    numbers = numbers or {}
    for effect in effects:
        if effect.name in physics.params:
            raise ValueError(f"effects: expected each effect once, found {effect.name!r} in physics {physics.name!r}")
        given = numbers.get(effect.name, {})
        for name in given:
            if name not in effect.parameters:
                raise ValueError(f"effects: {effect.name}: expected {sorted(effect.parameters)}, found {name!r}")
        values = {**effect.neutral(), **{name: np.asarray(v, np.float64) for name, v in given.items()}}
        for name, value in values.items():
            if value.shape != effect.shapes.get(name, ()):
                expected = effect.shapes.get(name, ())
                raise ValueError(f"effects: {effect.name}.{name}: expected shape {expected}, found {value.shape}")
        wrapped = effect.wrap(physics)
        physics = wrapped._replace(
            params={**physics.params, effect.name: values},
            parameters={**physics.parameters, effect.name: dict(effect.parameters)},
        )
    return physics


def on_input(physics: Physics, name: str, change: Map) -> Physics:
    """u ← change(numbers, u) before it reaches the physics."""

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return physics.step(p, x, change(p[name], u))

    def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return physics.measure(p, x, change(p[name], u))

    return physics._replace(step=step, measure=measure)


def on_output(physics: Physics, name: str, change: Map) -> Physics:
    """y ← change(numbers, y) after the measurement equation."""
    return physics._replace(measure=lambda p, x, u: change(p[name], physics.measure(p, x, u)))


def after_step(physics: Physics, change: After) -> Physics:
    """x_t ← change(params, x_{t-1}, u_t, x_t): an increment or a limit once the step is done."""

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return change(p, x, u, physics.step(p, x, u))

    return physics._replace(step=step)


def with_memory(
    physics: Physics,
    name: str,
    memory: Sequence[Signal],
    advance: Callable[[Any, jax.Array, jax.Array], tuple[jax.Array, jax.Array]],
) -> Physics:
    """`u', memory' = advance(numbers, memory, u)`: the physics sees u', and its state gains the memory at its end.

    The measurement sees the input as it came.
    """
    n = len(physics.states)

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        u, kept = advance(p[name], x[n:], u)
        return jnp.concatenate([physics.step(p, x[:n], u), kept])

    def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return physics.measure(p, x[:n], u)

    return physics._replace(step=step, measure=measure, states=(*physics.states, *memory))
