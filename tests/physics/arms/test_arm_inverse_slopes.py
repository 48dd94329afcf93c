"""The derivative of an arm's inverse dynamics in closed form, against finite differences of Pinocchio and its own."""

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from arm_samples import KUKA, OBLIQUE, TREE, states, torques, urdf
from toys import quick_jit

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
    motions = np.stack(states(tables.n, 4), 1)
    slopes = quick_jit(jax.vmap(jax.jacfwd(lambda m: inverse({}, *(one[:, None] for one in m), Extra())[:, 0])))
    for motion, found in zip(motions, np.asarray(slopes(motions)), strict=True):
        for part in range(3):
            for k in range(tables.n):
                both = np.tile(motion, (2, 1, 1))
                both[:, part, k] += (STEP, -STEP)
                above, below = torques(model, *np.swapaxes(both, 0, 1))
                slope = (above - below) / (2 * STEP)
                np.testing.assert_allclose(found[:, part, k], slope, rtol=1e-6, atol=1e-5 * np.abs(above).max())


def test_the_slopes_by_what_the_tables_do_not_say_are_finite_differences(tmp_path):
    """Payload, rotors, gravity, a coupled last motor and other links, together, in both modes of differentiation."""
    inverse = own_points(read_urdf(urdf(tmp_path, OBLIQUE)), masses=True, measured=True).inverse
    motion = [jnp.asarray(one.T) for one in states(3, 3)]
    extra = Extra(
        jnp.asarray([30.0, 0.2, 0.05, -0.03, 0.1]), jnp.linspace(0.1, 1.0, 3), jnp.asarray([1.0, 2.0, -9.0]),
        jnp.asarray([0.7, 0.9]), jnp.linspace(-0.2, 0.3, 3),
    )  # fmt: skip
    flat, unravel = jax.flatten_util.ravel_pytree(extra)

    def required(numbers):
        return inverse({}, *motion, unravel(numbers))

    def everything(flat, moved):
        return jax.vmap(required)(moved), jax.jacfwd(required)(flat), jax.jacrev(required)(flat)

    moves = STEP * np.eye(len(flat))
    both, *found = quick_jit(everything)(flat, np.asarray(flat) + np.concatenate([moves, -moves]))
    above, below = np.split(np.asarray(both), 2)
    for slopes in found:
        np.testing.assert_allclose(slopes, np.moveaxis(above - below, 0, -1) / (2 * STEP), rtol=1e-5, atol=1e-3)
