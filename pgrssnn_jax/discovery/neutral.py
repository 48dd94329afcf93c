"""Does an effect of the user's own change nothing while its numbers are neutral?

    step(p, x, u) and measure(p, x, u) with the effect = those without it        at states and inputs of the record

Discovery compares models with and without an effect, and takes the model at the neutral numbers for the one without.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.base import Effect, Numbers, add
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.simulate import first_output_state

_EQUAL = 1e-6  # of a signal's largest value: a function may compute in float32
_SAMPLES = 2000


def check_neutral(
    physics: Physics, effects: Sequence[Effect], x: Float[np.ndarray, "n x"], u: Float[np.ndarray, "n u"]
) -> None:
    """Raises `ValueError` for an effect that changes a step or a reading of the physics at its neutral numbers.

    x: states before inputs u."""
    if not effects:
        return
    few = slice(None, None, -(-len(x) // _SAMPLES))
    with jax.enable_x64(True):
        x, u = np.asarray(x[few], np.float64), np.asarray(u[few], np.float64)
        expected = _steps(physics, x, u)
        largest = np.abs(expected).max(0) + np.finfo(np.float32).tiny
        signals = (*physics.states, *physics.outputs)
        for effect in effects:
            changed = add(physics, effect)
            start = np.asarray(first_output_state(changed, expected[:, x.shape[1] :], u))
            found = _steps(changed, np.concatenate([x, start[:, x.shape[1] :]], 1), u, len(physics.states))
            moved = np.nan_to_num(np.abs(found - expected), nan=np.inf, posinf=np.inf)
            wrong = (moved > _EQUAL * largest).any(0)
            if wrong.any():
                k = int(np.argmax(wrong))
                kind = "state" if k < len(physics.states) else "output"
                by = f"{moved[:, k].max():.3g} {signals[k].unit}".rstrip()
                raise ValueError(
                    f"effects: {effect.name}: expected that it changes nothing at its neutral value, "
                    f"{_words(effect.neutral())}, found {kind} {signals[k].name!r} changed by up to {by} in a step"
                )


def _steps(
    physics: Physics, x: Float[np.ndarray, "n x"], u: Float[np.ndarray, "n u"], own: int | None = None
) -> Float[np.ndarray, "n xy"]:
    """The first `own` states after one step, and what is read then."""
    params = jax.tree.map(jnp.asarray, physics.params)

    def step(x: jax.Array, u: jax.Array) -> jax.Array:
        new = physics.step(params, x, u)
        return jnp.concatenate([new[:own], physics.measure(params, new, u)])

    return np.asarray(jax.jit(jax.vmap(step))(x, u))


def _words(numbers: Numbers) -> str:
    """Neutral numbers of a parameter are all alike."""
    return ", ".join(f"{name}={np.ravel(value)[0]:g}" for name, value in numbers.items())
