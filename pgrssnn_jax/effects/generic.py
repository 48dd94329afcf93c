"""Effects that any physics may lack, known by its states alone: forces on velocities, flows of first-order states.

    velocity v, the rate of a position q                   first-order state x
    viscous_friction   dv/dt = ... - c v                   leak        dx/dt = ... - r x
    quadratic_drag     dv/dt = ... - c |v| v               inflow      dx/dt = ... + f
    linear_spring      dv/dt = ... - k q                   power_law   dx/dt = ... - c |x|^n sign(x)
    cubic_spring       dv/dt = ... - k q³
    constant_force     dv/dt = ... + a

One number per velocity or first-order state, in the units of the states and s. Where the physics has a derivative, an
effect is a term of it, and the physics' own integrator integrates both. Where it has only steps, half of an effect acts
before the step and half after it (errors of second order in dt), each as the exact solution of its own equation over
dt / 2. Fits begin at shares of what the ranges of the signals make of each unit, so that no unit changes an answer.
Dry friction, limits and memories stand in files of their own.
Source: Strang, On the construction and comparison of difference schemes, SIAM J. Numer. Anal. 5 (1968).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, at_point
from pgrssnn_jax.effects.generic_friction import friction_effects
from pgrssnn_jax.effects.generic_limits import ceiling, floor, hard_stop
from pgrssnn_jax.effects.generic_memory import backlash, hysteresis
from pgrssnn_jax.effects.places import (
    LEVEL,
    VELOCITY,
    Place,
    acted_on,
    largest,
    largest_ways,
    levels,
    points_of,
    states_of,
    unit_of,
    velocities,
    with_each,
)
from pgrssnn_jax.physics.base import Parameter, Physics

_POSITIVE = (0.0, float("inf"))
Flow = Callable[[Any, float, jax.Array, jax.Array], jax.Array]


class Law(NamedTuple):
    """From the numbers n, rate(n, h, v, q): what it adds to dv/dt in steps of h seconds; flow(n, h, v, q): v
    after h seconds of it alone. meaning: of its number, whose name is the symbol; {v} and {q} in the unit are those of
    velocity and position. scale: powers of the largest |v| and |q| in the data that make this unit; shares: of that
    scale, where fits begin."""

    name: str
    title: str
    equation: str
    cause: str
    meaning: Parameter
    scale: tuple[int, int]
    shares: tuple[float, ...]
    rate: Flow
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
        lambda n, h, v, q: -n["c"] * v,
        lambda n, h, v, q: v * jnp.exp(-h * n["c"]),
    ),
    Law(
        "quadratic_drag",
        "Quadratic drag",
        "dv/dt = ... - c |v| v",
        "a fluid around the body brakes it with the square of its speed",
        Parameter("c", "1/{q}", bounds=_POSITIVE, neutral=0.0),
        (0, -1),
        _LOSS,
        lambda n, h, v, q: -n["c"] * jnp.abs(v) * v,
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
        lambda n, h, v, q: -n["k"] * q,
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
        lambda n, h, v, q: -n["k"] * q**3,
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
        lambda n, h, v, q: n["a"],
        lambda n, h, v, q: v + h * n["a"],
    ),
)


def _powers(n: Any, h: float, x: jax.Array, _: jax.Array) -> jax.Array:
    """|x| (1 + m z)^(-1/m) with m = n - 1 and z = h c |x|^m; empty once the bracket is 0; exp(-z) at m = 0."""
    m = n["n"] - 1.0
    z = h * n["c"] * _size(x) ** m
    bracket = jnp.maximum(m * z, 1e-6 - 1.0)
    small = jnp.abs(bracket) < 1e-3
    ratio = jnp.log1p(jnp.where(small, 1.0, bracket)) / jnp.where(small, 1.0, bracket)
    ratio = jnp.where(small, 1.0 - bracket / 2.0 + bracket**2 / 3.0, ratio)  # log(1 + b) / b
    return x * jnp.exp(-z * ratio)


def _lost(n: Any, h: float, x: jax.Array, _: jax.Array) -> jax.Array:
    """-c |x|^n sign(x), in one step at most what there is: with n < 1 the slope at zero would be infinite."""
    return -jnp.minimum(n["c"] * _size(x) ** (n["n"] - 1.0), 1.0 / h) * x


def _size(x: jax.Array) -> jax.Array:
    """|x|, but no power of zero in the gradient."""
    return jnp.maximum(jnp.abs(x), float(jnp.finfo(x.dtype).tiny) ** 0.25)


_FLOWS = (
    Law(
        "leak",
        "Leak",
        "dx/dt = ... - r x",
        "something is lost in proportion to what is there: a leak, a heat loss, a discharge",
        Parameter("r", "1/s", bounds=_POSITIVE, neutral=0.0),
        (0, 0),
        (0.003, 0.03),
        lambda n, h, x, _: -n["r"] * x,
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
        lambda n, h, x, _: n["f"],
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
    _lost,
    _powers,
)


_AS_AN_OFFSET = ("constant_force", "inflow")  # where an input acts on this state alone, they are one


def generic_effects(physics: Physics) -> tuple[Effect, ...]:
    """Forces where the physics has velocities, flows where it has states without a rate; what limits them comes after
    them, what bends the input last."""
    moving, still = velocities(physics), levels(physics)
    springs = [place for place in moving if place.way is not None]
    laws = [(law, springs if law.name.endswith("spring") else moving) for law in _FORCES]
    forces = [_effect(physics, law, places, VELOCITY) for law, places in laws if places]
    forces[1:1] = friction_effects(physics, moving) if moving else ()  # beside the viscous one
    if springs:
        forces += [hysteresis(physics, springs), hard_stop(physics, springs)]
    flows = [_effect(physics, law, still, LEVEL) for law in _FLOWS] if still else []
    if still:
        flows += [_power_law(physics, still), ceiling(physics, still), floor(physics, still)]
    return (*forces, *flows, *([backlash(physics)] if physics.inputs and (forces or flows) else []))


def _effect(physics: Physics, law: Law, places: list[Place], channels: str) -> Effect:
    at, dt = [place.state for place in places], physics.dt
    positions = [place.state if place.way is None else place.way for place in places]  # a law that needs none

    def signals(x: jax.Array) -> list[jax.Array]:
        return [jnp.stack([x[i] for i in indices]) for indices in (at, positions)]

    def half(n: Any, x: jax.Array) -> jax.Array:
        return with_each(x, at, law.flow(n, 0.5 * dt, *signals(x)))

    def wrap(inner: Physics) -> Physics:
        points = points_of(inner)
        if points is not None:
            h = points.h

            def sloped(n: Any, own: Any, slope: jax.Array, x: jax.Array, u: jax.Array) -> jax.Array:
                for i, rate in zip(at, law.rate(n, h, *signals(x)), strict=True):
                    slope = slope.at[i].add(rate)
                return slope

            return at_point(inner, "derivative", law.name, sloped)

        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            n = p.effects[law.name]
            return half(n, inner.step(p, half(n, x), u))

        return inner._replace(step=step)

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        v, q = largest(span, places), largest_ways(span, places, dt)
        scale = v ** law.scale[0] * q ** law.scale[1] / (1.0 if channels == VELOCITY else dt)
        return [{law.meaning.symbol: share * scale} for share in law.shares]

    return Effect(
        law.name,
        {law.meaning.symbol: law.meaning._replace(unit=unit_of(law.meaning.unit, physics, places))},
        wrap,
        title=law.title,
        equation=law.equation + acted_on(physics, places, channels),
        cause=law.cause,
        shapes={law.meaning.symbol: (len(at),)},
        initial_guesses=initial_guesses,
        needs=states_of(physics),
        simpler=("input_offset",) if law.name in _AS_AN_OFFSET else (),
        channels=channels,
    )


def _power_law(physics: Physics, places: list[Place]) -> Effect:
    """Its coefficient has the unit of x to the power 1 - n, per second."""
    effect = _effect(physics, _POWER_LAW, places, LEVEL)

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        x, share = largest(span, places), _POWER_LAW.shares[0] / physics.dt
        powers = (0.5, 1.1, 2.0)  # the second: nearly a leak, which may be close to the truth
        return [{"c": share * x ** (1.0 - n), "n": np.full(len(places), n)} for n in powers]

    return effect._replace(
        parameters={**effect.parameters, "n": Parameter("n", bounds=(0.2, 5.0), neutral=1.0)},
        shapes={**effect.shapes, "n": (len(places),)},
        initial_guesses=initial_guesses,
        simpler=("leak",),
    )
