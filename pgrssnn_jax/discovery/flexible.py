"""Corrections without a name: what can be said of an equation that is wrong in a way that no catalogue knows.

    x_i ← x_i + dt Σ c_j φ_j(s)        s: a state or an input          dynamics
    u   ← u + Σ c_j φ_j(u)             u ← u + Σ c_k (u_{t-k} - u_t)   input
    y   ← y + Σ c_j φ_j(y)                                             measurement

φ_j: hat functions on equal knots over the reach of s. Beyond it a curve of the dynamics is constant; one of an input or
of a reading goes on as its outer segments do: what a saturated sensor hides is beyond the reach. Each family is an
`Effect` whose neutral coefficients are zero, so that the same fits serve named effects and these.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.base import Effect, SignalRange, after_step, on_input, on_output
from pgrssnn_jax.effects.memory import with_memory
from pgrssnn_jax.physics.base import Parameter, Physics, Signal

KNOTS = 12  # with 8, an input's limit between two knots left errors 1.12 times the noise, where a stand-in left 1.22
HISTORY = 6  # samples of the past
_WIDE = 4  # more states than this: a state is corrected by itself, a rate also by what it is the rate of


class Where(NamedTuple):
    """What a family corrects and by which signal: kind `state`, `input`, `output` or `history`; target: index of the
    corrected state, input or output; by: kind (`x`, `u`, `y`) and index of the signal."""

    kind: str
    target: int
    by: tuple[str, int]


def families(physics: Physics) -> dict[str, Where]:
    """Every family for the signals of a physics, by name."""
    states, inputs, outputs = physics.states, physics.inputs, physics.outputs
    found: dict[str, Where] = {}
    wide = len(states) > _WIDE
    for i, state in enumerate(states):
        for kind, signals in (("x", states), ("u", () if wide else inputs)):
            for j, signal in enumerate(signals):
                if not wide or _belong(states, state, signal):
                    found[f"{state.name} by {signal.name}"] = Where("state", i, (kind, j))
    for j, signal in enumerate(inputs):
        found[f"{signal.name} by itself"] = Where("input", j, ("u", j))
        found[f"{signal.name} by its history"] = Where("history", j, ("u", j))
    for j, signal in enumerate(outputs):
        found[f"reading of {signal.name} by itself"] = Where("output", j, ("y", j))
    return found


def _belong(states: Sequence[Signal], state: Signal, signal: Signal) -> bool:
    """Is the signal the state itself, or the output or state whose rate it is? The equation of a state whose rate is a
    state is known."""
    if state.rate_of is None:
        rates = {one.rate_of for one in states if one.rate_of is not None}
        return signal.name == state.name and not rates & {state.name, state.like}
    return state.rate_of in (signal.name, signal.like, signal.rate_of)


def flexible_effects(physics: Physics) -> tuple[Effect, ...]:
    return tuple(_family(physics, name, where) for name, where in families(physics).items())


def hats(value: jax.Array, low: jax.Array, high: jax.Array, c: Float[jax.Array, " knots"]) -> jax.Array:
    """Σ c_j φ_j(value): linear between the knots, constant beyond the first and the last."""
    place = jnp.clip((value - low) / (high - low), 0.0, 1.0) * (KNOTS - 1)
    return (jnp.maximum(1.0 - jnp.abs(place - jnp.arange(KNOTS, dtype=c.dtype)), 0.0) * c).sum()


def continued(value: jax.Array, low: jax.Array, high: jax.Array, c: Float[jax.Array, " knots"]) -> jax.Array:
    """The same, but as the first and the last segment beyond them."""
    place = (value - low) / (high - low) * (KNOTS - 1)
    below, above = jnp.minimum(place, 0.0), jnp.maximum(place - (KNOTS - 1), 0.0)
    return hats(value, low, high, c) + below * (c[1] - c[0]) + above * (c[-1] - c[-2])


def nearness(values: Float[np.ndarray, "*n"], low: Any, high: Any, knots: int = KNOTS) -> Float[np.ndarray, "*n knots"]:
    """φ_j of many values, for what is not traced."""
    place = np.clip((values - low) / (high - low), 0.0, 1.0) * (knots - 1)
    return np.maximum(1.0 - np.abs(place[..., None] - np.arange(knots)), 0.0)


def _family(physics: Physics, name: str, where: Where) -> Effect:
    if where.kind == "history":
        return _history(physics, name, where.target)
    kind, index = where.by

    def initial_guesses(span: SignalRange) -> list[dict[str, Any]]:
        low, high = getattr(span, kind)[:, index]
        if not high > low:
            return []  # no curve over a signal that does not move
        return [{"c": np.zeros(KNOTS), "high": np.asarray(high), "low": np.asarray(low)}]

    def after(p: Any, own: Any, x: jax.Array, u: jax.Array, new: jax.Array) -> jax.Array:
        signal = 0.5 * (x[index] + new[index]) if kind == "x" else u[index]
        return new.at[where.target].add(physics.dt * hats(signal, p["low"], p["high"], p["c"]))

    def on_channel(p: Any, value: jax.Array) -> jax.Array:
        own = value[where.target]
        return value.at[where.target].add(continued(own, p["low"], p["high"], p["c"]))

    wrap: dict[str, Callable[[Physics], Physics]] = {
        "state": lambda inner: after_step(inner, name, after),
        "input": lambda inner: on_input(inner, name, on_channel),
        "output": lambda inner: on_output(inner, name, on_channel),
    }
    fixed = Parameter(neutral=0.0, trainable=False)
    return Effect(
        name,
        title=name,
        equation="Σ c_j φ_j",
        cause="",
        acts_on={"state": "dynamics", "input": "input", "output": "measurement"}[where.kind],  # pyright: ignore[reportArgumentType]
        parameters={"c": Parameter("c", neutral=0.0), "high": fixed._replace(neutral=1.0), "low": fixed},
        initial_guesses=initial_guesses,
        wrap=wrap[where.kind],
        shapes={"c": (KNOTS,)},
    )


def _history(physics: Physics, name: str, channel: int) -> Effect:
    signal = physics.inputs[channel]
    memory = [Signal(f"{signal.name}_{k + 1}_ago", signal.unit, memory_of=signal.name) for k in range(HISTORY)]

    def advance(p: Any, past: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        own = u[channel]
        kept = jnp.concatenate([own[None], past])[:HISTORY]
        return u.at[channel].add((p["c"] * (past - own)).sum()), kept

    return Effect(
        name,
        title=name,
        equation="Σ c_k (u_{t-k} - u_t)",
        cause="",
        acts_on="input",
        parameters={"c": Parameter("c", neutral=0.0)},
        initial_guesses=lambda span: [{"c": np.zeros(HISTORY)}],
        wrap=lambda inner: with_memory(inner, name, memory, advance),
        shapes={"c": (HISTORY,)},
    )
