"""How `vmap` maps functions that are written for many samples, batch last.

JAX's own batching puts a new axis first, where it is of no use to vector instructions.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

Arrays = tuple[jax.Array, ...]


def batch_last(function: Callable[..., Arrays]) -> Callable[..., Arrays]:
    """A function of arrays `[..., batch]` becomes one of arrays `[...]` that `vmap` maps as a whole, batch last.

    Mapped again, the axes become one batch; an axis that only some of the arrays have is left in front of these, so
    that nothing is copied for it: `function` is then mapped as JAX does it.
    """

    @jax.custom_batching.custom_vmap
    def many(*arrays: jax.Array) -> Arrays:
        return function(*arrays)

    @many.def_vmap
    def more(size: int, batched: Any, *arrays: jax.Array) -> tuple[Arrays, tuple[bool, ...]]:
        if not all(batched):
            found = jax.vmap(function, [0 if mapped else None for mapped in batched])(*arrays)
            return found, (True,) * len(found)
        merged = [jnp.moveaxis(a, 0, -2) for a in arrays]
        found = many(*(a.reshape(*a.shape[:-2], -1) for a in merged))
        return tuple(jnp.moveaxis(a.reshape(*a.shape[:-1], size, -1), -2, 0) for a in found), (True,) * len(found)

    @jax.custom_batching.custom_vmap
    def one(*arrays: jax.Array) -> Arrays:
        return tuple(a[..., 0] for a in function(*(a[..., None] for a in arrays)))

    @one.def_vmap
    def all_together(size: int, batched: Any, *arrays: jax.Array) -> tuple[Arrays, tuple[bool, ...]]:
        def last(a: jax.Array, mapped: bool) -> jax.Array:
            return jnp.moveaxis(a, 0, -1) if mapped else jnp.broadcast_to(a[..., None], (*a.shape, size))

        found = many(*(last(a, mapped) for a, mapped in zip(arrays, batched, strict=True)))
        return tuple(jnp.moveaxis(a, -1, 0) for a in found), (True,) * len(found)

    return one
