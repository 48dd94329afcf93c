"""A rollout in chunks of samples: memory for one chunk instead of the whole record, equal numbers."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from pgrssnn_jax.models.model import Model, ModelParams


def streamed(model: Model, chunk: int) -> Callable[[ModelParams, jax.Array, jax.Array], jax.Array]:
    """(params, u, x0) -> y `[seq, time, y]` of a model without feedback whose physics is measured after its step;
    time is a multiple of `chunk`. State and GRUs are carried from chunk to chunk; inside a chunk all but the two
    recurrences is batched over time, as in the split route."""

    def run(params: ModelParams, u: jax.Array, x0: jax.Array) -> jax.Array:
        networks, physics, scaling = model.networks(params), model.physics, params.scaling
        assert networks is not None
        start = (x0, [jnp.zeros((len(x0), model.spec.hidden), x0.dtype) for _ in networks.gru])

        def one(carry: tuple[jax.Array, list[jax.Array]], u: jax.Array) -> tuple[Any, jax.Array]:
            x, h = carry
            below = phi = networks.features_u(scaling.u.to_scaled(u))
            before = below
            last = []
            for layer, h_0 in zip(networks.gru, h, strict=True):

                def recur(h: jax.Array, projected: jax.Array, layer: Any = layer) -> tuple[jax.Array, jax.Array]:
                    h = layer.step(h, projected)
                    return h, h

                end, below = jax.lax.scan(recur, h_0, layer.project(below))
                before = jnp.concatenate([h_0[None], below[:-1]])
                last.append(end)
            correction = scaling.x.unscale_difference(networks.f_nn(before, phi))

            def advance(x: jax.Array, given: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
                x = jax.vmap(physics.step, (None, 0, 0))(params.physics, x, given[0]) + given[1]
                return x, x

            x, states = jax.lax.scan(advance, x, (u, correction))
            y = jax.vmap(jax.vmap(physics.measure, (None, 0, 0)), (None, 0, 0))(params.physics, states, u)
            learnt = networks.g_nn(scaling.x.to_scaled(states), scaling.u.to_scaled(u))
            return (x, last), y + scaling.y.unscale_difference(learnt)

        chunks = jnp.swapaxes(u, 0, 1).reshape(-1, chunk, *u.shape[::2])
        y = jax.lax.scan(one, start, chunks)[1]
        return jnp.swapaxes(y.reshape(-1, *y.shape[2:]), 0, 1)

    return run
