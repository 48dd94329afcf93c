"""Effects that a linear state-space model may lack.

feedthrough         y ← y + D u
quadratic damping   x_t ← x_t - c |x_{t-1}| x_{t-1}        one c per state
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, after_step
from pgrssnn_jax.physics.base import Parameter, Physics
from pgrssnn_jax.physics.linear import times


def lgssm_effects(physics: Physics) -> tuple[Effect, ...]:
    return (quadratic_damping(physics), feedthrough(physics))


def feedthrough(physics: Physics) -> Effect:
    name, shape = "feedthrough", (len(physics.outputs), len(physics.inputs))

    def wrap(inner: Physics) -> Physics:
        def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            return inner.measure(p, x, u) + times(p[name]["D"], u)

        return inner._replace(measure=measure)

    return Effect(
        name,
        "Direct feedthrough",
        "y = C x + D u",
        "the input acts on the output at once, past the state",
        "measurement",
        {"D": Parameter("D", neutral=0.0)},
        lambda span: [{"D": np.full(shape, 0.05)}, {"D": np.full(shape, -0.05)}],
        wrap,
        {"D": shape},
        channels="output, input",
    )


def quadratic_damping(physics: Physics) -> Effect:
    name, n = "quadratic_damping", len(physics.states)

    def change(p: Any, x: jax.Array, u: jax.Array, new: jax.Array) -> jax.Array:
        own = x[:n]
        return new.at[:n].add(-p[name]["c"] * jnp.abs(own) * own)

    return Effect(
        name,
        "Quadratic damping",
        "x = A x' + B u - c |x'| x'",
        "drag that grows with the square of the speed",
        "dynamics",
        {"c": Parameter("c", neutral=0.0)},
        lambda span: [{"c": np.full(n, value)} for value in (0.01, 0.05)],
        lambda inner: after_step(inner, change),
        {"c": (n,)},
        channels="state",
    )
