"""How `vmap` maps functions that are written for many samples, batch last.

JAX's own batching puts a new axis first, where it is of no use to vector instructions.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def batch_last(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of trees of arrays `[..., batch]` becomes one of arrays `[...]` that `vmap` maps as a whole, batch
    last.

    Mapped again, the axes become one batch; an axis that only some of the arrays have is left in front of these, so
    that nothing is copied for it: `function` is then mapped as JAX does it.
    """
    function = jax.jit(function)  # a program calls it in many places: traced once, not in each of them

    @jax.custom_batching.custom_vmap
    def many(*given: Any) -> Any:
        return function(*given)

    @many.def_vmap
    def more(size: int, batched: Any, *given: Any) -> tuple[Any, Any]:
        if all(jax.tree.leaves(batched)):
            merged = jax.tree.map(lambda a: (b := jnp.moveaxis(a, 0, -2)).reshape(*b.shape[:-2], -1), given)
            found = many(*merged)
            found = jax.tree.map(lambda a: jnp.moveaxis(a.reshape(*a.shape[:-1], size, -1), -2, 0), found)
        else:
            found = jax.vmap(function, jax.tree.map(lambda mapped: 0 if mapped else None, batched))(*given)
        return found, jax.tree.map(lambda _: True, found)

    @jax.custom_batching.custom_vmap
    def one(*given: Any) -> Any:
        return jax.tree.map(lambda a: a[..., 0], function(*jax.tree.map(lambda a: a[..., None], given)))

    @one.def_vmap
    def all_together(size: int, batched: Any, *given: Any) -> tuple[Any, Any]:
        def last(a: jax.Array, mapped: bool) -> jax.Array:
            return jnp.moveaxis(a, 0, -1) if mapped else jnp.broadcast_to(a[..., None], (*a.shape, size))

        found = many(*jax.tree.map(last, tuple(given), tuple(batched)))
        return jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), found), jax.tree.map(lambda _: True, found)

    return one
