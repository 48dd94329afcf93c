"""Free runs that begin anew after every horizon, against simulations of the pieces one by one."""

import jax
import numpy as np
import pytest
from arm_logs import DT, KUKA

from pgrssnn_jax.acceleration.compiler import quick_jit
from pgrssnn_jax.discovery.inverse.free_run import free_runs
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.arms.build import arm

pytestmark = pytest.mark.usefixtures("x64")
BIAS = np.array([0.0, 30.0, -20.0, 0.0, 0.0, 0.0])  # Nm
TIME = 62  # samples: 6.1 s after the first one


def test_the_true_arm_stays_where_it_was_measured_and_another_one_errs_as_its_pieces_do():
    physics = arm(derivatives="forward")
    (effect,) = (effect for effect in catalogue(physics) if effect.name == "torque_bias")
    problem = build_problem(physics, [effect], accelerate=False)
    step = quick_jit()(jax.vmap(problem.full.step, (None, 0, 0)))

    def states(theta, x, u):
        """Step by step, from Python."""
        params, found = problem.params(theta), [x]
        for now in np.swapaxes(u, 0, 1):
            found.append(np.asarray(step(params, found[-1], now)))
        return np.stack(found[1:], axis=1)

    true, biased = problem.theta, problem.put(problem.theta, "torque_bias", {"theta": BIAS})
    u = np.random.default_rng(0).normal(size=(2, TIME, KUKA.n)) * np.array([2.0, 2.0, 2.0, 0.3, 0.3, 0.3])
    x = states(true, np.zeros((2, 2 * KUKA.n)), u)
    q, v = np.split(x, 2, axis=2)
    none = np.zeros(KUKA.n)
    found = free_runs(problem, Motion(q, v, v, u, DT, None, none, none), {"true": true, "biased": biased})
    assert [one.horizon for one in found] == [1.0, 5.0, None]
    assert all(one.errors["true"] < 1e-9 for one in found)
    for length, one in zip((10, 50, TIME - 1), found, strict=True):
        parts = [states(biased, x[:, k], u[:, k + 1 : k + 1 + length]) for k in range(0, TIME - 1, length)]
        missed = np.concatenate(parts, axis=1)[..., : KUKA.n] - q[:, 1:]
        expected = np.mean(np.sqrt((missed**2).mean((0, 1))) / q.std((0, 1)))
        assert one.errors["biased"] == pytest.approx(expected, rel=1e-9)
    assert 0 < found[0].errors["biased"] < found[1].errors["biased"] < found[2].errors["biased"]


def test_horizons_that_a_record_cannot_show_are_left_out(monkeypatch):
    physics = arm(derivatives="forward")
    problem = build_problem(physics, [], accelerate=False)
    rest, none = np.zeros((1, 21, KUKA.n)), np.zeros(KUKA.n)
    motion = Motion(rest + np.arange(21)[:, None], rest, rest, rest, 0.05, None, none, none)
    assert [one.horizon for one in free_runs(problem, motion, {})] == [None]
    locked = motion._replace(reading=motion.reading * np.array([0, 1, 1, 1, 1, 1]))
    (whole,) = free_runs(problem, locked, {"here": problem.theta})
    assert np.isfinite(whole.errors["here"])
    assert not free_runs(problem, motion._replace(reading=rest), {"here": problem.theta})
    monkeypatch.setattr("pgrssnn_jax.discovery.inverse.free_run._MOST", 11)
    assert [one.horizon for one in free_runs(problem, motion, {})] == [pytest.approx(0.5)]  # s, and not whole
