from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from arm_samples import accelerations, in_model, sample_arm, states, torques, with_rotor
from toys import quick_jit

from pgrssnn_jax.physics.arms.jax_dynamics import forward_dynamics
from pgrssnn_jax.physics.integrate import rk4_looped

BATCH = 1000
pytestmark = pytest.mark.usefixtures("x64")


class Robot:
    """Tables, Pinocchio's own model, and functions of `[batch, n]`, compiled once for `BATCH` samples."""

    def __init__(self, name, folder):
        self.tables, self.model = sample_arm(name, folder)
        if name in ("tree", "fork"):
            self.tables, self.model = with_rotor(self.tables, self.model)
        self.n, self.forward = self.tables.n, forward_dynamics(self.tables)

        def pulled(q, v, tau, a_bar):
            a, back = jax.vjp(self.forward, q, v, tau)
            return a, back(a_bar)

        self._pulled = quick_jit(jax.vmap(pulled))

    def pulled(self, *given):
        return batched(self._pulled, *given)

    def accelerations(self, q, v, tau):
        return self.pulled(q, v, tau, np.zeros_like(tau))[0]

    def masses(self, q):
        data = self.model.createData()
        found = np.stack([np.triu(pin.crba(self.model, data, in_model(self.model, x))) for x in q])
        return found + np.swapaxes(np.triu(found, 1), 1, 2)


def batched(function, *given):
    count = len(given[0])
    found = function(*(np.resize(x, (BATCH, *np.shape(x)[1:])) for x in given))
    return jax.tree.map(lambda x: np.asarray(x)[:count], found)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return cache(lambda name: Robot(name, tmp_path_factory.mktemp("robot")))


MORE = [pytest.param(name, marks=pytest.mark.compiles) for name in ("ur5_robot.urdf", "tree")]


@pytest.fixture(scope="module", params=["kuka", "fork", *MORE])
def robot(made, request):
    return made(request.param)


@pytest.fixture
def kuka(made):
    return made("kuka")


@pytest.fixture
def tree(made):
    return made("tree")


def assert_close(found, expected, rtol):
    """Relative to the largest number of each sample."""
    found, expected = np.asarray(found), np.asarray(expected)
    axes = tuple(range(1, found.ndim))
    assert found.shape == expected.shape
    assert np.all(np.abs(found - expected).max(axes) <= rtol * np.abs(expected).max(axes))


def weighed(robot, count, seed=0):
    """States, with torques of the size that the robot's masses need."""
    q, v, a = states(robot.n, count, seed)
    return q, v, torques(robot.model, q, v, a)


def test_accelerations_are_pinocchios(robot):
    given = weighed(robot, 1000)
    assert_close(robot.accelerations(*given), accelerations(robot.model, *given), 1e-9)


def test_free_motion_keeps_its_energy(tree):
    q, v, _ = states(tree.n, 1)

    def slope(x):
        return jnp.concatenate([x[tree.n :], tree.forward(x[: tree.n], x[tree.n :], jnp.zeros(tree.n))])

    def move(x, _):
        x = rk4_looped(slope, x, 5e-4)
        return x, x

    x = np.asarray(quick_jit(lambda x: jax.lax.scan(move, x, length=2000)[1])(np.concatenate([q[0], v[0]])))
    q, v, data = *np.split(x[::100], 2, axis=-1), tree.model.createData()
    height = np.array([pin.computePotentialEnergy(tree.model, data, in_model(tree.model, one)) for one in q])
    moving = np.einsum("bi,bij,bj->b", v, tree.masses(q), v) / 2
    assert np.ptp(moving) > 1.0
    assert np.ptp(moving + height) < 1e-6 * np.ptp(moving)


def test_reverse_derivatives_are_pinocchios(robot):
    given, data = weighed(robot, 200), robot.model.createData()
    a_bar = states(robot.n, 200, seed=9)[2]
    expected = [[], [], []]
    for q, v, tau, cotangent in zip(*given, a_bar, strict=True):
        pin.computeABADerivatives(robot.model, data, in_model(robot.model, q), v, tau)
        for found, matrix in zip(expected, (data.ddq_dq, data.ddq_dv, data.Minv), strict=True):
            found.append(cotangent @ matrix)
    for found, right in zip(robot.pulled(*given, a_bar)[1], expected, strict=True):
        assert_close(found, np.array(right), 1e-8)


