import threading
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pinocchio as pin
import pytest
from arm_samples import KUKA, sample_arm, states
from jax.sharding import Mesh, PartitionSpec
from jax.test_util import check_grads
from toys import quick_jit

from pgrssnn_jax.physics.arms import jax_dynamics, pinocchio_dynamics
from pgrssnn_jax.physics.arms.pinocchio_dynamics import forward_dynamics
from pgrssnn_jax.physics.arms.tables import pinocchio_model
from pgrssnn_jax.physics.integrate import rk4_looped

KEEPS = forward_dynamics(KUKA)


def given(*shape, seed=0):
    """q, q̇, τ `[*shape, 6]`; torques of the arm's size."""
    q, v, a = (x.reshape(*shape, 6) for x in states(6, int(np.prod(shape)), seed))
    return q, v, 500.0 * a


def value_and_pull(forward):
    def both(q, v, tau, a_bar):
        a, back = jax.vjp(forward, q, v, tau)
        return a, *back(a_bar)

    return both


@pytest.fixture
def counted(monkeypatch):
    """Batch sizes of Pinocchio's calls."""
    sizes, real = [], pin.abaInParallel

    def count(threads, pool, q, v, tau):
        sizes.append(q.shape[1])
        return real(threads, pool, q, v, tau)

    monkeypatch.setattr(pin, "abaInParallel", count)
    return sizes


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", [pytest.param("kuka", marks=pytest.mark.compiles), "tree"])
def test_both_backends_agree_with_their_derivatives(tmp_path, name):
    tables, _ = sample_arm(name, tmp_path)
    args = (*given(4, 5), states(6, 20, seed=5)[2].reshape(4, 5, 6))
    mapped = [
        quick_jit(jax.vmap(jax.vmap(value_and_pull(backend.forward_dynamics(tables)))))
        for backend in (jax_dynamics, pinocchio_dynamics)
    ]
    for found, expected in zip(mapped[0](*args), mapped[1](*args), strict=True):
        assert found.dtype == expected.dtype == np.float64
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.mark.usefixtures("x64")
def test_batch_of_any_shape_is_a_loop():
    q, v, tau = given(3, 4)
    model = pinocchio_model(KUKA)
    data = model.createData()
    expected = np.array(
        [[pin.aba(model, data, q[i, j], v[i, j], tau[i, j]).copy() for j in range(4)] for i in range(3)]
    )
    one, both = jax.vmap(KEEPS), jax.vmap(jax.vmap(KEEPS))
    for mapped, part in ((both, np.s_[:]), (one, np.s_[1]), (KEEPS, np.s_[1, 2]), (one, np.s_[:1, 2])):
        np.testing.assert_allclose(jax.jit(mapped)(q[part], v[part], tau[part]), expected[part], rtol=1e-10)


@pytest.mark.usefixtures("x64")
def test_arguments_that_some_axes_lack_are_shared():
    q, v, tau = given(3, 4)
    found = jax.jit(jax.vmap(jax.vmap(KEEPS, (None, 0, None)), (0, None, 0)))(q[:, 0], v[0], tau[:, 0])
    whole = jax.jit(jax.vmap(jax.vmap(KEEPS)))
    expected = whole(*(np.broadcast_to(x, q.shape) for x in (q[:, :1], v[:1], tau[:, :1])))
    np.testing.assert_array_equal(found, expected)


def test_one_host_call_per_batch(counted):
    args = [jnp.asarray(x, jnp.float32) for x in given(4, 5)]
    jax.block_until_ready(jax.jit(jax.vmap(jax.vmap(KEEPS)))(*args))
    assert counted == [20]


def test_one_host_call_per_step_of_a_scan(counted):
    q, v, tau = (jnp.asarray(x, jnp.float32) for x in given(5))

    def move(x, _):
        return x + 1e-3 * jax.vmap(KEEPS)(x, v, tau), None

    jax.block_until_ready(jax.jit(lambda q: jax.lax.scan(move, q, length=7)[0])(q))
    assert counted == [5] * 7


def test_value_and_derivative_come_from_one_host_call(counted, monkeypatch):
    calls, real = [], pin.computeABADerivatives
    monkeypatch.setattr(pin, "computeABADerivatives", lambda *args: (calls.append(1), real(*args)))
    both = jax.vmap(jax.vmap(value_and_pull(KEEPS)))
    args = [jnp.asarray(x, jnp.float32) for x in (*given(2, 3), np.ones((2, 3, 6)))]
    assert str(jax.make_jaxpr(both)(*args)).count("pure_callback[") == 1
    jax.block_until_ready(jax.jit(both)(*args))
    assert (len(calls), counted) == (6, [])


