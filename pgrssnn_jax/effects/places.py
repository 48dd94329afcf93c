"""Where effects of any physics act: its velocities with their positions, and its states without a rate."""

from typing import Any, NamedTuple

import jax
import numpy as np

from pgrssnn_jax.effects.base import Needs, SignalRange
from pgrssnn_jax.physics.base import Physics, Signal, extension_of, measured_rate
from pgrssnn_jax.physics.integrate import DerivativePoints

VELOCITY, LEVEL = "velocity", "first-order state"  # what one number of an effect belongs to
_SPEEDS = frozenset(
    {"m/s", "mm/s", "cm/s", "km/h", "rad/s", "mrad/s", "deg/s", "°/s", "rev/s", "rpm", "1/min", "rev/min", "knots"}
)
_SAMPLES = 10  # a speed whose position is unknown takes its unit of length from the way in so many samples


class Place(NamedTuple):
    """state: index of the state that an effect acts on; position: kind (`x` state, `y` output) and index of the signal
    whose time derivative the state is, None for a speed without a position."""

    state: int
    position: tuple[str, int] | None

    @property
    def way(self) -> int | None:
        """Index of the position among the states."""
        return self.position[1] if self.position and self.position[0] == "x" else None


def velocities(physics: Physics) -> list[Place]:
    """A velocity is the rate of something that is no rate itself, or has the unit of a speed (of a motor, say, whose
    angle is no state)."""
    return [place for i in range(len(physics.states)) if (place := _velocity(physics, i))]


def levels(physics: Physics) -> list[Place]:
    """First-order states: no rates, no positions of velocities, no memory, nothing inner."""
    moving = {i for place in velocities(physics) for i in (place.state, place.way)}
    return [
        Place(i, ("x", i))
        for i, state in enumerate(physics.states)
        if state.rate_of is None and _of_the_system(state) and i not in moving
    ]


def _of_the_system(state: Signal) -> bool:
    """Is it a state of the system, and no memory of an effect or covariance of a filter?"""
    return state.memory_of is None and not state.inner


def _velocity(physics: Physics, i: int) -> Place | None:
    """The place of state i where it is a velocity: its position is the state of that name, or like that output."""
    state = physics.states[i]
    if state.rate_of is None:
        differentiated = any(other.rate_of in (state.name, state.like) for other in physics.states if other.rate_of)
        speed = state.unit in _SPEEDS and _of_the_system(state) and not differentiated
        return Place(i, None) if speed else None
    measured = measured_rate(physics, state)
    for j, other in enumerate(physics.states):
        if other.name == state.rate_of or (measured is not None and other.like == measured):
            return None if other.rate_of else Place(i, ("x", j))
    return Place(i, ("y", next(j for j, output in enumerate(physics.outputs) if output.name == measured)))


def states_of(physics: Physics) -> Needs:
    """The states that places are counted in, in samples of the same length."""
    names, dt = [state.name for state in physics.states if _of_the_system(state)], physics.dt
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


def largest(span: SignalRange, places: list[Place]) -> np.ndarray:
    """Largest absolute values of the states in the data; 1 for a state that is zero all the time."""
    return _largest(span, [("x", place.state) for place in places])


def largest_ways(span: SignalRange, places: list[Place], dt: float) -> np.ndarray:
    """Largest absolute values of the positions, or of the way of a speed without one in so many samples."""
    found = _largest(span, [place.position or ("x", place.state) for place in places])
    return found * np.array([1.0 if place.position else _SAMPLES * dt for place in places])


def _largest(span: SignalRange, signals: list[tuple[str, int]]) -> np.ndarray:
    found = np.array([np.abs(getattr(span, kind)[:, i]).max() for kind, i in signals])
    return np.where(found > 0.0, found, 1.0)


def unit_of(unit: str, physics: Physics, places: list[Place]) -> str:
    """A unit in those of velocity {v} and position {q}; empty where it depends on units that nobody said or that
    differ."""
    signals = {"x": physics.states, "y": physics.outputs}

    def way(place: Place) -> str:
        v = physics.states[place.state].unit
        if place.position is None:
            return v.removesuffix("/s") if v.endswith("/s") else ""
        return signals[place.position[0]][place.position[1]].unit

    units = {(physics.states[place.state].unit, way(place)) for place in places}
    v, q = units.pop() if len(units) == 1 else ("", "")
    if ("{v}" in unit and not v) or ("{q}" in unit and not q):
        return ""
    return unit.format(v=v, q=q).replace("/s/s", "/s^2")
