"""A discovery's file as a physics: its settings, numbers, effects and start; and files that are none."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pgrssnn_jax.effects.discovered import discovered_physics

from pgrssnn_jax.physics.tanks import cascaded_tanks

TARGET = "pgrssnn_jax.physics.tanks.cascaded_tanks"
NUMBERS = {"k1": 0.05, "k2": 0.0002, "k3": 0.04, "k4": 0.06, "k5": 0.004}
FOUND = {
    "system": "tanks",
    "verdict": "effect_found",
    "physics": {"_target_": TARGET, "integrator": "rk4", "clamp": False, "effects": None},
    "numbers": {
        "parameters": NUMBERS,
        "effects": {"overflow_lost": {"level": 6.5}, "pump_saturation": {"voltage": None}},
    },
    "initial_state": {"upper_level": 3.0, "lower_level": 2.5},
}
GROUP = {"_target_": TARGET, "integrator": "euler", "clamp": True}


def load(group):
    assert group["effects"] is None
    return cascaded_tanks(**{k: v for k, v in group.items() if k not in ("_target_", "effects")})


def read(tmp_path, found, group=GROUP):
    file = tmp_path / "discovery.json"
    file.write_text(found if isinstance(found, str) else json.dumps(found))
    return discovered_physics({**group, "effects": str(file)}, load)


def test_it_has_the_numbers_and_the_start_that_were_found(tmp_path):
    physics = read(tmp_path, FOUND)
    assert {name: float(physics.params.own[name]) for name in NUMBERS} == NUMBERS
    assert physics.params.effects["overflow_lost"]["level"] == 6.5
    assert physics.params.effects["pump_saturation"]["voltage"] == np.inf
    assert [state.start for state in physics.states] == [3.0, 2.5]
    assert "overflow_lost, pump_saturation" in physics.remark


def test_it_is_simulated_with_the_settings_of_the_discovery(tmp_path):
    """RK4 and no clamp, whatever the group says."""
    physics, numbers = read(tmp_path, FOUND), {name: np.float64(k) for name, k in NUMBERS.items()}
    x, u = jnp.array([2.0, 12.0]), jnp.array([3.0])
    expected = cascaded_tanks(integrator="rk4").step(numbers, x, u)
    np.testing.assert_allclose(physics.step(jax.tree.map(jnp.asarray, physics.params), x, u), expected, rtol=1e-6)


def test_what_an_effect_remembers_starts_where_it_was_found(tmp_path):
    numbers = {"parameters": NUMBERS, "effects": {"input_lag": {"time_constant": 6.0}}}
    start = {**FOUND["initial_state"], "pump_voltage_lagged": 1.5}
    physics = read(tmp_path, {**FOUND, "numbers": numbers, "initial_state": start})
    assert {state.name: state.start for state in physics.states} == start


def test_a_start_that_is_not_shared_stays_unknown(tmp_path):
    assert [s.start for s in read(tmp_path, {**FOUND, "initial_state": None}).states] == [None, None]


@pytest.mark.parametrize(
    ("found", "sentence"),
    [
        ("no json", "physics.effects: expected a discovery.json, found"),
        ([], "expected the key 'system' of a discovery.json"),
        ({k: v for k, v in FOUND.items() if k != "numbers"}, "expected the key 'numbers' of a discovery.json"),
        (
            {**FOUND, "physics": {"_target_": "other.physics"}},
            f"expected a discovery of {TARGET}, found one of other.physics",
        ),
        (
            {**FOUND, "numbers": {"parameters": {"k1": 1.0}, "effects": {}}},
            r"expected parameters \['k1', .*found \['k1'\]",
        ),
        ({**FOUND, "numbers": {"parameters": NUMBERS, "effects": {"flood": {}}}}, "found 'flood'"),
    ],
)
def test_other_files_are_refused(tmp_path, found, sentence):
    with pytest.raises(ValueError, match=sentence):
        read(tmp_path, found)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="physics.effects: expected a discovery.json, found '.*none.json'"):
        discovered_physics({**GROUP, "effects": str(tmp_path / "none.json")}, load)
