"""The filter is Kalman's where an arm is linear, and its friction is that of a random speed."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from arm_samples import PENDULUM, urdf
from toys import quick_jit

import pgrssnn_jax as pg
from pgrssnn_jax.physics.arms.filter import linearised
from pgrssnn_jax.physics.arms.motion_prior import FilterNumbers, motion, starting
from pgrssnn_jax.physics.base import extension_of
from pgrssnn_jax.physics.simulate import free_run, simulated_states

pytestmark = pytest.mark.usefixtures("x64")
DT = 0.05
NUMBERS = {
    "mean": 0.1, "position": 0.5, "speed": 0.6, "acceleration": 1.1, "moving": 0.3, "resting": 1e-6, "noise": 0.02,
    "slow": 1e-6, "damping": 0.7, "time": 2.0,
}  # fmt: skip
SEVEN = FilterNumbers(
    mean=np.linspace(-1, 1, 7), position=np.linspace(0.2, 0.8, 7), speed=np.linspace(0.4, 0.5, 7),
    acceleration=np.linspace(1.5, 0.6, 7), moving=np.ones(7), resting=np.full(7, 2.0), noise=np.ones(7),
    slow=np.full(7, 0.02), damping=np.asarray(0.8), time=np.asarray(3.0),
)  # fmt: skip


def continuous_motion(numbers: dict[str, float]) -> tuple[np.ndarray, float]:
    """A, and the power of the noise on q⃛."""
    stiff = (numbers["speed"] / numbers["position"]) ** 2
    inert = (numbers["acceleration"] / numbers["speed"]) ** 2
    c = numbers["damping"]
    return np.array([[0, 1, 0], [0, 0, 1], [-c * stiff, -inert, -c]]), 2 * c * numbers["speed"] ** 2 * (inert - stiff)


def in_one_step(numbers: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Van Loan's way."""
    a, power = continuous_motion(numbers)
    whole = np.block([[-a, np.diag([0, 0, power])], [np.zeros((3, 3)), a.T]]) * DT
    grown = scipy.linalg.expm(whole)
    f = grown[3:, 3:].T
    return f, f @ grown[:3, 3:]


def pendulum(folder, **settings):
    nominal = pg.physics.arm(
        urdf=urdf(folder, PENDULUM), gravity=(0.0, 0.0, 0.0), gear_ratio=5.0, limits=False, dt=DT, **settings
    )
    return nominal, nominal.variant(form="filter", filter_numbers=NUMBERS)


