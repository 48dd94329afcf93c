"""An offset before a dead zone, and behind it: two orders of the same effects of an input."""

import numpy as np
import pytest
from discovery.small_cases import choices, setup_of
from discovery.test_further import problem_of
from toys import small_record

from pgrssnn_jax.discovery.discover import discover_in
from pgrssnn_jax.discovery.order import reversed_on_inputs
from pgrssnn_jax.discovery.serialise import discovery_json
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.stored import stored_physics
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.simulate import free_run
from pgrssnn_jax.records.record import Record

NAMES = ("input_offset", "input_dead_zone")
OFFSET, WIDTH = 0.5, 0.4


def record_of(offset_first: bool, seed: int) -> Record:
    draw = np.random.default_rng(seed)
    u, x, y = draw.standard_normal((800, 1)), 0.0, []
    for (v,) in u:
        moved = v + OFFSET if offset_first else v
        bent = np.sign(moved) * max(abs(moved) - WIDTH, 0.0)
        x = 0.8 * x + bent + (0.0 if offset_first else OFFSET)
        y.append([x + 0.05 * draw.standard_normal()])
    return small_record(u, np.array(y))


def test_only_the_effects_of_inputs_change_places():
    effects = catalogue(lgssm(A=[[0.8]], B=[[1.0]], C=[[1.0]], inputs=["u0"], outputs=["y0"]))
    turned = reversed_on_inputs(effects)
    assert reversed_on_inputs(turned) == effects
    for one, other in zip(effects, turned, strict=True):
        assert (one.acts_on == "input") is (other.acts_on == "input")
        assert one.acts_on == "input" or one is other
    inputs = [effect.name for effect in turned if effect.acts_on == "input"]
    assert inputs.index("input_delay") < inputs.index("input_dead_zone") < inputs.index("input_offset")


@pytest.mark.slow
@pytest.mark.parametrize("offset_first", [True, False])
def test_effects_of_an_input_are_found_in_either_order_and_stored_in_it(offset_first):
    problem, said = problem_of(*NAMES, "input_saturation"), []
    setup = setup_of(problem, record_of(offset_first, 0), record_of(offset_first, 1), choices(n_init=1, fixed=["C"]))
    found = discover_in(problem, setup, said.append)
    assert any("opposite order" in line for line in said) is offset_first
    assert found.judgement.verdict is Verdict.EFFECT_FOUND
    assert set(found.selection.final.estimate.active) == set(NAMES)
    params = found.problem.params(found.selection.final.estimate.theta)
    assert params.effects["input_offset"]["offset"] == pytest.approx([OFFSET], abs=0.03)
    assert params.effects["input_dead_zone"]["width"] == pytest.approx([WIDTH], abs=0.03)

    stored = stored_physics(problem.physics, discovery_json(found, setup, command=""), where="discovery.json")
    final = found.problem.full._replace(params=params)
    (y, _), (again, _) = (free_run(one, setup.test.u, np.zeros((1, 1))) for one in (final, stored))
    np.testing.assert_allclose(again, y, atol=1e-5)
