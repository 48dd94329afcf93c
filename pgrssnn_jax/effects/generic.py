"""Effects that any physics may lack, known by its states alone: forces on velocities, flows of first-order states.

    velocity v, the rate of a position q                   first-order state x
    viscous_friction   dv/dt = ... - c v                   leak        dx/dt = ... - r x
    coulomb_friction   dv/dt = ... - a sign(v)             inflow      dx/dt = ... + f
    quadratic_drag     dv/dt = ... - c |v| v               power_law   dx/dt = ... - c |x|^n sign(x)
    linear_spring      dv/dt = ... - k q
    cubic_spring       dv/dt = ... - k q³
    constant_force     dv/dt = ... + a

One number per velocity or first-order state, in the units of the states and s. Half of an effect acts before the step
of the physics and half after it (errors of second order in dt), each as the exact solution of its own equation over
dt / 2: friction stops a motion and never turns it around, whatever the sample time and without a smoothed sign. Fits
begin at shares of what the ranges of the signals make of each unit, so that no unit changes an answer.
Source: Strang, On the construction and comparison of difference schemes, SIAM J. Numer. Anal. 5 (1968).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Needs, Numbers, SignalRange
from pgrssnn_jax.physics.base import Parameter, Physics, measured_rate

_POSITIVE = (0.0, float("inf"))
Flow = Callable[[Any, float, jax.Array, jax.Array], jax.Array]


class Law(NamedTuple):
    """flow(n, h, v, q): v after h seconds of this effect alone, from its numbers. meaning: of its number, whose name
    is the symbol; {v} and {q} in the unit are those of velocity and position. scale: powers of the largest |v| and |q|
    in the data that make this unit; shares: of that scale, where fits begin."""

    name: str
    title: str
    equation: str
    cause: str
    meaning: Parameter
    scale: tuple[int, int]
    shares: tuple[float, ...]
    flow: Flow


_LOSS, _EITHER_SIGN = (0.03, 0.3), (0.1, -0.1)
_FORCES = (
    Law(
        "viscous_friction",
        "Viscous friction",
        "dv/dt = ... - c v",
        "lubricant or air brakes the motion in proportion to its speed, beyond what is known",
        Parameter("c", "1/s", bounds=_POSITIVE, neutral=0.0),
        (1, -1),
        _LOSS,
        lambda n, h, v, q: v * jnp.exp(-h * n["c"]),
    ),
    Law(
        "coulomb_friction",
        "Coulomb friction",
        "dv/dt = ... - a sign(v)",
        "dry friction brakes the motion at any speed",
        Parameter("a", "{v}/s", bounds=_POSITIVE, neutral=0.0),
        (2, -1),
        _LOSS,
        lambda n, h, v, q: v - jnp.clip(v, -h * n["a"], h * n["a"]),
    ),
    Law(
        "quadratic_drag",
        "Quadratic drag",
        "dv/dt = ... - c |v| v",
        "a fluid around the body brakes it with the square of its speed",
        Parameter("c", "1/{q}", bounds=_POSITIVE, neutral=0.0),
        (0, -1),
        _LOSS,
        lambda n, h, v, q: v / (1.0 + h * n["c"] * jnp.abs(v)),
    ),
    Law(
        "linear_spring",
        "Spring",
        "dv/dt = ... - k q",
        "a spring pulls the body to the zero of its position",
        Parameter("k", "1/s^2", bounds=_POSITIVE, neutral=0.0),
        (2, -2),
        _LOSS,
        lambda n, h, v, q: v - h * n["k"] * q,
    ),
    Law(
        "cubic_spring",
        "Spring that hardens or softens",
        "dv/dt = ... - k q³",
        "a spring is not linear: its force grows faster than the way (k > 0) or more slowly (k < 0)",
        Parameter("k", "1/(s^2 {q}^2)", neutral=0.0),
        (2, -4),
        _EITHER_SIGN,
        lambda n, h, v, q: v - h * n["k"] * q**3,
    ),
    Law(
        "constant_force",
        "Constant force",
        "dv/dt = ... + a",
        "a weight, a tilted base or a preload pulls with the same force all the time",
        Parameter("a", "{v}/s", neutral=0.0),
        (2, -1),
        _EITHER_SIGN,
        lambda n, h, v, q: v + h * n["a"],
    ),
)


def _powers(n: Any, h: float, x: jax.Array, _: jax.Array) -> jax.Array:
    """|x| (1 + m z)^(-1/m) with m = n - 1 and z = h c |x|^m; empty once the bracket is 0; exp(-z) at m = 0."""
    some = x != 0.0
    m, size = n["n"] - 1.0, jnp.where(some, jnp.abs(x), 1.0)  # no power of zero in the gradient
    z = h * n["c"] * size**m
    bracket = jnp.maximum(m * z, 1e-6 - 1.0)
    small = jnp.abs(bracket) < 1e-3
    ratio = jnp.log1p(jnp.where(small, 1.0, bracket)) / jnp.where(small, 1.0, bracket)
    ratio = jnp.where(small, 1.0 - bracket / 2.0 + bracket**2 / 3.0, ratio)  # log(1 + b) / b
    return jnp.where(some, x * jnp.exp(-z * ratio), x)


_FLOWS = (
    Law(
        "leak",
        "Leak",
        "dx/dt = ... - r x",
        "something is lost in proportion to what is there: a leak, a heat loss, a discharge",
        Parameter("r", "1/s", bounds=_POSITIVE, neutral=0.0),
        (0, 0),
        (0.003, 0.03),
        lambda n, h, x, _: x * jnp.exp(-h * n["r"]),
    ),
    Law(
        "inflow",
        "Constant inflow",
        "dx/dt = ... + f",
        "something comes in (f > 0) or is taken (f < 0) all the time",
        Parameter("f", "{v}/s", neutral=0.0),
        (1, 0),
        (0.01, -0.01),
        lambda n, h, x, _: x + h * n["f"],
    ),
)
_POWER_LAW = Law(
    "power_law",
    "Loss by a power law",
    "dx/dt = ... - c |x|^n sign(x)",
    "something is lost by a law that is not proportional: an orifice (n = 1/2), radiation (n = 4)",
    Parameter("c", "", bounds=_POSITIVE, neutral=0.0),
    (1, 0),
    (0.01,),
    _powers,
)


_AS_AN_OFFSET = ("constant_force", "inflow")  # where an input acts on this state alone, they are one


class Place(NamedTuple):
    """state: index of the one that an effect acts on; position: kind (`x`, `y`) and index of what it is the rate of."""

    state: int
    position: tuple[str, int]


def generic_effects(physics: Physics) -> tuple[Effect, ...]:
    """The effects of this file for the states of a physics: forces where it has velocities, flows where it has states
    without a rate. A velocity is the rate of something that is no rate itself."""
    velocities = [place for i in range(len(physics.states)) if (place := _velocity(physics, i))]
    springs = [place for place in velocities if place.position[0] == "x"]
    moving = {place.position[1] for place in springs}
    levels = [
        Place(i, ("x", i))
        for i, state in enumerate(physics.states)
        if state.rate_of is None and state.memory_of is None and i not in moving
    ]
    forces = [(law, springs if law.name.endswith("spring") else velocities) for law in _FORCES]
    found = [_effect(physics, law, places, "velocity") for law, places in forces if places]
    if levels:
        found += [_effect(physics, law, levels, "first-order state") for law in _FLOWS]
        found.append(_power_law(physics, levels))
    return tuple(found)


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


def _effect(physics: Physics, law: Law, places: list[Place], channels: str) -> Effect:
    at = [place.state for place in places]
    positions = [j if kind == "x" else i for i, (kind, j) in places]  # no state: a law that needs none
    names, dt = [state.name for state in physics.states if state.memory_of is None], physics.dt
    acted = ", ".join(names[i] for i in at)

    def half(n: Any, x: jax.Array) -> jax.Array:
        v, q = (jnp.stack([x[i] for i in indices]) for indices in (at, positions))
        for i, one in zip(at, law.flow(n, 0.5 * dt, v, q), strict=True):  # `scalars.py` knows no arrays of indices
            x = x.at[i].set(one)
        return x

    def wrap(inner: Physics) -> Physics:
        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            n = p.effects[law.name]
            return half(n, inner.step(p, half(n, x), u))

        return inner._replace(step=step)

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        v, q = _largest(span, [("x", place.state) for place in places]), _largest(span, [p.position for p in places])
        scale = v ** law.scale[0] * q ** law.scale[1] / (1.0 if channels == "velocity" else dt)
        return [{law.meaning.symbol: share * scale} for share in law.shares]

    return Effect(
        law.name,
        {law.meaning.symbol: law.meaning._replace(unit=_unit(law.meaning.unit, physics, places))},
        wrap,
        title=law.title,
        equation=f"{law.equation}   ({'v' if channels == 'velocity' else 'x'}: {acted})",
        cause=law.cause,
        shapes={law.meaning.symbol: (len(at),)},
        initial_guesses=initial_guesses,
        needs=Needs(
            f"the states {', '.join(names)} and dt={dt:g} s",
            lambda other: [state.name for state in other.states[: len(names)]] == names and other.dt == dt,
        ),
        simpler=("input_offset",) if law.name in _AS_AN_OFFSET else (),
        channels=channels,
    )


def _power_law(physics: Physics, places: list[Place]) -> Effect:
    """Its coefficient has the unit of x to the power 1 - n, per second."""
    effect = _effect(physics, _POWER_LAW, places, "first-order state")

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        x, share = _largest(span, [place.position for place in places]), _POWER_LAW.shares[0] / physics.dt
        return [{"c": share * x ** (1.0 - n), "n": np.full(len(places), n)} for n in (0.5, 2.0)]

    return effect._replace(
        parameters={**effect.parameters, "n": Parameter("n", bounds=(0.2, 5.0), neutral=1.0)},
        shapes={**effect.shapes, "n": (len(places),)},
        initial_guesses=initial_guesses,
        simpler=("leak",),
    )


def _largest(span: SignalRange, signals: list[tuple[str, int]]) -> np.ndarray:
    """Largest absolute values in the data; 1 for a signal that is zero all the time."""
    found = np.array([np.abs(getattr(span, kind)[:, i]).max() for kind, i in signals])
    return np.where(found > 0.0, found, 1.0)


def _unit(unit: str, physics: Physics, places: list[Place]) -> str:
    """Empty where it depends on units that nobody said or that differ."""
    signals = {"x": physics.states, "y": physics.outputs}
    units = {(physics.states[i].unit, signals[kind][j].unit) for i, (kind, j) in places}
    v, q = units.pop() if len(units) == 1 else ("", "")
    if ("{v}" in unit and not v) or ("{q}" in unit and not q):
        return ""
    return unit.format(v=v, q=q).replace("/s/s", "/s^2")
