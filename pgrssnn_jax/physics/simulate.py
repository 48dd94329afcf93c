"""Free run of a physics alone: x_t = step(p, x_{t-1}, u_t) from x_0, nothing measured fed in."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Physics, Signal, Step
from pgrssnn_jax.records.record import Array


def first_output_state(
    physics: Physics, y: Float[Array, "*lead y"], u: Float[Array, "*lead u"]
) -> Float[Array, "*lead x"]:
    """x_0 from the first measured outputs and the first inputs: a state with a known start takes it, one that is `like`
    an output or `memory_of` an input takes its value, others 0. NumPy in, NumPy out; else JAX."""
    outputs, inputs = ([s.name for s in signals] for signals in (physics.outputs, physics.inputs))
    xp = np if isinstance(y, np.ndarray) else jnp
    zero = xp.zeros_like(y[..., 0])

    def start(state: Signal) -> Array:
        if state.start is not None:
            return zero + state.start
        if state.like is not None:
            return y[..., outputs.index(state.like)]
        return u[..., inputs.index(state.memory_of)] if state.memory_of in inputs else zero

    return xp.stack([start(state) for state in physics.states], axis=-1)


@partial(jax.jit, static_argnums=0)  # compiled once for all records of one physics
def simulated_states(
    step: Step, params: Any, x0: Float[jax.Array, "seq x"], u: Float[jax.Array, "seq time u"]
) -> Float[jax.Array, "seq time x"]:
    """The states after each u_t acted, in the precision of u."""
    params = jax.tree.map(lambda p: jnp.asarray(p, u.dtype), params)

    def simulate(u: jax.Array, x0: jax.Array) -> jax.Array:
        def body(x: jax.Array, u_t: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = step(params, x, u_t)
            return x, x

        return jax.lax.scan(body, x0.astype(u.dtype), u)[1]

    return jax.vmap(simulate)(u, x0)


def free_run(
    physics: Physics, u: Float[Array, "seq time u"], x0: Float[Array, "seq x"]
) -> tuple[Float[jax.Array, "seq time y"], Float[jax.Array, "seq time x"]]:
    """Outputs and states of a physics with its own numbers."""
    u, x0 = jnp.asarray(u), jnp.asarray(x0)
    x = simulated_states(physics.step, physics.params, x0, u)
    read = x if physics.output_timing == "after_step" else jnp.concatenate([x0[:, None], x[:, :-1]], 1)
    params = jax.tree.map(lambda p: jnp.asarray(p, u.dtype), physics.params)
    return jax.vmap(jax.vmap(physics.measure, (None, 0, 0)), (None, 0, 0))(params, read, u), x


def has_forward_mode(physics: Physics) -> bool:
    """Can a step be differentiated forwards? A physics with a derivative rule of its own (the arm) only can backwards,
    and the Jacobian of a long run by an initial state is then out of reach."""
    x, u = (jnp.zeros(len(signals)) for signals in (physics.states, physics.inputs))
    try:
        jax.eval_shape(jax.jacfwd(lambda x: physics.step(physics.params, x, u)), x)
    except TypeError:
        return False
    return True
