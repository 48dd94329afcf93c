"""Linear responses to nonparametric corrections, against free runs with a small correction in them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import small_record

from pgrssnn_jax.discovery.corrected import Corrected, numbers_of
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.flexible import families
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, carried, weighted_signals
from pgrssnn_jax.discovery.responses import Response, correction_responses, path_of
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.base import Physics, Signal, continuous
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

SAMPLES, SMALL = 60, 1e-6


def tanks() -> Physics:
    return cascaded_tanks(integrator="rk4")


def before_step() -> Physics:
    """Two inputs, an output that is read before the input acts."""
    physics = lgssm(A=[[0.8, 0.1], [0.0, 0.5]], B=[[1.0, 0.0], [0.3, 1.0]], C=[[1.0, 0.4]], inputs=["u0", "u1"])
    return physics._replace(output_timing="before_step")


def answers(physics: Physics) -> tuple[Problem, Signals, Guess, dict[str, Response]]:
    """Of a model with an effect that remembers inputs."""
    (delay,) = (effect for effect in catalogue(physics) if effect.name == "input_delay")
    problem = build_problem(physics, [delay])
    draw = np.random.default_rng(0)
    u = 3.0 + draw.standard_normal((SAMPLES, len(physics.inputs)))
    record = small_record(u, 5.0 + draw.standard_normal((SAMPLES, len(physics.outputs))))
    signals = weighted_signals(problem, record, folds=2, block=10)
    theta = problem.put(problem.theta, "input_delay", {"delay": np.asarray(1.3 * physics.dt)})
    guess = Guess(("input_delay",), theta, np.maximum(signals.start, 1.0))
    return problem, signals, guess, correction_responses(problem, path_of(problem, signals, guess), families(physics))


@pytest.mark.parametrize("build", [tanks, before_step])
def test_columns_are_the_derivatives_of_free_runs(build):
    physics = build()
    with jax.enable_x64(True):
        problem, signals, guess, found = answers(physics)
        assert set(found) == set(families(physics))
        draw, corrected = np.random.default_rng(1), Corrected()
        for name, response in found.items():
            wide = corrected.by(problem, name, guess.active)
            start = weighted_signals(wide, small_record(signals.u[0], signals.y[0]), folds=2, block=10).start
            theta, x0 = carried(problem, wide, guess.theta, guess.x0, start)
            effect, numbers = numbers_of(physics, name, response.low, response.high)
            c = draw.standard_normal(numbers["c"].shape)
            runs = [
                simulate(wide, signals.u, wide.put(theta, effect, numbers | {"c": size * c})[None], x0[None])[0]
                for size in (SMALL, -SMALL)
            ]
            expected = (runs[0] - runs[1])[0] / (2 * SMALL)
            np.testing.assert_allclose(response.columns @ c, expected, atol=2e-5 * np.abs(expected).max(), err_msg=name)


def cart_with_vessel() -> Physics:
    """dv/dt = u - 0.5 v - 4 q, dq/dt = v; dh/dt = u - h: takes effects on velocities, first-order states and inputs."""
    return continuous(
        "cart_with_vessel",
        lambda p, x, u: jnp.stack([x[1], u[0] - 0.5 * x[1] - 4.0 * x[0], u[0] - x[2]]),
        lambda p, x, u: x[::2],
        {"one": 1.0},
        dt=0.1,
        states=(Signal("q", "m", like="q"), Signal("v", "m/s", rate_of="q"), Signal("h", "m", like="h")),
        inputs=(Signal("u"),),
        outputs=(Signal("q", "m"), Signal("h", "m")),
    )


@pytest.mark.parametrize("build", [cart_with_vessel, tanks, before_step])
def test_effects_that_do_nothing_leave_the_derivatives_of_the_step_alone(build):
    """Of an input that is held, and none at times, where a play without width, a limit at infinity or an edge at zero
    meets its signal exactly."""
    physics, own = build(), len(build().states)
    draw = np.random.default_rng(0)
    u = np.repeat(draw.uniform(0.5, 3.0, (SAMPLES // 6, len(physics.inputs))), 6, axis=0)
    u[12:24] = 0.0
    with jax.enable_x64(True):
        problem = build_problem(physics, catalogue(physics))
        record = small_record(u, 2.0 + draw.standard_normal((SAMPLES, len(physics.outputs))))
        signals = weighted_signals(problem, record, folds=2, block=10)
        path = path_of(problem, signals, Guess((), problem.theta, np.maximum(signals.start, 1.0)))
        params = problem.code.unravel(problem.theta)
        step = jax.vmap(lambda x, u: problem.full.step(params, x, u)[:own])
        x, inputs = path.before[0], path.u[0]
        along_x = [(step(x + e, inputs) - step(x - e, inputs)) / (2 * SMALL) for e in SMALL * np.eye(x.shape[-1])]
        along_u = [(step(x, inputs + e) - step(x, inputs - e)) / (2 * SMALL) for e in SMALL * np.eye(u.shape[-1])]
    np.testing.assert_allclose(path.a[0, :, :own], np.stack(along_x, -1), atol=1e-6)
    np.testing.assert_allclose(path.b[0, :, :own], np.stack(along_u, -1), atol=1e-6)


def test_a_signal_that_does_not_move_corrects_nothing():
    physics = tanks()
    with jax.enable_x64(True):
        problem, signals, guess, _ = answers(physics)
        still = signals._replace(u=np.full_like(signals.u, 3.0))
        found = correction_responses(problem, path_of(problem, still, guess), families(physics))
    assert "pump_voltage by itself" not in found
    assert "lower_level by upper_level" in found


def test_programs_are_shared_by_corrections_of_all_equations():
    physics = tanks()
    with jax.enable_x64(True):
        problem, corrected = build_problem(physics, []), Corrected()
        one, other = (
            corrected.by(problem, name, []) for name in ("upper_level by lower_level", "pump_voltage by itself")
        )
    assert one.code is other.code
