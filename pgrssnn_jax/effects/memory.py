"""Effects of an input that remember: the physics sees u', and its state gains what they remember.

    u'_t, m_t = advance(n, m_{t-1}, u_t)        x_t = step(p, x_{t-1}, u'_t)        y_t = measure(p, x_t, u'_t)

An output that depends on the input directly, an acceleration say, sees what acts at the end of the sample. Where it is
read after the step, the memory from before is kept for that: an effect that acts earlier hands on its own value there.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from pgrssnn_jax.effects.base import Needs
from pgrssnn_jax.physics.base import Physics, Signal

Advance = Callable[[Any, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]


def with_memory(
    physics: Physics,
    name: str,
    memory: Sequence[Signal],
    advance: Advance,
    at_end: Callable[[Any, jax.Array, jax.Array], jax.Array] | None = None,
) -> Physics:
    """`u', memory' = advance(n, memory, u)`: the physics sees u', and its state gains the memory at its end; n: numbers
    of the effect; at_end: of the same arguments, what acts at the end of the sample, where u' is a mean over it."""
    n, direct = len(physics.states), reads_input(physics)
    end, late = n + len(memory), direct and physics.output_timing == "after_step"
    before = [signal._replace(name=f"{signal.name}_before", fit_initial=False) for signal in memory if late]

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        u, kept = advance(p.effects[name], x[n:end], u)
        return jnp.concatenate([physics.step(p, x[:n], u), kept, *([x[n:end]] if late else [])])

    def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        numbers, past = p.effects[name], x[end : end + len(before)] if late else x[n:end]
        if late and at_end:
            u = at_end(numbers, past, u)
        elif direct:
            u, _ = advance(numbers, past, u)
        return physics.measure(p, x[:n], u)

    return physics._replace(step=step, measure=measure, states=(*physics.states, *memory, *before))


def reads_input(physics: Physics) -> bool:
    """Does the measurement depend on the input directly?"""
    number = jnp.result_type(float)
    x, u = (jax.ShapeDtypeStruct((len(signals),), number) for signals in (physics.states, physics.inputs))
    program = jax.make_jaxpr(physics.measure)(physics.params, x, u).jaxpr
    reached = {id(program.invars[-1])}
    for line in program.eqns:
        if any(id(one) in reached for one in line.invars):
            reached |= {id(one) for one in line.outvars}
    return any(id(one) in reached for one in program.outvars)


def memory_signals(physics: Physics, words: str, count: int) -> list[Signal]:
    """Memory states of every input, oldest last."""
    return [
        Signal(f"{signal.name}_{words}{i + 1 if count > 1 else ''}", signal.unit, memory_of=signal.name)
        for i in range(count)
        for signal in physics.inputs
    ]


def of_inputs(n: int) -> tuple[int, ...]:
    """The shape of one number per input; a number alone for a single input."""
    return (n,) if n > 1 else ()


def remembered_inputs(physics: Physics) -> Needs:
    """The inputs that memory states are named after, in samples of the same length."""
    names, dt = [signal.name for signal in physics.inputs], physics.dt
    words = f"the input{'s' if len(names) > 1 else ''} {', '.join(names)} with dt={dt:g} s"
    return Needs(words, lambda other: [s.name for s in other.inputs] == names and other.dt == dt)
