"""The processor's arithmetic is what the library rests on: products that a jaxlib is known to compute wrongly."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest


@pytest.mark.parametrize("value", [0.0, 1.0])
@pytest.mark.parametrize("rows", [606, 3636])
def test_products_with_constant_matrices_of_equal_numbers(rows, value):
    x, c = (jax.random.normal(jax.random.key(k), shape) for k, shape in enumerate([(rows, 18), (64, 18)]))

    def bumps(x, c):
        return jnp.exp(-0.5 * jnp.sum((x[:, None] - c[None]) ** 2, -1) / 18.0)

    found = jax.jit(lambda x, c: bumps(x, c) @ jnp.full((64, 6), value))(x, c)
    expected = value * np.asarray(bumps(x, c), np.float64).sum(-1, keepdims=True) * np.ones(6)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
