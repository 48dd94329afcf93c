"""Dry friction of any velocity v, the rate of a position q, which may be no state.

    coulomb_friction    dv/dt = F - a sign(v)                               v = 0:  dv/dt = 0 where |F| < a
    stribeck_friction   dv/dt = F - (a + d exp(-(v / v_s)²)) sign(v)        v = 0:  dv/dt = 0 where |F| < a + d

F: what all else makes of dv/dt. Over one step of h seconds (of the physics' integrator, or a sample where it has only
steps) friction has the direction s of the speed at its beginning, and of F from standstill; while it holds a body, the
body rests. So a step is as smooth as the physics, and the integrator as accurate. A speed that has changed its sign at
the end, v1', came to rest on the way, at τ = h v0 / (v0 - v1'). From there, with F = v1' / (h - τ) + s b held and b the
friction at rest,

    v1 = 0 where |F| < b,    else v1 = (F + s b) (h - τ) = v1' + 2 s b (h - τ),

and all states have gained what v1 - v1', grown since τ, made of them: the difference of dx/dt at a speed that differs
by (v1 - v1') (h - τ) / 2. Where the physics has only steps, q alone gains it.
Source of the bump: Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994), 7.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, around_point
from pgrssnn_jax.effects.places import VELOCITY, Place, acted_on, largest, largest_ways, points_of, states_of, unit_of
from pgrssnn_jax.physics.base import Parameter, Physics

_POSITIVE = (0.0, float("inf"))
_SHARES = (0.03, 0.3)  # of the largest v² / q in the data
Brake = Callable[[jax.Array], jax.Array]


class Dry(NamedTuple):
    """brake(n)(v): size of the deceleration at a speed, from the numbers of this velocity."""

    name: str
    title: str
    equation: str
    cause: str
    parameters: dict[str, Parameter]
    brake: Callable[[Any], Brake]
    simpler: tuple[str, ...] = ()


_SIZE = Parameter("a", "{v}/s", bounds=_POSITIVE, neutral=0.0)
_COULOMB = Dry(
    "coulomb_friction",
    "Coulomb friction",
    "dv/dt = ... - a sign(v)",
    "dry friction brakes the motion at any speed",
    {"a": _SIZE},
    lambda n: lambda v: n["a"],
)


def _bump(n: Any) -> Brake:
    some = n["v_s"] > 0.0
    slow, d = 1.0 / jnp.where(some, n["v_s"], 1.0), jnp.where(some, n["d"], 0.0)
    slow = -(slow**2)  # v_s² would be infinite times a derivative of zero where v_s is infinite
    return lambda v: n["a"] + d * jnp.exp(slow * v**2)


_STRIBECK = Dry(
    "stribeck_friction",
    "Stribeck friction",
    "dv/dt = ... - (a + d exp(-(v / v_s)²)) sign(v)",
    "dry friction is larger at low speed than at high speed: the body sticks, then slips",
    {
        "a": _SIZE,
        "d": _SIZE._replace(symbol="d"),
        "v_s": Parameter("v_s", "{v}", bounds=_POSITIVE, neutral=float("inf")),
    },
    _bump,
    simpler=("coulomb_friction",),
)


def friction_effects(physics: Physics, places: list[Place]) -> tuple[Effect, ...]:
    def scale(span: SignalRange) -> np.ndarray:
        return largest(span, places) ** 2 / largest_ways(span, places, physics.dt)

    def coulomb(span: SignalRange) -> list[Numbers]:
        return [{"a": share * scale(span)} for share in _SHARES]

    def stribeck(span: SignalRange) -> list[Numbers]:
        a, fastest = _SHARES[0] * scale(span), largest(span, places)
        return [{"a": a, "d": a, "v_s": share * fastest} for share in (0.03, 0.1, 0.3)]

    return _effect(physics, _COULOMB, places, coulomb), _effect(physics, _STRIBECK, places, stribeck)


def _effect(
    physics: Physics, dry: Dry, places: list[Place], initial_guesses: Callable[[SignalRange], list[Numbers]]
) -> Effect:
    def brakes(n: Any) -> list[tuple[Place, Brake]]:
        return [(place, dry.brake({key: value[k] for key, value in n.items()})) for k, place in enumerate(places)]

    def wrap(inner: Physics) -> Physics:
        points = points_of(inner)
        if points is None:
            return _around_steps(inner, dry.name, brakes)
        return around_point(inner, "advance", dry.name, _inside(brakes, points.h))

    return Effect(
        dry.name,
        {key: meaning._replace(unit=unit_of(meaning.unit, physics, places)) for key, meaning in dry.parameters.items()},
        wrap,
        title=dry.title,
        equation=dry.equation + acted_on(physics, places, VELOCITY),
        cause=dry.cause,
        shapes=dict.fromkeys(dry.parameters, (len(places),)),
        initial_guesses=initial_guesses,
        needs=states_of(physics),
        simpler=dry.simpler,
        channels=VELOCITY,
        elaborate=bool(dry.simpler),
    )


def _inside(brakes: Callable[[Any], list[tuple[Place, Brake]]], h: float) -> Callable[..., jax.Array]:
    """Around the integrator of a derivative."""

    def advance(n: Any, own: Any, inner: Callable[..., jax.Array], field: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        slope, begun = field(x), []
        for place, brake in brakes(n):
            v, force = x[place.state], slope[place.state]
            rests = (v == 0.0) & (jnp.abs(force) < brake(jnp.zeros_like(v)))
            s = jnp.where(rests, 0.0, jnp.sign(jnp.where(v == 0.0, force, v)))
            begun.append((place.state, brake, rests, s, jnp.where(rests, 0.0, 1.0)))

        def braked(state: jax.Array) -> jax.Array:
            found = slope if state is x else field(state)
            for i, brake, _, s, moves in begun:
                found = found.at[i].set(moves * found[i] - s * brake(state[i]))
            return found

        first = braked(x)  # not once more inside the integrator
        new, late, ends = inner(lambda state: first if state is x else braked(state), x, u), x, []
        for i, brake, rests, s, _ in begun:
            left, more = _turned(x[i], new[i], s, brake, h)
            new, late = new.at[i].add(more), late.at[i].add(0.5 * left * more)
            ends.append((i, rests | ((more != 0.0) & (new[i] == 0.0))))
        new = new + (field(late) - slope)  # what the changes of speed, in the mean half as long ago, have moved
        for i, stands in ends:
            new = new.at[i].set(jnp.where(stands, 0.0, new[i]))
        return new

    return advance


def _around_steps(inner: Physics, name: str, brakes: Callable[[Any], list[tuple[Place, Brake]]]) -> Physics:
    """Half of the friction before the step and half after it; from standstill all of it after the step."""
    h = inner.dt

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        known, moved = brakes(p.effects[name]), x
        for place, brake in known:
            v = x[place.state]
            moved = moved.at[place.state].add(-0.5 * h * jnp.sign(v) * brake(v))
        new = inner.step(p, moved, u)
        for place, brake in known:
            new = _braked_after(new, x, place, brake, h)
        return new

    return inner._replace(step=step)


def _braked_after(new: jax.Array, x: jax.Array, place: Place, brake: Brake, h: float) -> jax.Array:
    i, v0, v1, rest = place.state, x[place.state], new[place.state], brake(jnp.zeros_like(x[0]))
    starts = v0 == 0.0
    rests = starts & (jnp.abs(v1) < h * rest)
    s = jnp.sign(jnp.where(starts, v1, v0))
    kick = jnp.where(rests, s * jnp.abs(v1), h * s * jnp.where(starts, rest, 0.5 * brake(v1)))
    left, more = _turned(v0, v1 - kick, s, brake, h)
    if place.way is not None:
        q = new[place.way] + 0.5 * left * more - jnp.where(starts, 0.5 * h * kick, 0.0)
        new = new.at[place.way].set(jnp.where(rests, x[place.way], q))
    return new.at[i].set(v1 - kick + more)


def _turned(v0: jax.Array, v1: jax.Array, s: jax.Array, brake: Brake, h: float) -> tuple[jax.Array, jax.Array]:
    """Where the speed has changed its sign: h - τ, and by what v1 comes to rest or goes on in the other direction."""
    turned = s * v1 < 0.0
    left = jnp.where(turned, h * v1 / jnp.where(turned, v1 - v0, 1.0), 0.0)  # no 0/0 in the gradient
    rests = jnp.abs(v1) < 2.0 * brake(jnp.zeros_like(v1)) * left  # |F| < b, with F = v1 / left + s b
    return left, jnp.where(turned, jnp.where(rests, -v1, 2.0 * brake(0.5 * v1) * left * s), 0.0)