@pytest.mark.usefixtures("x64")
def test_gradient_through_a_rollout_is_that_of_finite_differences():
    q, v, tau = (x[0] for x in given(1))

    def slope(x, tau):
        return jnp.concatenate([x[6:], KEEPS(x[:6], x[6:], tau)])

    def last(x, tau):
        return jax.lax.scan(lambda x, _: (rk4_looped(partial(slope, tau=tau), x, 0.02), None), x, length=5)[0]

    check_grads(jax.jit(last), (np.concatenate([q, v]), tau / 500), order=1, modes=["rev"], rtol=1e-4, atol=1e-4)


@pytest.mark.usefixtures("x64")
def test_single_precision_is_computed_in_double_and_rounded_once():
    single = [np.asarray(x, np.float32) for x in given(50)]
    mapped = jax.jit(jax.vmap(KEEPS))
    found, double = mapped(*single), mapped(*(x.astype(np.float64) for x in single))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.asarray(double).astype(np.float32))


def test_double_precision_survives_a_callback_thread_without_it():
    """`jax.enable_x64` is a setting of this thread; the callback may run in another."""
    q, v, tau = given(2)
    with jax.enable_x64(True):
        found = jax.jit(jax.vmap(KEEPS))(q, v, tau)
        shifted = jax.jit(jax.vmap(KEEPS))(q + 1e-12, v, tau)
    assert found.dtype == np.float64
    assert np.all(np.asarray(found) != np.asarray(shifted))


def test_two_devices_call_at_the_same_time():
    mesh = Mesh(np.array(jax.devices()[:2]), ("member",))
    split = PartitionSpec("member")
    args = [jnp.asarray(x, jnp.float32) for x in (*given(2, 3), np.ones((2, 3, 6)))]

    def run(q, v, tau, a_bar):
        def move(q, _):
            a, *back = jax.vmap(jax.vmap(value_and_pull(KEEPS)))(q, v, tau, a_bar)
            return q + 1e-3 * jnp.tanh(a), back[0]

        return jax.lax.scan(move, q, length=20)[0]

    sharded = jax.shard_map(run, mesh=mesh, in_specs=(split,) * 4, out_specs=split, check_vma=False)
    np.testing.assert_array_equal(jax.jit(sharded)(*args), jax.jit(run)(*args))


@pytest.mark.usefixtures("x64")
def test_double_precision_survives_the_callbacks_of_two_devices():
    """Each device calls from a thread of its own, in which 64-bit numbers are switched off."""
    mesh, split = Mesh(np.array(jax.devices()[:2]), ("member",)), PartitionSpec("member")
    args, mapped = given(4), jax.vmap(KEEPS)
    sharded = jax.shard_map(mapped, mesh=mesh, in_specs=(split,) * 3, out_specs=split, check_vma=False)
    np.testing.assert_array_equal(jax.jit(sharded)(*args), jax.jit(mapped)(*args))


def test_two_threads_call_at_the_same_time():
    q, v, tau = (jnp.asarray(x, jnp.float32) for x in given(30))
    mapped = jax.jit(jax.vmap(KEEPS))
    expected, wrong = np.asarray(mapped(q, v, tau)), []

    def work(device):
        args = jax.device_put((q, v, tau), device)
        for _ in range(50):
            if not np.array_equal(mapped(*args), expected):
                wrong.append(device)

    threads = [threading.Thread(target=work, args=(device,), daemon=True) for device in jax.devices()[:2]]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)
    assert not wrong


def test_one_bad_sample_spoils_no_other():
    q, v, tau = (x.astype(np.float32) for x in given(3))
    mapped = jax.jit(jax.vmap(value_and_pull(KEEPS)))
    expected = mapped(q, v, tau, tau)
    q[1] = np.nan
    for found, right in zip(mapped(q, v, tau, tau), expected, strict=True):
        assert np.isnan(found[1]).any()
        np.testing.assert_array_equal(np.asarray(found)[::2], np.asarray(right)[::2])


def test_accelerations_beyond_single_precision_are_infinite_without_a_warning():
    """A state that leaves the floating-point range is data."""
    q, v, tau = (x.astype(np.float32) for x in given(2))
    v[1] = 1e30
    found = np.asarray(jax.jit(jax.vmap(KEEPS))(q, v, tau))
    assert np.isfinite(found[0]).all()
    assert not np.isfinite(found[1]).any()


def test_empty_batch_has_no_accelerations():
    args = [jnp.zeros((0, 6), jnp.float32)] * 3
    assert jax.jit(jax.vmap(KEEPS))(*args).shape == (0, 6)
