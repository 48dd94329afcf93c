"""Linear responses to nonparametric corrections, against free runs with a small correction in them."""

import jax
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
from pgrssnn_jax.physics.base import Physics
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
