from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from arm_samples import PENDULUM, sample_arm, states, urdf
from jax.test_util import check_grads
from toys import quick_jit

from pgrssnn_jax.physics.arms.jax_dynamics import forward_dynamics
from pgrssnn_jax.physics.arms.urdf import read_urdf
from pgrssnn_jax.physics.integrate import rk4_looped

pytestmark = pytest.mark.usefixtures("x64")


def test_pendulum_follows_its_textbook_equation(tmp_path):
    tables = read_urdf(urdf(tmp_path, PENDULUM))
    q, v, tau = states(1, 20)
    own = pin.buildModelFromUrdf(str(tmp_path / "robot.urdf")).inertias[1]
    x, _, z = own.lever
    swung = own.inertia[1, 1] + own.mass * (x**2 + z**2)
    # the height of the centre of mass after a turn about y: z cos q - x sin q
    weight = 9.81 * own.mass * (z * np.sin(q) + x * np.cos(q))
    found = quick_jit(jax.vmap(forward_dynamics(tables)))(q, v, tau)
    np.testing.assert_allclose(found, (tau + weight) / swung, rtol=1e-12)


def test_gradient_through_a_rollout_is_that_of_finite_differences(tmp_path):
    tables, _ = sample_arm("oblique", tmp_path)
    forward = forward_dynamics(tables)
    q, v, tau = (x[0] for x in states(3, 1))

    def slope(x, tau):
        return jnp.concatenate([x[3:], forward(x[:3], x[3:], tau)])

    def last(x, tau):
        return jax.lax.scan(lambda x, _: (rk4_looped(partial(slope, tau=tau), x, 0.02), None), x, length=8)[0]

    check_grads(jax.jit(last), (np.concatenate([q, v]), tau), order=1, modes=["rev"], rtol=1e-5, atol=1e-5)


def test_without_gravity_and_torque_an_arm_at_rest_stays_at_rest(tmp_path):
    tables, _ = sample_arm("oblique", tmp_path)
    still = np.zeros((5, 3))
    floating = quick_jit(jax.vmap(forward_dynamics(tables._replace(gravity=np.zeros(3)))))
    np.testing.assert_array_equal(floating(states(3, 5)[0], still, still), still)
