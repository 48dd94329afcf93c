"""Is what a user calls a physics one? Shapes are found by abstract evaluation; nothing is computed."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.base import Physics


def check_physics(physics: Any, where: str) -> None:
    """Raises `ValueError` unless `physics` is a `Physics` whose functions return the shapes that its signals say.

    where: who made it, for the message.
    """
    if not isinstance(physics, Physics):
        raise ValueError(f"physics: {where}: expected it to return a Physics, found {type(physics).__name__}")
    sizes = {name: len(getattr(physics, name)) for name in ("states", "inputs", "outputs")}
    x, u = (jax.ShapeDtypeStruct((sizes[name],), jnp.float32) for name in ("states", "inputs"))
    params = jax.tree.map(lambda p: jax.ShapeDtypeStruct(np.shape(p), jnp.float32), physics.params)
    for name, expected in (("step", sizes["states"]), ("measure", sizes["outputs"])):
        try:
            found = jax.eval_shape(getattr(physics, name), params, x, u)
        except Exception as problem:
            reason = str(problem).splitlines()[0]
            raise ValueError(
                f"physics {physics.name!r}: {name}: expected it to compute with jax.numpy from params, "
                f"x [{sizes['states']}] and u [{sizes['inputs']}], found {type(problem).__name__}: {reason}"
            ) from problem
        shape = getattr(found, "shape", found)
        if shape != (expected,):
            raise ValueError(f"physics {physics.name!r}: {name}: expected shape {(expected,)}, found {shape}")
    if physics.skeleton is not None:
        shape = np.shape(physics.skeleton(np.zeros((1, sizes["outputs"]))))
        if len(shape) != 3 or shape[0] != 1 or shape[1] < 2 or shape[2] != 3:
            raise ValueError(
                f"physics {physics.name!r}: skeleton: expected points [1, at least 2, 3] from outputs "
                f"[1, {sizes['outputs']}], found shape {shape}"
            )
