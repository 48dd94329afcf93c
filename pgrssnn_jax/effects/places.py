"""Where effects of any physics act: its velocities with their positions, and its states without a rate."""

from typing import Any, NamedTuple

import jax
import numpy as np

from pgrssnn_jax.effects.base import Needs, SignalRange
from pgrssnn_jax.physics.base import Physics, extension_of, measured_rate
from pgrssnn_jax.physics.integrate import DerivativePoints

VELOCITY, LEVEL = "velocity", "first-order state"  # what one number of an effect belongs to


class Place(NamedTuple):
    """state: index of the one that an effect acts on; position: kind (`x`, `y`) and index of what it is the rate of."""

    state: int
    position: tuple[str, int]

    @property
    def way(self) -> int | None:
        """Index of the position among the states."""
        return self.position[1] if self.position[0] == "x" else None


def velocities(physics: Physics) -> list[Place]:
    """A velocity is the rate of something that is no rate itself."""
    return [place for i in range(len(physics.states)) if (place := _velocity(physics, i))]


def levels(physics: Physics) -> list[Place]:
    """First-order states: no rates, no positions of velocities, no memory, nothing inner."""
    moving = {place.way for place in velocities(physics)}
    return [
        Place(i, ("x", i))
        for i, state in enumerate(physics.states)
        if state.rate_of is None and state.memory_of is None and not state.inner and i not in moving
    ]


def _velocity(physics: Physics, i: int) -> Place | None:
    """The place of state i where it is a velocity: its position is the state of that name, or like that output."""
    state = physics.states[i]
    if state.rate_of is None:
        return None
    measured = measured_rate(physics, state)
    for j, other in enumerate(physics.states):
        if other.name == state.rate_of or (measured is not None and other.like == measured):
            return None if other.rate_of else Place(i, ("x", j))
    return Place(i, ("y", next(j for j, output in enumerate(physics.outputs) if output.name == measured)))


def states_of(physics: Physics) -> Needs:
    """The states that places are counted in, in samples of the same length."""
    own = [state for state in physics.states if state.memory_of is None and not state.inner]
    names, dt = [state.name for state in own], physics.dt
    return Needs(
        f"the states {', '.join(names)} and dt={dt:g} s",
        lambda other: [state.name for state in other.states[: len(names)]] == names and other.dt == dt,
    )


def acted_on(physics: Physics, places: list[Place], channels: str) -> str:
    """For the end of an equation."""
    names = ", ".join(physics.states[place.state].name for place in places)
    return f"   ({'v' if channels == VELOCITY else 'x'}: {names})"


def points_of(physics: Physics) -> DerivativePoints | None:
    """The extension points of a physics with a derivative; None for one that has only steps."""
    known = extension_of(physics)
    return known.points if known and isinstance(known.points, DerivativePoints) else None


def with_each(x: jax.Array, indices: list[int], values: Any) -> jax.Array:
    """x with other values at some places, one by one: `acceleration/scalars.py` knows no arrays of indices."""
    for i, value in zip(indices, values, strict=True):
        x = x.at[i].set(value)
    return x


def largest(span: SignalRange, signals: list[tuple[str, int]]) -> np.ndarray:
    """Largest absolute values in the data; 1 for a signal that is zero all the time."""
    found = np.array([np.abs(getattr(span, kind)[:, i]).max() for kind, i in signals])
    return np.where(found > 0.0, found, 1.0)


def unit_of(unit: str, physics: Physics, places: list[Place]) -> str:
    """A unit in those of velocity {v} and position {q}; empty where it depends on units that nobody said or that
    differ."""
    signals = {"x": physics.states, "y": physics.outputs}
    units = {(physics.states[i].unit, signals[kind][j].unit) for i, (kind, j) in places}
    v, q = units.pop() if len(units) == 1 else ("", "")
    if ("{v}" in unit and not v) or ("{q}" in unit and not q):
        return ""
    return unit.format(v=v, q=q).replace("/s/s", "/s^2")
