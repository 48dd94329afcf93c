"""What an effect that is taken out must be replaced by: something better than the model that had it."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.estimate import Estimate, Guess, Validated
from pgrssnn_jax.discovery.look import Candidate, Rules, Stage
from pgrssnn_jax.discovery.search import _better_fit, _knowing

NUMBERS, SAMPLES = np.zeros(3), 64


def model(energy: float, *active: str, samples: int = SAMPLES) -> Validated:
    error = np.full((1, samples, 1), np.sqrt(energy / samples))
    return Validated(Estimate(active, NUMBERS, np.zeros((1, 2)), error), error, NUMBERS[None])


def look(base: Validated, **energies: float) -> Stage:
    """A look beside `base` that has found these effects, the best first."""
    found = [
        Candidate(name, 1.0 - energy / base.cost, model(energy, name), Guess((name,), NUMBERS, np.zeros((1, 2))))
        for name, energy in sorted(energies.items(), key=lambda item: item[1])
    ]
    return Stage(base, tuple(found), np.zeros(1), {}, SAMPLES, 1.0)


def test_a_worse_fit_of_what_was_taken_out_does_not_let_an_imitator_in():
    stage = _knowing(look(model(9.0), leak=3.0, bypass=2.0), "leak", look(model(1.0, "leak")))
    assert [candidate.name for candidate in stage.candidates] == ["leak", "bypass"]
    assert stage.candidates[0].cost == pytest.approx(1.0)
    assert stage.candidates[0].gain == pytest.approx(1.0 - 1.0 / 9.0)


def test_an_effect_that_the_look_has_not_found_at_all_is_known_too():
    stage = _knowing(look(model(9.0), bypass=2.0), "leak", look(model(1.0, "leak")))
    assert [candidate.name for candidate in stage.candidates] == ["leak", "bypass"]


def test_a_better_fit_stands():
    stage = look(model(9.0), leak=0.5, bypass=2.0)
    assert _knowing(stage, "leak", look(model(1.0, "leak"))) is stage


def test_errors_of_other_samples_are_not_compared():
    """Beside one effect more, stretches are longer."""
    stage = look(model(9.0), leak=3.0)
    assert _knowing(stage, "leak", look(model(1.0, "leak", samples=2 * SAMPLES))) is stage


@pytest.mark.parametrize(("energy", "better"), [(0.9, True), (0.99, False), (2.0, False)])
def test_the_same_effects_with_visibly_better_numbers_are_taken_up(energy, better):
    found = Candidate("leak", 0.9, model(energy, "leak"), Guess(("leak",), NUMBERS, np.zeros((1, 2))))
    assert _better_fit(found, model(1.0, "leak"), Rules()) is better
    assert not _better_fit(found, model(1.0, "leak", samples=2 * SAMPLES), Rules())