def test_the_motion_is_right_where_a_joint_swings_fast():
    """A radian and a half from one sample to the next."""
    fast = {**NUMBERS, "speed": 14.0, "position": 0.7, "acceleration": 420.0}
    f, q = in_one_step(fast)
    numbers = FilterNumbers(**{name: jnp.asarray([value]) for name, value in fast.items()})
    numbers = numbers._replace(damping=jnp.asarray(0.7), time=jnp.asarray(2.0))
    kernel, noise = quick_jit(lambda numbers: motion(numbers, DT))(numbers)
    np.testing.assert_allclose(kernel[0], f, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(noise[0], q, rtol=1e-3, atol=1e-9)


@cache
def of_seven():
    """What the motion of all joints becomes in one step, what is added on the way, and the covariance at the start."""
    found = quick_jit(lambda numbers: (*motion(numbers, DT), starting(numbers, at_rest=False)))(SEVEN)
    return [np.asarray(part) for part in found]


@pytest.mark.parametrize("joint", range(7))
def test_the_motion_is_that_of_the_equation_and_stationary(joint):
    numbers = {name: float(np.broadcast_to(value, (7,))[joint]) for name, value in SEVEN._asdict().items()}
    f, q = in_one_step(numbers)
    kernels, noises, start = of_seven()
    kernel, noise = kernels[joint], noises[joint]
    np.testing.assert_allclose(kernel, f, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(noise, q, rtol=1e-5, atol=1e-15)
    places = np.array([joint, 7 + joint, 14 + joint])
    whole = start[np.ix_(places, places)]
    np.testing.assert_allclose(kernel @ whole @ kernel.T + noise, whole, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(whole)), [numbers[k] for k in ("position", "speed", "acceleration")])


def test_a_linear_arm_is_filtered_as_kalman_did(tmp_path):
    nominal, filtered = pendulum(tmp_path, viscous_friction=0.03)
    gear, friction, points = 5.0, 0.03, extension_of(nominal).points
    one, none = jnp.ones((1, 1)), jnp.zeros((1, 1))
    required = quick_jit(lambda a: points.inverse(nominal.params, none, none, a, points.masses(nominal.params)))(one)
    inertia = float(required[0, 0])
    f, q = in_one_step(NUMBERS)
    kept = np.exp(-DT / NUMBERS["time"])
    f = scipy.linalg.block_diag(f, kept)
    q = scipy.linalg.block_diag(q, (1 - kept**2) * NUMBERS["moving"] ** 2)
    h = np.array([0.0, gear * friction, inertia / gear, 1.0])
    u = np.cumsum(np.random.default_rng(0).normal(size=80)) * 0.05
    z, cov, expected = np.zeros(4), np.diag([0, 0, 0, NUMBERS["moving"] ** 2]), []
    mean = np.array([NUMBERS["mean"], 0, 0, 0])
    for now in u:
        gain = cov @ h / (h @ cov @ h + NUMBERS["noise"] ** 2)
        z, cov = z + gain * (now - h @ z), cov - np.outer(gain, h @ cov)
        z, cov = mean + f @ (z - mean), f @ cov @ f.T + q
        expected.append(z)
    y, x = free_run(filtered, u[None, :, None], np.zeros((1, len(filtered.states))))
    np.testing.assert_allclose(x[0, :, :4], expected, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(y[0, :, 0], np.asarray(expected)[:, 0], rtol=1e-5, atol=1e-8)
    last = np.zeros((4, 4))
    last[np.tril_indices(4)] = np.asarray(x)[0, -1, 4:]
    start = np.diag([0, 0, 0, NUMBERS["moving"] ** 2])
    np.testing.assert_allclose(np.tril(last), np.tril(cov - start), rtol=1e-5, atol=1e-8)


@pytest.fixture(scope="module")
def unsure_friction(tmp_path_factory):
    """Of a motion, the spread of its speed, and a torque."""
    with jax.enable_x64(True):
        nominal, _ = pendulum(tmp_path_factory.mktemp("robot"), viscous_friction=0.02, coulomb_friction=0.4)
    points = extension_of(nominal).points
    return quick_jit(lambda at, spread, u: linearised(points, nominal.params, DT, at, spread, u))


@pytest.mark.parametrize("speed", [-0.5, -0.02, 0.0, 0.1, 1.0])
def test_friction_of_an_unsure_speed_is_its_mean_with_its_variance(unsure_friction, speed):
    spread = 0.15
    given = (np.array([0.2, speed, 0.3]), np.array([spread]), np.array([0.7]))
    error, slope, unsure = (np.asarray(part) for part in unsure_friction(*given))
    drawn = speed + spread * np.random.default_rng(1).normal(size=400_000)
    inertia = -float(slope[0, 2]) * 5.0
    torque = 0.7 * 5.0 - 25 * 0.02 * drawn - 5 * 0.4 * np.sign(drawn) - inertia * 0.3
    wrong = torque / 5.0
    by_speed = np.cov(wrong, drawn)[0, 1] / np.var(drawn)
    assert error[0] == pytest.approx(wrong.mean(), abs=3e-3)
    assert slope[0, 1] == pytest.approx(by_speed, abs=3e-2)
    left = np.var(wrong - by_speed * (drawn - speed))
    assert unsure[0] == pytest.approx(left, abs=0.05 * np.var(0.4 * np.sign(drawn)) + 2e-3)


def test_what_a_filter_needs_is_said(tmp_path):
    file = urdf(tmp_path, PENDULUM)
    with pytest.raises(ValueError, match=r"physics.filter_numbers: expected mean, .*, found none"):
        pg.physics.arm(urdf=file, form="filter")
    with pytest.raises(ValueError, match=r"physics.filter_numbers: expected mean, .*, found mean"):
        pg.physics.arm(urdf=file, form="filter", filter_numbers={"mean": 0.0})
    with pytest.raises(ValueError, match=r"physics.filter_numbers.speed: expected one number or 1"):
        pg.physics.arm(urdf=file, form="filter", filter_numbers={**NUMBERS, "speed": [1.0, 2.0]})
    with pytest.raises(ValueError, match=r"physics.filter_numbers.time: expected one number, found \[1.0, 2.0\]"):
        pg.physics.arm(urdf=file, form="filter", filter_numbers={**NUMBERS, "time": [1.0, 2.0]})
    with pytest.raises(ValueError, match=r"expected speed² below position x acceleration, found more at swing_joint"):
        pg.physics.arm(urdf=file, form="filter", filter_numbers={**NUMBERS, "position": 0.1})
    with pytest.raises(ValueError, match=r"filter.speed: expected 1e-09 to inf rad/s, found"):
        pg.physics.arm(urdf=file, form="filter", filter_numbers={**NUMBERS, "speed": 0.0})
    with pytest.raises(ValueError, match=r"physics.backend: expected jax"):
        pg.physics.arm(urdf=file, form="filter", filter_numbers=NUMBERS, backend="pinocchio")


@pytest.mark.slow
def test_the_numbers_can_be_trained(tmp_path):
    """Through friction, whose jump the filter has smoothed."""
    _, filtered = pendulum(tmp_path, viscous_friction=0.03, coulomb_friction=0.1)
    u = jnp.asarray(np.cumsum(np.random.default_rng(0).normal(size=(1, 15, 1)), 1) * 0.2)
    start = jnp.zeros((1, len(filtered.states)))

    @jax.jit
    def loss(numbers):
        params = {**filtered.params, "filter": numbers}
        return jnp.sum(simulated_states(filtered.step, params, start, u)[..., 0] ** 2)

    at = jax.tree.map(jnp.asarray, filtered.params["filter"])
    slopes = jax.jit(jax.grad(loss))(at)
    for name, value in at.items():
        step = 1e-5 * max(1e-2, float(jnp.abs(value).max()))
        above, below = (loss({**at, name: value + sign * step}) for sign in (1, -1))
        by_hand = float(above - below) / (2 * step)
        assert float(jnp.sum(slopes[name])) == pytest.approx(by_hand, rel=1e-3, abs=1e-7), name
