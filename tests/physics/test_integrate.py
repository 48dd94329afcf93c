import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from toys import quick_jit

from pgrssnn_jax.physics.integrate import INTEGRATORS, zero_order_hold

X0, U, SPAN = np.array([0.9, -0.4]), np.array([0.7]), 1.5


def pendulum(p, x, u):
    """Damped pendulum with a torque: smooth, non-linear, not separable."""
    return jnp.stack([x[1], u[0] - p["damping"] * x[1] - jnp.sin(x[0])])


def pendulum_reference(x0, u, span):
    def field(t, x):
        return [x[1], u[0] - 0.3 * x[1] - np.sin(x[0])]

    return scipy.integrate.solve_ivp(field, (0, span), x0, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("integrator", "order"), [("euler", 1), ("rk4", 4), ("rosenbrock", 2)])
def test_error_falls_with_the_order_of_the_integrator(integrator, order):
    exact = pendulum_reference(X0, U, SPAN)
    steps = np.array([8, 16, 32, 64])
    errors = []
    for n in steps:
        step = zero_order_hold(pendulum, dt=SPAN, integrator=integrator, sub_steps=int(n))
        x = step({"damping": 0.3}, jnp.asarray(X0), jnp.asarray(U))
        errors.append(np.linalg.norm(x - exact))
    slope = np.polyfit(np.log(SPAN / steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.15)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("integrator", sorted(INTEGRATORS))
def test_sub_steps_are_shorter_steps_with_the_input_held(integrator):
    coarse = quick_jit(zero_order_hold(pendulum, dt=0.4, integrator=integrator, sub_steps=4))
    fine = quick_jit(zero_order_hold(pendulum, dt=0.1, integrator=integrator))
    p, x, u = {"damping": 0.3}, jnp.asarray(X0), jnp.asarray(U)
    expected = x
    for _ in range(4):
        expected = fine(p, expected, u)
    np.testing.assert_allclose(coarse(p, x, u), expected, rtol=1e-14)


def stiff(p, x, u):
    """Van der Pol's oscillator as stiff systems are tested: rates of 1 and of the order of p."""
    return jnp.stack([x[1], p["mu"] * ((1.0 - x[0] ** 2) * x[1]) - x[0] + u[0]])


@pytest.mark.usefixtures("x64")
def test_a_stiff_system_is_followed_with_steps_far_longer_than_its_fast_time():
    """0.05 s against 0.3 ms; the explicit methods leave the range."""
    mu, start, inputs = 1e3, np.array([2.0, 0.0]), np.zeros((40, 1))

    def field(t, x):
        return [x[1], mu * (1.0 - x[0] ** 2) * x[1] - x[0]]

    exact = scipy.integrate.solve_ivp(field, (0, 2.0), start, method="Radau", rtol=1e-10, atol=1e-12).y[:, -1]
    ends = {}
    for integrator in ("rosenbrock", "rk4"):
        step = zero_order_hold(stiff, dt=0.05, integrator=integrator)
        ends[integrator], _ = jax.lax.scan(lambda x, u, f=step: (f({"mu": mu}, x, u), None), jnp.asarray(start), inputs)
    np.testing.assert_allclose(ends["rosenbrock"], exact, rtol=1e-4)
    assert not np.allclose(ends["rk4"], exact, rtol=0.1)


@pytest.mark.usefixtures("x64")
def test_the_gradient_through_an_implicit_step_is_that_of_finite_differences():
    step = zero_order_hold(stiff, dt=0.1, integrator="rosenbrock")

    def end(x, mu):
        return step({"mu": mu}, x, jnp.zeros(1))[1]

    at, mu, h = np.array([1.3, 0.2]), 50.0, 1e-6
    run = quick_jit(jax.value_and_grad(end, (0, 1)))
    _, (by_x, by_mu) = run(at, mu)
    moved = [(run(at + e, mu)[0] - run(at - e, mu)[0]) / (2 * h) for e in h * np.eye(2)]
    np.testing.assert_allclose(by_x, moved, rtol=1e-6)
    np.testing.assert_allclose(by_mu, (run(at, mu + h)[0] - run(at, mu - h)[0]) / (2 * h), rtol=1e-5)


@pytest.mark.usefixtures("x64")
def test_euler_step_is_the_tangent():
    step = zero_order_hold(pendulum, dt=0.2, integrator="euler")
    slope = np.array([X0[1], U[0] - 0.3 * X0[1] - np.sin(X0[0])])
    np.testing.assert_allclose(step({"damping": 0.3}, jnp.asarray(X0), jnp.asarray(U)), X0 + 0.2 * slope, rtol=1e-15)


@pytest.mark.usefixtures("x64")
def test_linear_system_follows_the_matrix_exponential():
    a, b, dt = np.array([[-0.5, 1.0], [-2.0, -0.3]]), np.array([[0.4], [1.1]]), 0.8
    exact = scipy.linalg.expm(dt * np.block([[a, b], [np.zeros((1, 3))]]))
    expected = exact[:2, :2] @ X0 + exact[:2, 2:] @ U

    def field(p, x, u):
        return p["a"] @ x + p["b"] @ u

    one = zero_order_hold(field, dt=dt, integrator="rk4")
    many = zero_order_hold(field, dt=dt, integrator="rk4", sub_steps=256)
    p = {"a": a, "b": b}
    np.testing.assert_allclose(many(p, jnp.asarray(X0), jnp.asarray(U)), expected, rtol=1e-10)
    # on a linear system one RK4 step without input is the exponential's series up to the fourth power
    power, series = np.eye(2), np.eye(2)
    for k in range(1, 5):
        power = power @ (dt * a) / k
        series = series + power
    np.testing.assert_allclose(one(p, jnp.asarray(X0), jnp.zeros(1)), series @ X0, rtol=1e-13)


def test_step_keeps_single_precision_and_takes_an_integrator_of_ones_own():
    def heun(f, x, h):
        return x + h / 2 * (f(x) + f(x + h * f(x)))

    step = zero_order_hold(lambda p, x, u: -x, dt=0.5, integrator=heun)
    x = step({}, jnp.ones(1), jnp.zeros(1))
    assert x.dtype == jnp.float32
    np.testing.assert_allclose(x, 1 - 0.5 + 0.5**2 / 2, rtol=1e-6)


def test_sub_steps_are_differentiable_in_reverse():
    step = zero_order_hold(lambda p, x, u: -p * x, dt=0.5, integrator="euler", sub_steps=3)
    slope = jax.grad(lambda p: step(p, jnp.ones(1), jnp.zeros(1))[0])(0.9)
    h = 0.5 / 3
    np.testing.assert_allclose(slope, -3 * h * (1 - h * 0.9) ** 2, rtol=1e-5)


def test_bad_integrator_is_named():
    with pytest.raises(
        ValueError, match=r"integrator: expected one of \['euler', 'rk4', 'rk4_looped', 'rosenbrock'\], found 'rk5'"
    ):
        zero_order_hold(pendulum, dt=1.0, integrator="rk5")


@pytest.mark.parametrize("sub_steps", [0, -2])
def test_bad_sub_steps_are_named(sub_steps):
    with pytest.raises(ValueError, match=rf"sub_steps: expected at least 1, found {sub_steps}"):
        zero_order_hold(pendulum, dt=1.0, integrator="rk4", sub_steps=sub_steps)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("sub_steps", [1, 3])
def test_looped_stages_are_those_of_rk4_and_so_is_their_gradient(sub_steps):
    x, u = jnp.asarray(X0), jnp.asarray(U)
    found = []
    for integrator in ("rk4", "rk4_looped"):
        step = zero_order_hold(pendulum, dt=0.4, integrator=integrator, sub_steps=sub_steps)
        both = quick_jit(lambda *given, step=step: (step(*given), jax.jacrev(step, (0, 1, 2))(*given)))
        found.append(both({"damping": 0.3}, x, u))
    for plain, looped in zip(*map(jax.tree.leaves, found), strict=True):
        np.testing.assert_allclose(looped, plain, rtol=1e-13, atol=1e-15)