def test_reverse_derivatives_are_finite_differences(robot):
    (given, a_bar), h = (np.stack([x[0] for x in weighed(robot, 1, seed=4)]), states(robot.n, 1, seed=9)[2]), 1e-5
    moves = h * np.eye(3 * robot.n).reshape(-1, 3, robot.n)
    plus, minus = (robot.accelerations(*np.swapaxes(given + sign * moves, 0, 1)) for sign in (1, -1))
    slopes = ((plus - minus) @ a_bar[0] / (2 * h)).reshape(3, robot.n)
    for found, expected in zip(robot.pulled(*given[:, None], a_bar)[1], slopes, strict=True):
        assert_close(found, expected[None], 1e-5)


def test_jacobian_to_torque_is_the_inverse_mass_matrix(kuka):
    given = weighed(kuka, 1)
    _, (_, _, found) = kuka.pulled(*(np.repeat(x, 6, 0) for x in given), np.eye(6))
    np.testing.assert_allclose(found @ kuka.masses(given[0])[0], np.eye(6), atol=1e-10)


def test_single_precision_stays_single_and_agrees(kuka):
    single = [x.astype(np.float32) for x in (*weighed(kuka, 300), states(kuka.n, 300, seed=9)[2])]
    double = [x.astype(np.float64) for x in single]
    (a, pulled), (a_double, pulled_double) = kuka.pulled(*single), kuka.pulled(*double)
    for found, expected in zip((a, *pulled), (a_double, *pulled_double), strict=True):
        assert found.dtype == np.float32
        assert_close(found, expected, 3e-4)


def test_single_precision_of_a_tree_stays_single(tree):
    def everything(x):
        a, back = jax.vjp(tree.forward, x, x, x)
        return a, back(x)

    found = jax.eval_shape(jax.vmap(everything), jax.ShapeDtypeStruct((5, tree.n), jnp.float32))
    assert {x.dtype for x in jax.tree.leaves(found)} == {jnp.float32.dtype}


def test_mapping_over_two_axes_is_a_loop(made):
    """Both axes, and a velocity that only the outer one has."""
    fork = made("fork")
    q, v, tau = (x.reshape(3, 4, 4) for x in weighed(fork, 12))
    v = v[:, 0]
    mapped = quick_jit(jax.vmap(jax.vmap(fork.forward, (0, None, 0)), out_axes=1))
    given = q.reshape(12, 4), np.repeat(v, 4, 0), tau.reshape(12, 4)
    found = np.swapaxes(mapped(q, v, tau), 0, 1).reshape(12, 4)
    np.testing.assert_allclose(found, accelerations(fork.model, *given), rtol=1e-9)


def test_one_sample_alone_is_a_batch_of_one(kuka):
    given = weighed(kuka, 3)
    alone = quick_jit(kuka.forward)(*(x[1] for x in given))
    np.testing.assert_allclose(alone, kuka.accelerations(*given)[1], rtol=1e-10)


def test_one_bad_sample_spoils_no_other(kuka):
    q, v, tau = weighed(kuka, 3)
    expected = kuka.accelerations(q, v, tau)
    q[1] = np.nan
    found = np.asarray(kuka.accelerations(q, v, tau))
    assert np.isnan(found[1]).all()
    np.testing.assert_array_equal(found[::2], np.asarray(expected)[::2])


def test_torque_at_rest_is_the_weight(robot):
    q, still, data = states(robot.n, 50)[0], np.zeros((50, robot.n)), robot.model.createData()
    weight = [pin.computeGeneralizedGravity(robot.model, data, in_model(robot.model, x)).copy() for x in q]
    np.testing.assert_allclose(robot.accelerations(q, still, np.array(weight)), still, atol=1e-8)
