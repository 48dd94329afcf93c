"""What the tests demand beyond what users do is demanded."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from pgrssnn_jax.effects.arm import tilted


def test_shapes_are_checked():
    with pytest.raises(TypeCheckError, match="gravity"):
        tilted(np.zeros(2), jnp.asarray(0.1), jnp.asarray(0.1))


def test_arrays_are_not_broadcast_by_rank():
    with pytest.raises(ValueError, match="rank"):
        jnp.zeros(3) + jnp.zeros((2, 3))
