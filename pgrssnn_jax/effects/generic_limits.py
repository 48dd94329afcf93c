"""Limits of the states of any physics: stops of a position q, a rim or a bottom of a first-order state x.

    hard_stop    low ≤ q ≤ high, and a speed v = dq/dt towards the stop ends there
    ceiling      x ≤ L: what comes in beyond it is lost
    floor        x ≥ L: what is taken beyond it comes from elsewhere

One number per position or state, in its unit; none is where it is infinite. A limit acts after every step of the
physics' integrator, or once per sample where it has only steps. A body that reaches a stop on the way, at τ, and that
the mean acceleration F of the step pulls away again has v = F (h - τ) and q = stop + F (h - τ)² / 2 at its end. A
first-order state at its limit has its derivative there; where the physics has only steps, what it would do to others
beyond the limit within a sample is an error of first order in dt.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, after_step, around_point
from pgrssnn_jax.effects.places import LEVEL, VELOCITY, Place, acted_on, points_of, states_of, unit_of
from pgrssnn_jax.physics.base import Parameter, Physics

_INFINITE = float("inf")
_ABOVE, _BELOW = (0.65, 0.8, 0.93), (0.35, 0.2, 0.07)  # of the range in the data, where fits begin
_AT = 1e-9  # of a limit, within which a state is at it


def hard_stop(physics: Physics, places: list[Place]) -> Effect:
    """places: velocities whose positions are states."""
    name, ways = "hard_stop", [place.way or 0 for place in places]

    def stopped(n: Any, x: jax.Array, new: jax.Array, h: float) -> jax.Array:
        for k, place in enumerate(places):
            i, j = place.state, ways[k]
            stop = jnp.minimum(jnp.maximum(new[j], n["low"][k]), n["high"][k])
            side = jnp.sign(new[j] - stop)
            beyond, force = side != 0.0, side * (new[i] - x[i]) / h
            left = _left(side * (stop - x[j]), side * x[i], force, beyond, h)
            back = side * jnp.minimum(force * left, 0.0)
            new = new.at[i].set(jnp.where(beyond, back, new[i])).at[j].set(stop + 0.5 * back * left)
        return new

    def wrap(inner: Physics) -> Physics:
        points = points_of(inner)
        if points is None:
            return after_step(inner, name, lambda n, own, x, u, new: stopped(n, x, new, inner.dt))
        h = points.h

        def advance(n: Any, own: Any, step: Any, field: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            return stopped(n, x, step(field, x, u), h)

        return around_point(inner, "advance", name, advance)

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        q, none = span.x[:, ways], np.full(len(ways), _INFINITE)
        above, below = [_share(q, share) for share in _ABOVE], [_share(q, share) for share in _BELOW]
        one_side = [{"low": -none, "high": one} for one in above] + [{"low": one, "high": none} for one in below]
        return [*one_side, *({"low": low, "high": high} for low, high in zip(below, above, strict=True))]

    def active(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.any(_at(x[:, ways], n["high"], 1.0) | _at(x[:, ways], n["low"], -1.0), axis=-1)

    return Effect(
        name,
        {
            "low": Parameter("q_low", unit_of("{q}", physics, places), neutral=-_INFINITE),
            "high": Parameter("q_high", unit_of("{q}", physics, places), neutral=_INFINITE),
        },
        wrap,
        title="Hard stop",
        equation="low ≤ q ≤ high, v = 0 at the stop" + acted_on(physics, places, VELOCITY),
        cause="the body runs against an end stop and stays there until something pulls it away",
        shapes={"low": (len(ways),), "high": (len(ways),)},
        initial_guesses=initial_guesses,
        needs=states_of(physics),
        active=active,
        channels=VELOCITY,
    )


def _left(gap: jax.Array, v: jax.Array, force: jax.Array, beyond: jax.Array, h: float) -> jax.Array:
    """h - τ, with v τ + F τ² / 2 = gap; all of h for a body that stood at its stop."""
    hits = beyond & (gap > 0.0) & (v**2 + 2.0 * force * gap > 0.0)
    below = jnp.where(hits, v + jnp.sqrt(jnp.where(hits, v**2 + 2.0 * force * gap, 1.0)), 0.0)
    reached = below > 0.0
    return jnp.maximum(h - jnp.where(reached, 2.0 * gap / jnp.where(reached, below, 1.0), 0.0), 0.0)


def ceiling(physics: Physics, places: list[Place]) -> Effect:
    return _limit(
        physics,
        places,
        "ceiling",
        1.0,
        title="Upper limit",
        equation="x ≤ L" + acted_on(physics, places, LEVEL),
        cause="a vessel overflows, a valve relieves, a store is full: what comes in beyond it is lost",
    )


def floor(physics: Physics, places: list[Place]) -> Effect:
    return _limit(
        physics,
        places,
        "floor",
        -1.0,
        title="Lower limit",
        equation="x ≥ L" + acted_on(physics, places, LEVEL),
        cause="nothing takes the state below its limit: a drain above the bottom, a thermostat",
    )


def _limit(physics: Physics, places: list[Place], name: str, side: float, **fields: Any) -> Effect:
    at, bound, limit = [place.state for place in places], side * _INFINITE, jnp.minimum if side > 0 else jnp.maximum

    def limited(n: Any, x: jax.Array) -> jax.Array:
        # Not x.at[i].min(level): its derivative asks whether x equals the result, and XLA may round these differently.
        for i, level in zip(at, n["level"], strict=True):
            x = x.at[i].set(limit(x[i], level))
        return x

    def advance(n: Any, own: Any, step: Any, field: Callable[..., Any], x: jax.Array, u: jax.Array) -> jax.Array:
        return limited(n, step(lambda state: field(limited(n, state)), x, u))

    def wrap(inner: Physics) -> Physics:
        if points_of(inner) is None:
            return after_step(inner, name, lambda n, own, x, u, new: limited(n, new))
        return around_point(inner, "advance", name, advance)

    shares = _ABOVE if side > 0 else _BELOW
    return Effect(
        name,
        {"level": Parameter("L", unit_of("{v}", physics, places), neutral=bound)},
        wrap,
        shapes={"level": (len(at),)},
        initial_guesses=lambda span: [{"level": _share(span.x[:, at], share)} for share in shares],
        needs=states_of(physics),
        active=lambda n, x, u: np.any(_at(x[:, at], n["level"], side), axis=-1),
        channels=LEVEL,
        **fields,
    )


def _share(span: np.ndarray, share: float) -> np.ndarray:
    return span[0] + share * (span[1] - span[0])


def _at(x: np.ndarray, limit: Any, side: float) -> np.ndarray:
    near = _AT * np.where(np.isfinite(limit), np.abs(limit), 0.0)
    return np.asarray(side * (x - limit) >= -near)
