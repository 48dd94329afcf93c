"""An input that is late, exactly between two samples too: it changes within a sample, and is held before and after.

    u'(t) = u_{k-j-1} for the first part s of a sample, then u_{k-j}        d = (j + s) dt

A step holds one input over a sample. It takes the mean, and two impulses at the ends of the sample give what the mean
does not:

    x_k = step(x_{k-1} + a + e / 2, mean) - a + e / 2        c(u) = dt f(x, u),  dx/dt = f(x, u)
    a = s (1 - s) / 2 (c(u_{k-j-1}) - c(u_{k-j}))            what acts early
    e = s c(u_{k-j-1}) + (1 - s) c(u_{k-j}) - c(mean)        a dead zone or a range between the delay and the plant

Area and first moment of what acts over the sample are exact. The second moment lacks (1 - 2s) / 3 of what the impulses
a have. Each of several inputs has impulses of its own, beside the means of the others.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.base import Effect
from pgrssnn_jax.effects.memory import memory_signals, of_inputs, remembered_inputs, with_memory
from pgrssnn_jax.effects.places import points_of
from pgrssnn_jax.physics.base import Parameter, Physics, Step, extension_of

_ROUNDING = 1e-3  # samples by which a delay of whole samples may miss them
LONGEST_DELAY = 6  # samples that input_delay remembers


def input_delay(physics: Physics) -> Effect:
    n, dt = len(physics.inputs), physics.dt
    return Effect(
        "input_delay",
        title="Input delay",
        equation="u'(t) = u(t - d)",
        cause="transport, communication or computation takes time",
        acts_on="input",
        parameters={"delay": Parameter("d", "s", bounds=(0.0, LONGEST_DELAY * dt), neutral=0.0)},
        shapes={"delay": of_inputs(n)},
        channels="input" if n > 1 else "",
        initial_guesses=lambda span: [{"delay": dt * late} for late in _delays(n)],
        wrap=_late,
        needs=remembered_inputs(physics),
    )


def _late(physics: Physics) -> Physics:
    """The physics behind the delay."""
    n, states = len(physics.inputs), len(physics.states)
    kept, change = LONGEST_DELAY * n, _change(physics)

    def samples_of(p: Any) -> jax.Array:
        return jnp.reshape(p["delay"], (1, n)) / physics.dt

    def earlier(past: jax.Array, u: jax.Array, whole: jax.Array) -> jax.Array:
        """The input so many samples ago."""
        samples = jnp.concatenate([u, past]).reshape(LONGEST_DELAY + 1, n)
        return jnp.where(jnp.arange(LONGEST_DELAY + 1, dtype=u.dtype)[:, None] == whole, samples, 0.0).sum(0)

    def parts(p: Any, past: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Older and newer input, s, and the mean over the sample."""
        whole = jnp.floor(samples_of(p))
        older, newer = (earlier(past, u, at) for at in (whole + 1.0, whole))
        part = (samples_of(p) - whole)[0]
        return older, newer, part, newer + part * (older - newer)

    def advance(p: Any, past: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        return parts(p, past, u)[-1], jnp.concatenate([u, past])[:kept]

    def at_end(p: Any, past: jax.Array, u: jax.Array) -> jax.Array:
        return earlier(past, u, jnp.floor(samples_of(p) + _ROUNDING))

    held = with_memory(physics, "input_delay", memory_signals(physics, "delayed_", LONGEST_DELAY), advance, at_end)

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        own, memory = x[:states], x[states:]
        older, newer, part, mean = parts(p.effects["input_delay"], memory[:kept], u)
        between, begin, end = change(p, own, mean), own, jnp.zeros_like(own)
        for i, s in enumerate(part):
            old, new = (change(p, own, mean.at[i].set(one[i])) for one in (older, newer))
            early, rest = 0.5 * s * (1.0 - s) * (old - new), new + s * (old - new) - between
            begin, end = begin + early + 0.5 * rest, end - early + 0.5 * rest
        x = held.step(p, jnp.concatenate([begin, memory]), u)
        return jnp.concatenate([x[:states] + end, x[states:]])

    return held._replace(step=step)


class _Reached(Exception):
    """The derivative is known, and no more of the step is needed."""

    def __init__(self, value: jax.Array) -> None:
        self.value = value


def _change(physics: Physics) -> Step:
    """dt dx/dt of (p, x, u), zero for what effects remember; for a physics that has only steps, its step.

    Effects around the step change an input on its way to the derivative. What they do to the state afterwards is left
    out: this takes a fraction of the time of a step."""
    known, points = extension_of(physics), points_of(physics)
    if known is None or points is None:
        return physics.step

    def reached(p: Any, field: Callable[[jax.Array], jax.Array], x: jax.Array, u: jax.Array) -> jax.Array:
        raise _Reached(physics.dt * field(x))

    step, _ = known.assemble(points._replace(advance=reached, sub_steps=1))

    def change(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        try:
            return step(p, x, u)
        except _Reached as found:
            return jnp.zeros_like(x).at[: len(found.value)].set(found.value)

    return change


def _delays(n: int) -> list[Float[np.ndarray, "*input"]]:
    """Delays in samples at which fits begin: of all inputs, then of each of several alone."""
    alone = [k * one for one in np.eye(n) for k in (1.5, 3.5)] if n > 1 else []
    return [np.full(of_inputs(n), k) for k in (0.5, 1.5, 2.5, 3.5, 5.0)] + alone
