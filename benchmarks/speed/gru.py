"""The recurrence alone: ours by XLA and by the C++ kernel, and `torch.nn.GRU`; no biases, inputs projected inside."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from pgrssnn_jax.acceleration.native import missing_kernels
from pgrssnn_jax.models.gru import GRU

from .timing import compiled


def ours(time: int, sequences: int, hidden: int) -> dict[str, Callable[[], Any]]:
    graph, weights = nnx.split(GRU(hidden, hidden, bias=False, rngs=nnx.Rngs(0)))
    u, start = jnp.asarray(_signal(time, sequences, hidden)), jnp.zeros((sequences, hidden))
    found = {}
    for form, native in {"ours": False, "ours, C++ kernel": True}.items():
        if native and missing_kernels():
            continue

        def run(weights: Any, u: jax.Array, native: bool = native) -> jax.Array:
            return nnx.merge(graph, weights).scan(u, start, native=native)

        gradient = jax.value_and_grad(lambda weights, u, run=run: jnp.sum(run(weights, u) ** 2))
        found[form] = compiled(jax.jit(run), weights, u).call
        found[f"{form} with gradient"] = compiled(jax.jit(gradient), weights, u).call
    return found


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
