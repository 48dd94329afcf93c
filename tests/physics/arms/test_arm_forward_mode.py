from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from arm_samples import KUKA, in_model, sample_arm, states, torques, with_rotor
from jax.flatten_util import ravel_pytree
from jax.test_util import check_grads
from toys import quick_jit

from pgrssnn_jax.physics.arms import pinocchio_dynamics
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.jax_dynamics import forward_dynamics

pytestmark = pytest.mark.usefixtures("x64")
BY_ALL = (0, 1, 2, 3)


def changed(n):
    """A payload, rotors, a gravity that is askew, a last motor that turns with the joint before, and other links."""
    payload, gravity = jnp.array([3.0, 0.2, 0.1, -0.3, 0.4]), jnp.array([1.0, -2.0, 8.0])
    return Extra(payload, jnp.linspace(0.1, 1.0, n), gravity, jnp.array([0.7, -1.5]), jnp.linspace(0.3, -0.2, n))


class Robot:
    """Tables, Pinocchio's own model, and Jacobians for five samples in both modes, with and without `Extra`."""

    def __init__(self, name, folder):
        self.tables, self.model = sample_arm(name, folder)
        if name != "kuka":
            self.tables, self.model = with_rotor(self.tables, self.model)
        self.n = self.tables.n
        modes = {"forward": jax.jacfwd, "reverse": jax.jacrev}
        self.value, self.jacobian = {}, {}
        for mode, differentiate in modes.items():
            dynamics = forward_dynamics(self.tables, mode)
            self.value[mode] = quick_jit(jax.vmap(dynamics, (0, 0, 0, None)))
            self.jacobian[mode] = cache_by_extra(quick_jit(jax.vmap(differentiate(dynamics, BY_ALL), (0, 0, 0, None))))
        q, v, a = states(self.n, 5)
        self.given = q, v, torques(self.model, q, v, a)


def cache_by_extra(function):
    found = {}

    def once(q, v, tau, extra):
        key = len(jax.tree.leaves(extra))
        if key not in found:
            found[key] = jax.tree.map(np.asarray, function(q, v, tau, extra))
        return found[key]

    return once


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return cache(lambda name: Robot(name, tmp_path_factory.mktemp("robot")))


@pytest.fixture(params=["fork", *(pytest.param(name, marks=pytest.mark.compiles) for name in ("kuka", "tree"))])
def robot(made, request):
    return made(request.param)


def assert_close(found, expected, rtol):
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=rtol * np.abs(expected).max())


def test_jacobians_are_pinocchios(robot):
    data, found = robot.model.createData(), robot.jacobian["forward"](*robot.given, Extra())
    for i, (q, v, tau) in enumerate(zip(*robot.given, strict=True)):
        pin.computeABADerivatives(robot.model, data, in_model(robot.model, q), v, tau)
        for mine, expected in zip(found[:3], (data.ddq_dq, data.ddq_dv, data.Minv), strict=True):
            assert_close(mine[i], expected, 1e-9)


@pytest.mark.parametrize("with_extra", [False, True])
def test_both_modes_have_one_jacobian(robot, with_extra):
    extra = changed(robot.n) if with_extra else Extra()
    forward, reverse = (robot.jacobian[mode](*robot.given, extra) for mode in ("forward", "reverse"))
    leaves = jax.tree.leaves(forward)
    assert len(leaves) == (8 if with_extra else 3)
    for mine, other in zip(leaves, jax.tree.leaves(reverse), strict=True):
        assert_close(mine, other, 1e-11)


def test_jacobians_are_finite_differences(robot):
    extra, h = changed(robot.n), 1e-5
    args = (*robot.given, extra)
    found = robot.jacobian["forward"](*args)
    flat, whole = ravel_pytree(extra)

    def slope(place, move):
        moved = [place(sign * move) for sign in (1, -1)]
        plus, minus = (robot.value["forward"](*m) for m in moved)
        return np.asarray(plus - minus) / (2 * h)

    for k in range(3):

        def place(move, k=k):
            return [x + move if i == k else x for i, x in enumerate(args[:3])] + [extra]

        slopes = [slope(place, h * e) for e in np.eye(robot.n)]
        assert_close(found[k], np.stack(slopes, -1), 1e-7)
    by_extra = np.concatenate(jax.tree.leaves(found[3]), -1)
    slopes = [slope(lambda move: [*robot.given, whole(flat + move)], h * e) for e in np.eye(len(flat))]
    assert_close(by_extra, np.stack(slopes, -1), 1e-7)


