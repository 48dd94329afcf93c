"""What a selection still needs before it is judged."""

import pytest
from discovery.by_hand import model, screening

from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.discovery.scoring import _at_its_best
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.tanks import cascaded_tanks

NAMES = ("bypass", "leak_tank1")


@pytest.mark.parametrize(("again", "expected"), [(8.0, 8.0), (9.5, 9.0)])
def test_the_final_model_is_the_best_fit_of_its_effects(again, expected):
    """Taken out and fitted again beside the other, an effect may lead to a better optimum; rivals do not count."""
    physics = cascaded_tanks()
    problem = build_problem(physics, [e for e in catalogue(physics) if e.name in NAMES], accelerate=False)
    first, second = NAMES
    alone = {name: model(problem, 49.0, (name,)) for name in NAMES}
    final = model(problem, 9.0, NAMES)
    screenings = {
        first: screening(alone[second], {first: model(problem, again, (second, first))}),
        second: screening(alone[first], {second: final, "sensor_gain": model(problem, 1.0, (first,))}),
    }
    base = model(problem, 400.0)
    found = _at_its_best(problem, Selection(base, final, screenings, screening(base, {}), screening(final, {}), 1.0))
    assert found.final.estimate.cost == pytest.approx(model(problem, expected, NAMES).estimate.cost)
    assert found.last.base is found.final
