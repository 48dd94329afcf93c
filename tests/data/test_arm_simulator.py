"""The simulated arm: plans, torques, limits and noise are what they are said to be."""

import itertools

import numpy as np
import pinocchio as pin
import pytest

from pgrssnn_jax.data.arm_simulator import SAMPLE_TIME, ArmSimulator, planned, simulate, simulated_arm, torque
from pgrssnn_jax.physics.arms.tables import described, pinocchio_model

TABLES = described("kuka_kr300", "reference")
PLAIN = ArmSimulator(memory=(0.0,) * 6, theta=(0.0,) * 6, spread=0.0, noise=0.0)
KNOWN = ArmSimulator(spread=0.0, noise=0.0)


@pytest.fixture(scope="module")
def arm():
    return simulated_arm(0, 12, 606, 2)


@pytest.fixture(scope="module")
def plan():
    return planned(np.random.default_rng(0).spawn(2)[0], TABLES, 12, 606)


def free_run(u, simulator):
    return simulate(TABLES, u, np.zeros_like(u), simulator)


def score(predicted, y):
    """NRMSE, mean over the joints."""
    return np.mean(np.sqrt(np.mean((predicted - y) ** 2, (0, 1))) / y.std((0, 1)))


def test_plans_are_at_rest_at_both_ends(plan):
    for signal, scale in zip(plan, (1e-3, 1e-2, 1e-1), strict=True):
        assert np.abs(signal[:, [0, -1]]).max() < scale * np.abs(signal).max()


def test_velocity_and_acceleration_are_the_derivatives_of_the_position(plan):
    for value, rate in itertools.pairwise(plan):
        slope = (value[:, 2:] - value[:, :-2]) / (2 * SAMPLE_TIME)
        np.testing.assert_allclose(slope, rate[:, 1:-1], atol=0.03 * np.abs(rate).max())


@pytest.mark.parametrize("samples", [1, 2, 20, 606])
def test_plans_keep_within_the_limits(samples):
    plan = planned(np.random.default_rng(1), TABLES, 30, samples)
    assert plan.q.shape == (30, samples, 6)
    assert np.all((plan.q > TABLES.position_min) & (plan.q < TABLES.position_max))
    assert np.all(np.abs(plan.v) < TABLES.velocity_max)


def test_plans_are_as_lively_as_the_measured_motion():
    plan = planned(np.random.default_rng(1), TABLES, 72, 605)
    np.testing.assert_allclose(plan.q.std((0, 1)), [0.39, 0.16, 0.40, 0.66, 0.40, 0.66], rtol=0.3)
    np.testing.assert_allclose(plan.v.std((0, 1)), [0.213, 0.085, 0.19, 0.315, 0.204, 0.336], rtol=0.3)
    np.testing.assert_allclose(plan.a.std((0, 1)), [0.160, 0.063, 0.138, 0.225, 0.149, 0.248], rtol=0.3)


def test_torques_are_as_large_as_the_published_ones(arm):
    np.testing.assert_allclose(arm.u.std((0, 1)), [1.11, 4.87, 3.44, 0.76, 0.73, 0.67], rtol=0.3)


def test_the_torque_accelerates_the_arm_as_planned(plan):
    """Forward dynamics, with friction, takes the torque back to the planned acceleration."""
    model = pinocchio_model(TABLES)
    data, u = model.createData(), torque(TABLES, plan)
    for seq, t in ((0, 0), (3, 100), (7, 300), (11, 605)):
        q, v, a = (signal[seq, t] for signal in plan)
        lost = TABLES.gear**2 * TABLES.viscous * v + TABLES.gear * TABLES.coulomb * np.sign(v)
        np.testing.assert_allclose(pin.aba(model, data, q, v, TABLES.gear * u[seq, t] - lost), a, atol=1e-9)


def test_without_unknown_effects_the_arm_follows_its_plan_for_a_while(plan):
    q = free_run(torque(TABLES, plan), PLAIN)
    # A sample after the middle of sample t is the middle of what its end and the next one's are apart.
    middle = (q[:, :100] + np.concatenate([np.zeros_like(q[:, :1]), q[:, :99]], axis=1)) / 2
    assert np.sqrt(np.mean((middle - plan.q[:, :100]) ** 2)) < 0.1


