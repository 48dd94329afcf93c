"""Effects that a linear state-space model may lack.

feedthrough         y ← y + D u
quadratic damping   x_t ← x_t - c |x_{t-1}| x_{t-1}        one c per state
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Needs, after_step, own_of
from pgrssnn_jax.physics.base import Parameter, Physics
from pgrssnn_jax.physics.linear import times


def lgssm_effects(physics: Physics) -> tuple[Effect, ...]:
    return (quadratic_damping(physics), feedthrough(physics))


def _linear(physics: Physics) -> Needs:
    """Matrices of these shapes: the numbers are one per state, or per output and input."""
    a, b, c = shapes = [np.shape(own_of(physics.params)[name]) for name in "ABC"]

    def met(other: Physics) -> bool:
        own = own_of(other.params)
        return set("ABC") <= set(own) and [np.shape(own[name]) for name in "ABC"] == shapes

    return Needs(f"a linear state-space model with A {a}, B {b} and C {c}", met)


def feedthrough(physics: Physics) -> Effect:
    name, shape = "feedthrough", (len(physics.outputs), len(physics.inputs))

    def wrap(inner: Physics) -> Physics:
        def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            return inner.measure(p, x, u) + times(p.effects[name]["D"], u)

        return inner._replace(measure=measure)

    return Effect(
        name,
        title="Direct feedthrough",
        equation="y = C x + D u",
        cause="the input acts on the output at once, past the state",
        acts_on="measurement",
        parameters={"D": Parameter("D", neutral=0.0)},
        initial_guesses=lambda span: [{"D": np.full(shape, 0.05)}, {"D": np.full(shape, -0.05)}],
        wrap=wrap,
        needs=_linear(physics),
        shapes={"D": shape},
        channels="output, input",
    )


def quadratic_damping(physics: Physics) -> Effect:
    name, n = "quadratic_damping", len(physics.states)

    def change(p: Any, own: Any, x: jax.Array, u: jax.Array, new: jax.Array) -> jax.Array:
        return new.at[:n].add(-p["c"] * jnp.abs(x[:n]) * x[:n])

    return Effect(
        name,
        title="Quadratic damping",
        equation="x = A x' + B u - c |x'| x'",
        cause="drag that grows with the square of the speed",
        parameters={"c": Parameter("c", neutral=0.0)},
        initial_guesses=lambda span: [{"c": np.full(n, value)} for value in (0.01, 0.05)],
        wrap=lambda inner: after_step(inner, name, change),
        needs=_linear(physics),
        shapes={"c": (n,)},
        channels="state",
    )
