"""Torque errors and their derivatives against Pinocchio and finite differences."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import scipy
from arm_logs import DT, KUKA, log

from pgrssnn_jax.discovery.inverse.evidence import SMOOTHED, Torques, fastest_of, judged, samples_of, torques
from pgrssnn_jax.discovery.inverse.fit import Tangent, _scaled, _settled, _solved, _sums, fitted, gain
from pgrssnn_jax.discovery.inverse.motion import motion_of, thinned
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.arms.build import arm

pytestmark = pytest.mark.usefixtures("x64")
NOT_SEEN = {"joint_limit", "stiction"}


@pytest.fixture(scope="module")
def physics():
    return arm(derivatives="forward", gravity=tuple(KUKA.gravity))


@pytest.fixture(scope="module")
def judging(physics):
    """A problem with every effect that is judged, and its torques, whose programs are compiled once."""
    with jax.enable_x64(True):
        problem = build_problem(physics, judged(physics, catalogue(physics)), accelerate=False)
        return problem, torques(problem)


def some(record):
    motion = motion_of(record, DT, at_rest=False, shift=1.0)
    return samples_of(thinned(motion, motion.v.shape[1] * len(motion.v) // 40), fastest_of(motion))


def test_what_is_no_torque_is_not_judged(physics):
    names = {effect.name for effect in catalogue(physics)}
    assert {effect.name for effect in judged(physics, catalogue(physics))} == names - NOT_SEEN


def test_a_true_model_leaves_the_noise_of_the_torques(judging):
    problem, model = judging
    samples = some(log(0, torque_noise=0.02, noise=0.0))
    error = model.errors(problem.theta, samples)[samples.moving]
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_what_a_step_adds_to_a_velocity_is_no_work_of_the_torques(judging):
    """Velocities jump by S times the one before in every sample; positions are read, and differences taken."""
    problem, model = judging
    share, time = np.linspace(-0.2, 0.05, KUKA.n), DT * np.arange(43)[:, None]
    pushed = np.sin(time * np.linspace(0.5, 1.0, KUKA.n) + np.arange(KUKA.n))  # rad/s²
    q, v = np.zeros((44, KUKA.n)), np.zeros((44, KUKA.n))
    for k, a in enumerate(pushed):
        q[k + 1] = q[k] + DT * v[k] + DT**2 / 2 * a
        v[k + 1] = v[k] + DT * a + share * v[k]
    reading, speed = q[1:-1].T, (q[2:] - q[:-2]).T / (2 * DT)
    found, true = np.diff(q, 2, axis=0).T / DT**2, (pushed[1:] + pushed[:-1]).T / 2
    samples = some(log(2))._replace(reading=reading, v=speed, torque=np.zeros_like(reading))

    def errors(numbers, acceleration):
        theta = problem.put(problem.theta, "velocity_disturbance", {"S": numbers})
        return model.errors(theta, samples._replace(a=acceleration))

    right, seen, not_seen = errors(0 * share, true), errors(share, found), errors(0 * share, found)
    assert np.abs(seen - right).max() < 0.02 * np.abs(not_seen - right).max()


def test_joints_of_an_unknown_direction_do_not_count():
    motion = motion_of(log(0, noise=0.02), DT, at_rest=False, shift=1.0)
    samples = samples_of(motion, fastest_of(motion))
    true = motion_of(log(0, noise=0.0), DT, at_rest=False, shift=1.0, cutoff=motion.cutoff, edge=_lost(motion))
    right = np.sign(samples.v) == np.sign(true.v.reshape(-1, KUKA.n).T)
    assert not samples.moving.all()
    assert right[samples.moving].mean() > 0.997  # three standard deviations
    assert right[~samples.moving].mean() < 0.97


def test_torques_at_rest_change_no_number(judging):
    problem, model = judging
    samples = some(log(0))
    draw = np.random.default_rng(0)
    samples = samples._replace(moving=samples.moving & (draw.uniform(size=samples.moving.shape) < 0.7))
    other = samples._replace(torque=np.where(samples.moving, samples.torque, 100.0 * draw.normal(size=(KUKA.n, 1))))
    places = np.concatenate([problem.of("viscous_friction"), problem.of("torque_bias")])
    one, same = (fitted(model, data, problem.theta, places, np.ones(KUKA.n), 5) for data in (samples, other))
    np.testing.assert_allclose(same.theta[places], one.theta[places], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(same.left_out[samples.moving], one.left_out[samples.moving], rtol=1e-9, atol=1e-9)


def test_what_is_left_out_of_a_nonlinear_fit_is_predicted_by_a_fit_to_the_others(judging):
    """Zeros of encoders, half a radian off, against refits by SciPy."""
    problem, model = judging
    samples, folds = some(log(0, home=0.5, noise=0.0, torque_noise=0.5)), 5
    places = problem.of("home_offset")[1:]  # that of the first joint turns the arm about gravity
    found = fitted(model, samples, problem.theta, places, np.ones(KUKA.n), folds)
    for fold in range(folds):
        part = samples.block % folds == fold

        def weighted(numbers, rest=~part):
            theta = problem.theta.copy()
            theta[places] = numbers
            return (np.sqrt(found.weight) * model.errors(theta, samples))[:, rest].ravel()

        theta = problem.theta.copy()
        theta[places] = scipy.optimize.least_squares(weighted, found.theta[places]).x
        expected = (np.sqrt(found.weight) * model.errors(theta, samples))[:, part]
        predicted = (np.sqrt(found.weight) * found.left_out)[:, part]
        assert (predicted**2).mean() == pytest.approx((expected**2).mean(), rel=0.05)


class Bent(Torques):
    """Errors arctan(x) + noise of a single number x: from far away a whole step of Gauss-Newton overshoots."""

    def errors(self, theta, samples):
        return np.arctan(theta[:1])[:, None] + samples.torque

    def linearised(self, theta, samples, places):
        slope = 1.0 / (1.0 + theta[:1] ** 2)
        return self.errors(theta, samples), np.broadcast_to(slope, (len(places), *samples.torque.shape)).copy()


def test_a_fold_is_predicted_from_its_own_optimum_also_where_steps_are_shortened(judging):
    problem, model = judging
    noise = np.random.default_rng(0).normal(0.0, 0.1, (1, 50))
    samples = some(log(0))._replace(torque=noise)
    wide = np.full(len(problem.theta), np.inf)
    free = replace(problem, precision=np.zeros(len(wide)), low=-wide, high=wide)
    bent, theta, place = Bent(free, model.moves, model.scales, model._linearised), problem.theta.copy(), np.array([0])
    theta[0] = 2.0
    at, weight = Tangent(theta, place, *bent.linearised(theta, samples, place)), np.ones(noise.shape)
    first = _solved(free, at, *_sums(*_scaled(at, weight)))
    assert np.abs(np.arctan(theta[0] + first)).mean() > np.arctan(2.0), "the step overshoots"
    np.testing.assert_allclose(_settled(bent, samples, at, first, weight), noise - noise.mean(), atol=2e-3)


def test_slow_joints_count_as_at_rest():
    motion = motion_of(log(0), DT, at_rest=False)
    samples = samples_of(motion, fastest_of(motion), SMOOTHED)
    assert (samples.slow >= SMOOTHED).all()
    np.testing.assert_array_equal(samples.moving, np.abs(samples.v) > samples.slow[:, None])
    assert samples.moving.sum() < samples_of(motion, fastest_of(motion)).moving.sum()


def test_samples_at_rest_choose_nothing():
    motion = motion_of(log(0), DT, at_rest=False)
    samples = samples_of(motion, fastest_of(motion))
    error = np.random.default_rng(0).normal(size=samples.v.shape)
    fewer, kappa = np.where(samples.moving, error, 0.5 * error), np.ones(len(error))
    assert not samples.moving.all()
    assert gain(error, fewer, samples, kappa).value == 0.0
    assert gain(error, 0.5 * error, samples, kappa).clear(3.0)
    still = samples._replace(moving=np.zeros_like(samples.moving))
    assert gain(error, 0.5 * error, still, kappa).value == 0.0


def _lost(motion):
    return (300 - motion.v.shape[1]) // 2


def where_everything_acts(problem):
    """Numbers at which every effect acts."""
    rng = np.random.default_rng(0)
    theta = problem.theta + np.abs(rng.normal(size=len(problem.theta))) * 0.05
    theta = problem.put(theta, "gravity_counterbalance", {"moment": 500.0, "angle": 0.3})
    return problem.put(theta, "payload", {"mass": 40.0, "distance": 0.2, "x": 0.1, "y": -0.1, "gyration": 0.2})


def test_the_torque_that_is_asked_for_does_not_depend_on_the_measured_one(judging):
    """With friction that grows with the torque, too: which side of zero a torque is on is part of the prediction."""
    problem, model = judging
    theta, samples = where_everything_acts(problem), some(log(1))
    other = samples._replace(torque=-2 * samples.torque)
    asked = [one.torque - model.errors(theta, one) for one in (samples, other)]
    np.testing.assert_allclose(*asked, atol=1e-9 * np.abs(asked[0]).max())


def test_derivatives_are_those_of_finite_differences(judging):
    problem, model = judging
    theta, samples = where_everything_acts(problem), some(log(1))
    places = np.concatenate([problem.of(None), *(problem.of(effect.name) for effect in problem.effects)])
    _, found = model.linearised(theta, samples, places)
    for k, place in enumerate(places):
        step = np.zeros_like(theta)
        step[place] = 1e-6 * max(abs(theta[place]), 1e-2)
        ends = [model.errors(theta + sign * step, samples) for sign in (1.0, -1.0)]
        expected = (ends[0] - ends[1]) / (2 * step[place])
        scale = np.abs(expected).max() + 1e-9
        np.testing.assert_allclose(found[k] / scale, expected / scale, atol=2e-5, err_msg=problem.slots[place].label)


def test_blocks_are_sequences_or_parts_of_few():
    motion = motion_of(log(0, sequences=6, samples=300), DT, at_rest=False)
    few = samples_of(motion, fastest_of(motion))
    assert few.blocks == 24
    assert len(few.block) == motion.v.shape[0] * motion.v.shape[1]
    many = motion_of(log(0, sequences=30, samples=60), DT, at_rest=False)
    assert samples_of(many, fastest_of(many)).blocks == 30