PUSHED = np.broadcast_to(np.array([9.0, 30.0, 20.0, 3.0, 4.0, 3.0]), (1, 80, 6))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_true_positions_keep_within_the_limits(sign):
    q = free_run(sign * PUSHED, ArmSimulator())
    assert np.all((q >= TABLES.position_min) & (q <= TABLES.position_max))
    assert np.any((q == TABLES.position_min) | (q == TABLES.position_max))


def test_velocities_are_limited_after_every_sample():
    free = TABLES._replace(position_min=np.full(6, -np.inf), position_max=np.full(6, np.inf))
    fast, limited = (
        np.abs(np.diff(simulate(tables, PUSHED, np.zeros_like(PUSHED), PLAIN), axis=1)).max((0, 1)) / SAMPLE_TIME
        for tables in (free._replace(velocity_max=np.full(6, np.inf)), free)
    )
    # Within a sample a joint accelerates beyond its limit.
    assert np.all(limited < 2 * TABLES.velocity_max)
    assert np.all(fast > 1.2 * limited)


def test_the_arm_starts_at_rest_at_zero(arm):
    # What the first sample's torque moves the joint by, because friction is zero at zero velocity.
    assert np.abs(arm.q[:, :, 0]).max() < 0.02


def test_memory_acts_on_the_velocity_a_sample_before(plan):
    """The arm starts at rest, so memory first changes the second sample's velocity, and the third's position."""
    u = torque(TABLES, plan)[:1, :3]
    still, moving = (free_run(u, PLAIN._replace(memory=(m,) * 6)) for m in (0.0, 0.1))
    np.testing.assert_array_equal(still[:, :2], moving[:, :2])
    assert not np.array_equal(still[:, 2], moving[:, 2])


def test_the_noise_is_white_independent_and_of_the_right_size(arm):
    noise = (arm.y - arm.q).reshape(2, 12, 606, 6)
    np.testing.assert_allclose(noise.std((1, 2)), 0.1, rtol=0.05)
    assert np.abs(noise.mean((1, 2))).max() < 0.006
    first, second = noise
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(first[:, 1:].ravel(), first[:, :-1].ravel())[0, 1]) < 0.02
    assert np.abs(np.corrcoef(np.moveaxis(first, 1, 0).reshape(606, -1).T) - np.eye(72)).max() < 0.2


def test_realisations_differ_in_their_true_motion_as_the_published_ones_do(arm):
    spread = np.sqrt(np.mean((arm.q[0] - arm.q[1]) ** 2, (0, 1)) / 2)
    published = np.array([0.0142, 0.0086, 0.0052, 0.1172, 0.0389, 0.0713])
    assert np.all((spread > published / 6) & (spread < 3 * published))


def test_the_physics_explains_as_much_as_of_the_published_data(arm):
    y = arm.y[0]
    assert score(free_run(arm.u, KNOWN), y) == pytest.approx(0.33, rel=0.4)
    assert score(free_run(arm.u, KNOWN._replace(theta=PLAIN.theta)), y) == pytest.approx(0.52, rel=0.4)
    assert score(free_run(arm.u, PLAIN), y) == pytest.approx(0.81, rel=0.4)


def test_same_seed_same_arm():
    first, second, other = (simulated_arm(seed, 2, 30, 2) for seed in (0, 0, 1))
    for a, b, c in zip(first, second, other, strict=True):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)


@pytest.mark.parametrize(("sequences", "realisations"), [(1, 1), (1, 3), (5, 2)])
def test_less_is_a_part_of_more(sequences, realisations):
    less, more = simulated_arm(4, sequences, 40, realisations), simulated_arm(4, 5, 40, 3)
    np.testing.assert_array_equal(less.u, more.u[:sequences])
    np.testing.assert_array_equal(less.q, more.q[:realisations, :sequences])
    np.testing.assert_array_equal(less.y, more.y[:realisations, :sequences])
