"""Functions of two vectors, of three and two numbers, that consist of operations on numbers."""

import jax
import jax.numpy as jnp
import numpy as np

MATRIX = np.random.default_rng(0).normal(size=(4, 3))


def outer_and_inner(a: jax.Array, b: jax.Array) -> jax.Array:
    return (jnp.outer(a, b) @ b).ravel() + jnp.tensordot(a, a, 1)


FUNCTIONS = {
    "elementwise": lambda a, b: jnp.where(a > b[0], jnp.exp(a), jnp.sqrt(jnp.abs(a) + 1.0)) ** 2 - jnp.tanh(b[1]) / 3,
    "clipped": lambda a, b: jnp.clip(a, b.min(), 0.4) + jnp.maximum(a, 0.1) * jnp.sign(a),
    "power": lambda a, b: (jnp.abs(a) + 0.1) ** b[0],
    "matrix": lambda a, b: MATRIX @ a + (a @ MATRIX.T)[::-1],
    "product": outer_and_inner,
    "joined": lambda a, b: jnp.concatenate([jnp.stack([b, b[::-1]]).T.ravel(), a[1:], a[:1]]),
    "placed": lambda a, b: a.at[1].add(b[0]).at[0].set(b[1]).at[2].min(b[0]).at[2].max(-1.0).at[0].multiply(2.0),
    "placed side by side": lambda a, b: a.at[1:].add(b).at[:2].multiply(b) + jnp.zeros(3).at[:].set(a).at[:2].min(-b),
    "reduced": lambda a, b: jnp.stack([a.sum(), a.max(), jnp.outer(a, b).min(0)[1], jnp.outer(a, b).sum((0, 1))]),
    "interpolated": lambda a, b: jnp.maximum(0.0, 1.0 - jnp.abs(jnp.arange(3.0) - b[0])) * a,
    "split": lambda a, b: sum(jnp.split(jnp.concatenate([a, b, a]), 2)) * jnp.repeat(b, 2),
    "passed on": lambda a, b: jnp.array([1.0, 2.0, 3.0]) + 0.0 * b[0] + a,
    "looped": lambda a, b: jax.lax.fori_loop(0, 3, lambda _, c: jnp.sin(c) * a + b[0], a) * b[1],
    "nested": lambda a, b: jax.jit(lambda c: jnp.broadcast_to(c[None], (2, 3)).reshape(-1))(a) * jnp.repeat(b, 3),
}
