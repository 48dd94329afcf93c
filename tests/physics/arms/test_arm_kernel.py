"""The C++ kernel of an arm's dynamics against Pinocchio and JAX: values, gradients, batches, what it leaves to JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arm_samples import KUKA, accelerations, sample_arm, states, with_rotor
from toys import quick_jit

from pgrssnn_jax.acceleration.native import missing_kernels
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.jax_dynamics import forward_dynamics

pytestmark = pytest.mark.skipif(missing_kernels() is not None, reason=f"no kernel: {missing_kernels()}")


def torques_of(tables, count, seed=0):
    """q, q̇ and torques that move the arm, `[count, n]`, in single precision."""
    q, v, tau = states(tables.n, count, seed)
    return tuple(jnp.asarray(a, jnp.float32) for a in (q, v, 50.0 * tau))


# batches: a part of a vector of 16 lanes, one whole, and several with a rest
@pytest.mark.parametrize("count", [1, 16, 45])
@pytest.mark.parametrize("name", ["kuka", "tree", "oblique"])
def test_accelerations_are_pinocchios(tmp_path, name, count):
    tables, model = with_rotor(*sample_arm(name, tmp_path)) if name != "kuka" else sample_arm(name, tmp_path)
    q, v, tau = torques_of(tables, count)
    found = jax.jit(jax.vmap(forward_dynamics(tables, native=True)))(q, v, tau)
    expected = accelerations(model, *(np.asarray(a, float) for a in (q, v, tau)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-4 * np.abs(expected).max())


@pytest.mark.parametrize("name", [pytest.param("kuka", marks=pytest.mark.compiles), "tree"])
def test_gradients_are_those_of_jax(tmp_path, name):
    tables, _ = sample_arm(name, tmp_path)
    args = torques_of(tables, 21)

    def gradient(native):
        forward = jax.vmap(forward_dynamics(tables, native=native))
        return quick_jit(jax.grad(lambda *a: jnp.sum(jnp.sin(forward(*a))), (0, 1, 2)))(*args)

    for found, expected in zip(gradient(True), gradient(False), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3 * np.abs(expected).max())


def test_axes_that_only_some_arguments_have_are_mapped():
    forward = forward_dynamics(KUKA, native=True)
    q, v, tau = torques_of(KUKA, 5)
    rows = jnp.stack([tau, 2.0 * tau])
    together = jax.jit(jax.vmap(jax.vmap(forward), (None, None, 0)))(q, v, rows)
    for found, one in zip(together, rows, strict=True):
        np.testing.assert_allclose(found, jax.vmap(forward)(q, v, one), rtol=1e-4, atol=1e-5)


def test_a_sample_that_is_not_finite_spoils_no_other():
    q, v, tau = torques_of(KUKA, 20)
    forward = jax.vmap(forward_dynamics(KUKA, native=True))
    found = np.asarray(forward(q.at[3, 1].set(jnp.nan).at[7, 0].set(jnp.inf), v, tau))
    assert not np.isfinite(found[[3, 7]]).all(1).any()
    np.testing.assert_array_equal(np.delete(found, [3, 7], 0), np.delete(forward(q, v, tau), [3, 7], 0))


def program(*args, native=True, extra=None):
    forward = forward_dynamics(KUKA, native=native)
    return str(jax.make_jaxpr(jax.vmap(lambda *a: forward(*a, extra or Extra())))(*args))


def test_the_kernel_leaves_to_jax_what_it_does_not_know():
    args = torques_of(KUKA, 4)
    assert "pgrssnn_arm" in program(*args)
    assert "pgrssnn_arm" not in program(*args, native=False)
    assert "pgrssnn_arm" not in program(*args, extra=Extra(gravity=jnp.array([0.0, 0.0, -1.6])))
    with jax.enable_x64(True):
        assert "pgrssnn_arm" not in program(*(jnp.asarray(a, float) for a in args))


def test_a_physics_takes_equal_steps_with_it_and_without():
    x, u = jnp.full((7, 12), 0.3), 2.0 * jnp.ones((7, 6))
    native, usual = (arm(backend=backend) for backend in ("native", "jax"))
    steps = [jax.jit(jax.vmap(p.step, (None, 0, 0)))(p.params, x, u) for p in (native, usual)]
    np.testing.assert_allclose(*steps, rtol=1e-4, atol=1e-5)
