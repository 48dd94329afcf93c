"""The derivative of an arm's inverse dynamics in closed form, against finite differences of Pinocchio and its own."""

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from arm_samples import KUKA, OBLIQUE, TREE, states, torques, urdf

from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.points import own_points
from pgrssnn_jax.physics.arms.tables import pinocchio_model
from pgrssnn_jax.physics.arms.urdf import read_urdf

pytestmark = pytest.mark.usefixtures("x64")
STEP = 1e-6


@pytest.fixture(params=["kuka", "tree", "oblique"])
def tables(request, tmp_path):
    return (
        KUKA
        if request.param == "kuka"
        else read_urdf(urdf(tmp_path, {"tree": TREE, "oblique": OBLIQUE}[request.param]))
    )


def test_the_slopes_by_the_motion_are_those_of_pinocchio(tables):
    model, inverse = pinocchio_model(tables), own_points(tables, masses=True, measured=True).inverse
    for q, v, a in zip(*states(tables.n, 4), strict=True):
        motion = np.stack([q, v, a])
        found = jax.jacfwd(lambda m: inverse({}, *(one[:, None] for one in m), Extra())[:, 0])(jnp.asarray(motion))
        for part in range(3):
            for k in range(tables.n):
                both = np.tile(motion, (2, 1, 1))
                both[:, part, k] += (STEP, -STEP)
                above, below = torques(model, *np.swapaxes(both, 0, 1))
                slope = (above - below) / (2 * STEP)
                np.testing.assert_allclose(found[:, part, k], slope, rtol=1e-6, atol=1e-5 * np.abs(above).max())


def test_the_slopes_by_what_the_tables_do_not_say_are_finite_differences():
    """Payload, rotors, gravity, a coupled last motor and other links, together, in both modes of differentiation."""
    inverse = own_points(KUKA, masses=True, measured=True).inverse
    motion = [jnp.asarray(one.T) for one in states(6, 3)]
    extra = Extra(
        jnp.asarray([30.0, 0.2, 0.05, -0.03, 0.1]), jnp.linspace(0.1, 1.0, 6), jnp.asarray([1.0, 2.0, -9.0]),
        jnp.asarray([0.7, 0.9]), jnp.linspace(-20.0, 30.0, 6),
    )  # fmt: skip
    flat, unravel = jax.flatten_util.ravel_pytree(extra)

    def required(numbers):
        return inverse({}, *motion, unravel(numbers))

    by_hand = [(required(flat.at[k].add(1e-6)) - required(flat.at[k].add(-1e-6))) / 2e-6 for k in range(len(flat))]
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(mode(required)(flat), jnp.stack(by_hand, -1), rtol=1e-5, atol=1e-3)
