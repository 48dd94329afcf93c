"""Is what a user calls a physics one? Shapes are found by abstract evaluation; nothing is computed."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.arguments import real_numbers, shown, typed_line


def check_physics(physics: Any, where: str) -> None:
    """Raises `ValueError` unless `physics` is a `Physics` whose functions return the shapes that its signals say.

    where: who made it, for the message.
    """
    if not isinstance(physics, Physics):
        raise ValueError(f"physics: {where}: expected it to return a Physics, found {type(physics).__name__}")
    check_functions(physics)


def check_given(physics: Any) -> None:
    """Raises `ValueError` for what a caller gives as a physics and is none, and as `check_functions` for one that is
    not of the library, whose functions return what they should."""
    if not isinstance(physics, Physics):
        hint = ", which it returns when it is called" if callable(physics) else ""
        raise ValueError(f"physics: expected a pg.Physics{hint}, found {shown(physics)}")
    if not of_library(physics):
        check_functions(physics)


def checked_inputs(u: Any, n_u: int) -> np.ndarray:
    """The u of a free run `[time, input]` or `[sequence, time, input]`. Raises `ValueError` for anything else."""
    found = real_numbers("simulate: u", u)
    if found.ndim not in (2, 3) or found.shape[-1] != n_u or not found.size:
        raise ValueError(f"simulate: u: expected [time, {n_u}] or [sequence, time, {n_u}], found shape {found.shape}")
    return found.astype(np.float64)


def checked_start(x0: Any, n_x: int, sequences: int, members: int | None = None) -> np.ndarray:
    """The x_0 of a free run `[state]` or `[sequence, state]`, or of an ensemble `[member, sequence, state]`. Raises
    `ValueError` for anything else."""
    found = real_numbers("simulate: x0", x0)
    shapes = [(n_x,), (sequences, n_x), *([(members, sequences, n_x)] if members else [])]
    if found.shape not in shapes:
        raise ValueError(f"simulate: x0: expected shape {' or '.join(map(str, shapes))}, found {found.shape}")
    return found.astype(np.float64)


def of_library(physics: Physics) -> bool:
    """Was it built by the package, and not by its user?"""
    return physics.origin is not None and physics.origin.target.startswith("pgrssnn_jax.")


def check_functions(physics: Physics) -> None:
    """Raises `ValueError` unless step and measurement can be traced and return what the signals say."""
    sizes = {name: len(getattr(physics, name)) for name in ("states", "inputs", "outputs")}
    x, u = (jax.ShapeDtypeStruct((sizes[name],), jnp.float32) for name in ("states", "inputs"))
    params = jax.tree.map(lambda p: jax.ShapeDtypeStruct(np.shape(p), jnp.float32), physics.params)
    for name, expected in (("step", sizes["states"]), ("measure", sizes["outputs"])):
        try:
            found = jax.eval_shape(getattr(physics, name), params, x, u)
        except Exception as problem:
            reason = typed_line(problem)
            raise ValueError(
                f"physics {physics.name!r}: {name}: expected it to compute with jax.numpy from params, "
                f"x [{sizes['states']}] and u [{sizes['inputs']}], found {reason}"
            ) from problem
        shape = getattr(found, "shape", type(found).__name__)
        if shape != (expected,):
            raise ValueError(f"physics {physics.name!r}: {name}: expected shape {(expected,)}, found {shape}")
        if not jnp.issubdtype(found.dtype, jnp.floating):
            raise ValueError(f"physics {physics.name!r}: {name}: expected floating-point numbers, found {found.dtype}")
    if physics.skeleton is not None:
        shape = np.shape(physics.skeleton(np.zeros((1, sizes["outputs"]))))
        if len(shape) != 3 or shape[0] != 1 or shape[1] < 2 or shape[2] != 3:
            raise ValueError(
                f"physics {physics.name!r}: skeleton: expected points [1, at least 2, 3] from outputs "
                f"[1, {sizes['outputs']}], found shape {shape}"
            )
