"""What data cannot tell is said: effects that do alike, and effects that parameters take up or that nothing excites."""

import jax
import numpy as np
import pytest
from discovery.small_cases import choices

from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.unknown import flexible_problem
from pgrssnn_jax.discovery.untestable import untestable
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.discovery.workflow import Discovery, discover_in
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record

pytestmark = pytest.mark.slow
A, B, C = np.array([[0.6, 0.7], [-0.1, 0.0]]), np.array([-1.1, 0.0]), np.array([0.9, -0.1])
INFO = RecordInfo((Channel("u"),), (Channel("y"),), 1.0, "simulated")
NAMES = ("sensor_offset", "input_offset", "input_gain", "input_dead_zone")


@pytest.fixture(scope="module")
def problems() -> tuple[Problem, Problem]:
    physics = lgssm(A=A, B=B[:, None], C=C[None])
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name in NAMES], fixed=["B"])
    return problem, flexible_problem(problem)


def measured(samples: int, seed: int, offset: float) -> Record:
    draw = np.random.default_rng(seed)
    u, x, y = 2.0 * draw.standard_normal((samples, 1)), np.zeros(2), []
    for (v,) in u:
        x = A @ x + B * v
        y.append([C @ x + offset + 0.02 * draw.standard_normal()])
    return record(u, np.array(y), INFO)


def discovered(problems, offset: float) -> Discovery:
    problem, flexible = problems
    data = (measured(n, seed, offset) for n, seed in ((320, 1), (160, 2)))
    with jax.enable_x64(True):
        return discover_in(problem, *data, choices(), lambda line: None, start=Start.UNKNOWN, flexible=flexible)


def test_offsets_before_and_behind_a_linear_system_are_ambiguous(problems):
    """A constant at the input is one at the output, wherever the system starts."""
    found = discovered(problems, 0.8)
    assert found.judged.verdict is Verdict.AMBIGUOUS
    (named,) = found.found.final.estimate.active
    (others,) = found.judged.alternatives.values()
    assert {named, *(other.name for other in others)} == {"sensor_offset", "input_offset"}


def test_a_gain_that_a_matrix_takes_up_is_untestable(problems):
    found = discovered(problems, 0.0)
    assert found.judged.verdict is Verdict.NO_DISCREPANCY
    reasons = {entry["name"]: entry["reason"] for entry in untestable(found)}
    assert set(reasons) == {"input_gain"}
    assert "parameters" in reasons["input_gain"]
