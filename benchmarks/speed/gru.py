"""The recurrence alone: ours and `torch.nn.GRU`, one layer without biases, inputs projected inside."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from pgrssnn_jax.models.gru import GRU

from .timing import compiled


def ours(time: int, sequences: int, hidden: int) -> dict[str, Callable[[], Any]]:
    graph, weights = nnx.split(GRU(hidden, hidden, bias=False, rngs=nnx.Rngs(0)))

    def run(weights: Any, u: jax.Array) -> jax.Array:
        gru = nnx.merge(graph, weights)
        return gru.scan(gru.project(u))

    gradient = jax.jit(jax.value_and_grad(lambda weights, u: jnp.sum(run(weights, u) ** 2)))
    u = jnp.asarray(_signal(time, sequences, hidden))
    return {"ours": compiled(jax.jit(run), weights, u).call, "ours with gradient": compiled(gradient, weights, u).call}


def theirs(time: int, sequences: int, hidden: int) -> dict[str, Callable[[], Any]]:
    import torch  # an optional extra

    gru = torch.nn.GRU(hidden, hidden, bias=False)
    u = torch.tensor(_signal(time, sequences, hidden))

    def run() -> Any:
        with torch.no_grad():
            return gru(u)[0]

    def gradient() -> Any:
        gru.zero_grad()
        loss = (gru(u)[0] ** 2).sum()
        loss.backward()
        return loss.detach()

    return {"torch.nn.GRU": run, "torch.nn.GRU with gradient": gradient}


def _signal(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal(shape).astype(np.float32)
