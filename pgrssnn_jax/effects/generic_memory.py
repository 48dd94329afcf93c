"""Effects with a memory that any physics may lack: play at an input, and a spring that yields.

    backlash      z_t = min(max(z_{t-1}, u - b), u + b),  u' = z                  (the play is 2 b wide)
    hysteresis    dv/dt = ... - k z,   dz/dt = v where v z < 0, else v (1 - |z| / s),    v = dq/dt

z does not depend on how fast q moves, and follows from where it was and how far q has gone since: inside the derivative
of the physics it is exact but for a turn on the way; of a physics that has only steps half of the force acts before a
step and half after it (errors of second order in dt). As s grows the spring is linear, as it vanishes with k s kept it
is Coulomb friction. One number per input or velocity, in units of the signals and s.
Sources: Bouc, Forced vibration of mechanical systems with hysteresis, 1967; Wen, J. Eng. Mech. Div. 102 (1976), n = 1
and both shape factors 1 / (2 s).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, at_point
from pgrssnn_jax.effects.memory import memory_signals, remembered_inputs, with_memory
from pgrssnn_jax.effects.places import VELOCITY, Place, acted_on, largest, largest_ways, points_of, states_of, unit_of
from pgrssnn_jax.physics.base import Measure, Parameter, Physics, Signal, Step, extended, extension_of
from pgrssnn_jax.physics.signals import unit_of_all

_POSITIVE = (0.0, float("inf"))
_FAR = 1e15  # of a spring that never yields, in any unit of a position
_PLAYS = (0.05, 0.15, 0.3)  # of half the range of the input
_STIFF, _YIELD = (0.1, 0.5), (0.05, 0.2)  # of the largest (v / q)² and q


def backlash(physics: Physics) -> Effect:
    def advance(n: Any, past: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        # At an end of the play z follows u: without play, of an input that is held, past is u, and minimum and maximum
        # would split the derivative between the two.
        low, high = u - n["half_width"], u + n["half_width"]
        z = jnp.where(past <= low, low, jnp.where(past >= high, high, past))
        return z, z

    memory = [one._replace(fit_initial=True) for one in memory_signals(physics, "behind_play", 1)]
    return Effect(
        "backlash",
        {"half_width": Parameter("b", unit_of_all(physics.inputs), bounds=_POSITIVE, neutral=0.0)},
        lambda inner: with_memory(inner, "backlash", memory, advance),
        title="Backlash of the input",
        equation="u' = z,  z = min(max(z', u - b), u + b)",
        cause="a gear, a valve or a linkage has play: after a change of direction the input first crosses it",
        acts_on="input",
        shapes={"half_width": (len(physics.inputs),)},
        initial_guesses=lambda span: [{"half_width": 0.5 * share * np.ptp(span.u, axis=0)} for share in _PLAYS],
        needs=remembered_inputs(physics),
        simpler=("input_offset", "input_delay"),  # of an input that moves in one direction, or to and fro
        channels="input",
        elaborate=True,
    )


def hysteresis(physics: Physics, places: list[Place]) -> Effect:
    """places: velocities whose positions are states."""
    name, ways = "hysteresis", [place.way or 0 for place in places]
    memory = tuple(
        Signal(
            f"{physics.states[place.state].name}_yielding",
            physics.states[j].unit,
            memory_of=physics.states[place.state].name,
            fit_initial=True,
        )
        for place, j in zip(places, ways, strict=True)
    )

    def begun(n: Any, z: jax.Array, x: jax.Array) -> list[Spring]:
        """At the beginning of a sample."""
        return [
            _begun(z[k], x[place.state], x[j], n["s"][k]) for k, (place, j) in enumerate(zip(places, ways, strict=True))
        ]

    def pulled(n: Any, own: Any, slope: jax.Array, x: jax.Array, u: jax.Array) -> jax.Array:
        for k, (place, j) in enumerate(zip(places, ways, strict=True)):
            slope = slope.at[place.state].add(-n["k"][k] * _yielding(n["begun"][k], x[j]))
        return slope

    def kicked(n: Any, x: jax.Array, z: Any, h: float) -> jax.Array:
        for k, place in enumerate(places):
            x = x.at[place.state].add(-h * n["k"][k] * z[k])
        return x

    def around(step: Step, measure: Measure, count: int, half: float | None) -> tuple[Step, Measure]:
        """count: of states before the memory; half: seconds of a kick, None where the derivative is pulled."""

        def longer(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            n, z = p.effects[name], x[count : count + len(ways)]
            known = begun(n, z, x)
            if half is None:
                new = step(p._replace(effects={**p.effects, name: {**n, "begun": known}}), x[:count], u)
            else:
                new = step(p, kicked(n, x[:count], z, half), u)
            after = [_yielding(spring, new[j]) for spring, j in zip(known, ways, strict=True)]
            return jnp.concatenate([new if half is None else kicked(n, new, after, half), jnp.stack(after)])

        return longer, lambda p, x, u: measure(p, x[:count], u)

    def wrap(inner: Physics) -> Physics:
        count, states = len(inner.states), (*inner.states, *memory)
        if points_of(inner) is None:
            step, measure = around(inner.step, inner.measure, count, 0.5 * inner.dt)
            return inner._replace(step=step, measure=measure, states=states)
        known = extension_of(at_point(inner, "derivative", name, pulled))
        assert known is not None
        return extended(
            inner._replace(states=states), known.points, lambda points: around(*known.assemble(points), count, None)
        )

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        v, q = largest(span, places), largest_ways(span, places, physics.dt)
        return [{"k": k * (v / q) ** 2, "s": s * q} for k in _STIFF for s in _YIELD]

    def yields(n: Numbers, span: SignalRange) -> bool:
        """Over more than the whole way of its position a spring is linear, and with a large z at the start a constant
        force."""
        return bool(np.any(n["s"] < np.ptp(span.x[:, ways], axis=0)))

    return Effect(
        name,
        {
            "k": Parameter("k", "1/s^2", bounds=_POSITIVE, neutral=0.0),
            "s": Parameter("s", unit_of("{q}", physics, places), bounds=_POSITIVE, neutral=float("inf")),
        },
        wrap,
        title="Hysteresis of a spring",
        equation="dv/dt = ... - k z,  dz/dt = v (1 - |z| / s) where v z > 0, else v"
        + acted_on(physics, places, VELOCITY),
        cause="a spring, a mount or a joint yields: its force depends on the way that it came",
        shapes={"k": (len(ways),), "s": (len(ways),)},
        initial_guesses=initial_guesses,
        needs=states_of(physics),
        simpler=("linear_spring", "coulomb_friction"),
        channels=VELOCITY,
        elaborate=True,
        credible=yields,
    )


class Spring(NamedTuple):
    """At the beginning of a sample: direction ±1 of the motion, position, s and what z is in that direction, split into
    what it has to lose (elastic ≤ 0) and what it has won (loaded ≥ 0)."""

    direction: jax.Array
    position: jax.Array
    s: jax.Array
    elastic: jax.Array
    loaded: jax.Array


def _begun(z: jax.Array, v: jax.Array, q: jax.Array, s: Any) -> Spring:
    direction = jnp.where(v < 0.0, -1.0, 1.0)
    ahead = direction * z
    return Spring(direction, q, jnp.clip(s, 1.0 / _FAR, _FAR), jnp.minimum(ahead, 0.0), jnp.maximum(ahead, 0.0))


def _yielding(spring: Spring, q: jax.Array) -> jax.Array:
    """z at a position on the way: without loss down to zero, from there s - (s - z) exp(-way / s)."""
    way = spring.direction * (q - spring.position) + spring.elastic
    yields = jnp.expm1(jnp.maximum(way, 0.0) / -spring.s) * (spring.loaded - spring.s)
    return spring.direction * (jnp.minimum(way, 0.0) + spring.loaded + yields)
