"""Effects of an input that remember: the physics sees u', and its state gains what they remember.

    u'_t, m_t = advance(n, m_{t-1}, u_t)        x_t = step(p, x_{t-1}, u'_t)        y_t = measure(p, x_t, u'_t)

An output that depends on the input directly, an acceleration say, is read after the step: then u'_t is remembered too,
or the memory itself is what acts at the end of the sample.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from pgrssnn_jax.effects.base import Needs
from pgrssnn_jax.physics.base import Physics, Signal


def with_memory(
    physics: Physics,
    name: str,
    memory: Sequence[Signal],
    advance: Callable[[Any, jax.Array, jax.Array], tuple[jax.Array, jax.Array]],
    *,
    acts_at_end: bool = False,
) -> Physics:
    """`u', memory' = advance(n, memory, u)`: the physics sees u', and its state gains the memory at its end; n: numbers
    of the effect; acts_at_end: the memory, one number per input, is what acts at the end of the sample, where u' is a
    mean over it."""
    n, direct = len(physics.states), reads_input(physics)
    end, after = n + len(memory), physics.output_timing == "after_step"
    late = direct and after and not acts_at_end
    acting = [Signal(f"{s.name}_after_{name}", s.unit, memory_of=s.name) for s in physics.inputs if late]

    def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        u, kept = advance(p.effects[name], x[n:end], u)
        return jnp.concatenate([physics.step(p, x[:n], u), kept, *([u] if late else [])])

    def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        if direct and after:
            u = x[n:end] if acts_at_end else x[end : end + len(acting)]
        elif direct:
            u, _ = advance(p.effects[name], x[n:end], u)
        return physics.measure(p, x[:n], u)

    return physics._replace(step=step, measure=measure, states=(*physics.states, *memory, *acting))


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