def test_nothing_extra_changes_nothing(robot):
    nothing = Extra(jnp.zeros(5), jnp.zeros(robot.n), jnp.asarray(robot.tables.gravity))
    found, expected = (robot.value["reverse"](*robot.given, extra) for extra in (nothing, Extra()))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_pinocchios_forward_mode_is_the_same():
    q, v, a = (x.reshape(2, 2, 6) for x in states(6, 4))
    tau, moved = 500 * a, [np.asarray(x) for x in np.random.default_rng(1).normal(size=(3, 7, 2, 2, 6))]

    def pushed(dynamics):
        def along(*tangents):
            return jax.jvp(jax.vmap(jax.vmap(dynamics)), (q, v, tau), tangents)

        return quick_jit(jax.vmap(along, out_axes=(None, 0)))(*moved)

    mine = pushed(forward_dynamics(KUKA, "forward"))
    theirs = pushed(pinocchio_dynamics.forward_dynamics(KUKA, "forward"))
    for found, expected in zip(mine, theirs, strict=True):
        assert_close(found, expected, 1e-10)


@pytest.mark.compiles
def test_any_order_of_axes_is_a_loop(tmp_path):
    """Tangents outside, between and inside the samples; torques that one of their axes lacks."""
    tables, _ = sample_arm("oblique", tmp_path)
    q, v, tau = (np.asarray(x).reshape(3, 4, 3) for x in states(3, 12))
    forward, moved = forward_dynamics(tables, "forward"), np.random.default_rng(2).normal(size=(5, 3))

    def along(q, v, tau, direction):
        return jax.jvp(lambda q: forward(q, v, tau), (q,), (direction,))[1]

    samples = [(0, 0, None, None), (0, 0, 0, None)]
    outside = jax.vmap(jax.vmap(jax.vmap(along, samples[0]), samples[1]), (None, None, None, 0))
    between = jax.vmap(jax.vmap(jax.vmap(along, samples[0]), (None, None, None, 0)), samples[1])
    inside = jax.vmap(jax.vmap(jax.vmap(along, (None, None, None, 0)), samples[0]), samples[1])
    orders = ((outside, (0, 1, 2, 3)), (between, (1, 0, 2, 3)), (inside, (2, 0, 1, 3)))
    found = [np.transpose(quick_jit(f)(q, v, tau[:, 0], moved), axes) for f, axes in orders]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-10)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-10)
    one = quick_jit(along)(q[2, 3], v[2, 3], tau[2, 0], moved[4])
    np.testing.assert_allclose(found[0][4, 2, 3], one, rtol=1e-9)


def test_a_linearised_step_pushes_as_the_step():
    physics = arm(derivatives="forward", coulomb_friction=0.0, integrator="euler")
    x, moved = np.full((3, 12), 0.1), np.random.default_rng(3).normal(size=(2, 3, 12))
    batched = jax.vmap(lambda x: physics.step(physics.params, x, jnp.full(6, 0.5)))

    def both(x, moved):
        _, push = jax.linearize(batched, x)
        return jax.vmap(push)(moved), jnp.stack([jax.jvp(batched, (x,), (one,))[1] for one in moved])

    np.testing.assert_allclose(*quick_jit(both)(x, moved), rtol=1e-12)


@pytest.mark.compiles
def test_forward_derivative_of_a_free_run_is_that_of_finite_differences():
    physics = arm(derivatives="forward", coulomb_friction=0.0)
    x0, u = np.concatenate([np.zeros(6), np.full(6, 0.2)]), np.full((3, 6), 0.3)

    def last(x, u):
        return jax.lax.scan(lambda x, u: (physics.step(physics.params, x, u), None), x, u)[0]

    check_grads(quick_jit(last), (x0, u), order=1, modes=["fwd"], rtol=1e-6, atol=1e-6)


def test_single_precision_stays_single():
    forward = forward_dynamics(KUKA, "forward")
    x = jax.ShapeDtypeStruct((5, 6), jnp.float32)
    extra = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, jnp.float32), changed(6))
    found = jax.eval_shape(jax.vmap(jax.jacfwd(forward, BY_ALL), (0, 0, 0, None)), x, x, x, extra)
    assert {leaf.dtype for leaf in jax.tree.leaves(found)} == {jnp.float32.dtype}
