"""A physics as plain data and back: settings, numbers, effects and start; and files that are none."""

import hashlib
import importlib
import inspect
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import ROOT
from toys import toy_physics

from pgrssnn_jax.cli.plan import load_physics
from pgrssnn_jax.effects.base import Effect, effects_of, on_output
from pgrssnn_jax.effects.stored import (
    has_source,
    physics_to_json,
    read_stored,
    settings_to_json,
    source_digest,
    stored_physics,
)
from pgrssnn_jax.effects.systems import add_effect
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Parameter, Physics, Signal, continuous, discrete
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

TARGET = "pgrssnn_jax.physics.cascaded_tanks"
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


def given() -> Physics:
    return cascaded_tanks(integrator="euler", clamp=True)


def read(tmp_path, found) -> Physics:
    file = tmp_path / "discovery.json"
    file.write_text(found if isinstance(found, str) else json.dumps(found))
    return stored_physics(given(), read_stored(file, "physics.effects"), where=f"physics.effects: {file}")


def there_and_back(physics: Physics, base: Physics, **more) -> Physics:
    text = json.dumps(physics_to_json(physics), allow_nan=False)
    return stored_physics(base, json.loads(text), where="here", **more)


def one_step(physics: Physics) -> np.ndarray:
    draw = np.random.default_rng(0)
    x, u = (jnp.asarray(draw.uniform(1.0, 9.0, len(s))) for s in (physics.states, physics.inputs))
    params = jax.tree.map(jnp.asarray, physics.params)
    new = physics.step(params, x, u)
    return np.concatenate([new, physics.measure(params, new, u)])


def assert_same(one: Physics, other: Physics) -> None:
    assert jax.tree.structure(one.params) == jax.tree.structure(other.params)
    for a, b in zip(jax.tree.leaves(one.params), jax.tree.leaves(other.params), strict=True):
        np.testing.assert_array_equal(a, b)
    assert list(effects_of(one.parameters)) == list(effects_of(other.parameters))
    assert one.states == other.states
    assert one.discovered == other.discovered
    np.testing.assert_array_equal(one_step(one), one_step(other))


# --- discovery.json ---------------------------------------------------------------------------------------------------


def test_it_has_the_numbers_and_the_start_that_were_found(tmp_path):
    physics = read(tmp_path, FOUND)
    assert {name: float(physics.params.own[name]) for name in NUMBERS} == NUMBERS
    assert physics.params.effects["overflow_lost"]["level"] == 6.5
    assert physics.params.effects["pump_saturation"]["voltage"] == np.inf
    assert [state.start for state in physics.states] == [3.0, 2.5]
    assert physics.discovered


def test_it_is_simulated_with_the_settings_of_the_discovery(tmp_path):
    """RK4 and no clamp, whatever the given physics has."""
    physics, numbers = read(tmp_path, FOUND), {name: np.float64(k) for name, k in NUMBERS.items()}
    assert (physics.settings["integrator"], physics.settings["clamp"]) == ("rk4", False)
    x, u = jnp.array([2.0, 12.0]), jnp.array([3.0])
    expected = cascaded_tanks(integrator="rk4").step(numbers, x, u)
    np.testing.assert_allclose(physics.step(jax.tree.map(jnp.asarray, physics.params), x, u), expected, rtol=1e-6)


def test_settings_of_training_are_those_of_the_physics_that_is_given():
    stored = physics_to_json(arm(derivatives="forward", integrator="euler"))
    found = stored_physics(arm(), stored, where="here")
    assert found.settings["derivatives"] == arm().settings["derivatives"] != "forward"
    assert found.settings["integrator"] == "euler"


def test_effects_of_a_discovery_are_added_in_the_catalogues_order(tmp_path):
    effects = {"sensor_offset": {"offset": [0.1]}, **FOUND["numbers"]["effects"]}
    one, other = (
        read(tmp_path, {**FOUND, "numbers": {"parameters": NUMBERS, "effects": named}})
        for named in (effects, dict(reversed(effects.items())))
    )
    assert list(one.parameters.effects) == list(other.parameters.effects)
    assert list(one.parameters.effects)[-1] == "sensor_offset"
    assert_same(one, other)


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
        ([], "expected the key 'system' of a stored physics, found none"),
        ({k: v for k, v in FOUND.items() if k != "numbers"}, "expected the key 'numbers' of a stored physics"),
        ({k: v for k, v in FOUND.items() if k != "initial_state"}, "expected the key 'initial_state' of a stored"),
        ({**FOUND, "numbers": {"parameters": NUMBERS}}, "numbers: expected a group of named values, found"),
        ({**FOUND, "physics": "tanks"}, "physics: expected a group of named values, found 'tanks'"),
        ({**FOUND, "system": "lgssm"}, "discovery.json: expected physics 'tanks', found 'lgssm'"),
        (
            {**FOUND, "numbers": {"parameters": {"k1": 1.0}, "effects": {}}},
            r"expected parameters \['k1', .*found \['k1'\]",
        ),
        (
            {**FOUND, "numbers": {"parameters": {**NUMBERS, "k1": [0.1, 0.2]}, "effects": {}}},
            r"k1: expected numbers of shape \(\), found \[0.1, 0.2\]",
        ),
        (
            {**FOUND, "numbers": {"parameters": {**NUMBERS, "k1": "much"}, "effects": {}}},
            r"k1: expected numbers of shape \(\), found 'much'",
        ),
        ({**FOUND, "numbers": {"parameters": NUMBERS, "effects": {"flood": {}}}}, "found 'flood'"),
        ({**FOUND, "numbers": {"parameters": NUMBERS, "effects": {"bypass": {"level": 1.0}}}}, "found 'level'"),
        ({**FOUND, "physics": {"integrator": "midpoint"}}, "integrator: expected one of"),
    ],
)
def test_other_files_are_refused(tmp_path, found, sentence):
    with pytest.raises(ValueError, match=sentence):
        read(tmp_path, found)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="physics.effects: expected a discovery.json, found '.*none.json'"):
        read_stored(tmp_path / "none.json", "physics.effects")


# --- physics -> plain data -> physics ---------------------------------------------------------------------------------


def tanks_with_effects() -> Physics:
    physics = cascaded_tanks(integrator="rk4", sub_steps=2)._replace(params=NUMBERS)
    for name, numbers in {
        "sensor_offset": {"offset": 0.1},
        "input_lag": {"time_constant": 6.0},
        "overflow_lost": {"level": 7.5},
        "pump_saturation": {},
        "bypass": {"share": 0.1},
    }.items():
        physics = add_effect(physics, name, **numbers)
    return physics


@pytest.mark.parametrize("base", [cascaded_tanks, given], ids=["defaults", "others"])
def test_a_physics_with_effects_comes_back_with_its_order_and_its_limits(base):
    physics = tanks_with_effects()
    stored = physics_to_json(physics)
    assert list(stored["numbers"]["effects"]) == [
        "sensor_offset",
        "input_lag",
        "overflow_lost",
        "pump_saturation",
        "bypass",
    ]
    assert stored["numbers"]["effects"]["pump_saturation"] == {"voltage": None}
    found = there_and_back(physics, base())
    assert_same(found, physics)
    assert found.params.effects["pump_saturation"]["voltage"] == np.inf
    assert physics_to_json(found) == stored


@pytest.mark.parametrize("base", [cascaded_tanks, lgssm, arm, toy_physics], ids=lambda build: build.__name__)
def test_every_physics_of_the_library_comes_back(base):
    assert_same(there_and_back(base(), base()), base())


def test_limits_per_channel_come_back_where_they_are():
    limits = {"lower": [None, -1.0, None, -2.0, None, None], "upper": [0.1, None, 0.2, None, None, 1.0]}
    physics = add_effect(arm(), "joint_limit", **limits)
    assert physics_to_json(physics)["numbers"]["effects"]["joint_limit"] == limits
    found = there_and_back(physics, arm()).params.effects["joint_limit"]
    np.testing.assert_array_equal(found["lower"], [-np.inf, -1.0, -np.inf, -2.0, -np.inf, -np.inf])
    np.testing.assert_array_equal(found["upper"], [0.1, np.inf, 0.2, np.inf, np.inf, 1.0])


def test_starts_and_discovery_come_back():
    states = tuple(s._replace(start=2.0 + i) for i, s in enumerate(cascaded_tanks().states))
    physics = cascaded_tanks()._replace(states=states, discovered=True, optimism=1.5)
    assert physics_to_json(physics)["initial_state"] == {"upper_level": 2.0, "lower_level": 3.0}
    assert_same(there_and_back(physics, cascaded_tanks()), physics)


def shift() -> Effect:
    meaning = {"by": Parameter("b", "V", neutral=0.0)}
    return Effect("shift", meaning, lambda physics: on_output(physics, "shift", lambda n, y: y + n["by"]))


def test_effects_of_a_users_own_come_back_where_they_are_given():
    physics = add_effect(add_effect(cascaded_tanks(), shift(), by=0.5), "bypass", share=0.1)
    assert_same(there_and_back(physics, cascaded_tanks(), extra=[shift()]), physics)
    with pytest.raises(ValueError, match="effects: expected some of .*, found 'shift'"):
        there_and_back(physics, cascaded_tanks())


SIGNALS = {"states": (Signal("x"),), "inputs": (Signal("u"),), "outputs": (Signal("y"),)}


def decay(p, x, u):
    return -p["rate"] * x + u


def own(params=None, **settings) -> Physics:
    return continuous("own", decay, lambda p, x, u: x, params or {"rate": 0.5}, dt=0.5, **settings, **SIGNALS)


def test_a_users_physics_comes_back_with_its_integrator():
    physics = own({"rate": 0.7}, integrator="euler", sub_steps=2)
    stored = physics_to_json(physics)
    assert stored["physics"] == {"_target_": None, "integrator": "euler", "sub_steps": 2}
    assert_same(there_and_back(physics, own()), physics)


def test_functions_among_the_settings_are_no_data():
    physics = own(integrator=lambda field, x, h: x + h * field(x))
    assert settings_to_json(physics) == {"sub_steps": 1}
    assert_same(there_and_back(physics, physics), physics)


def test_the_file_tells_one_physics_from_another():
    stored = physics_to_json(cascaded_tanks())
    assert (stored["system"], stored["dt"], stored["output_timing"]) == ("tanks", 4.0, "after_step")
    assert stored["signals"]["inputs"] == [["pump_voltage", "V"]]
    assert stored["source_sha256"] == source_digest(cascaded_tanks(clamp=True))
    assert len({source_digest(p) for p in (cascaded_tanks(), lgssm(), toy_physics(), own())}) == 4
    with pytest.raises(ValueError, match="here: expected physics 'lgssm', found 'tanks'"):
        stored_physics(lgssm(), stored, where="here")


def test_a_command_and_python_tell_the_same_source_of_an_own_physics(tmp_path, monkeypatch):
    """The command's physics remembers the function `pendulum`; Python's remembers only its inner derivative."""
    text = (ROOT / "tests/test_api_own_physics.py").read_text()
    (tmp_path / "stored_pendulum.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    pendulum = importlib.import_module("stored_pendulum").pendulum
    by_command = load_physics({"_target_": "stored_pendulum.pendulum"})
    assert source_digest(by_command) == source_digest(pendulum())
    inner = hashlib.sha256(inspect.getsource(pendulum().origin.source).encode()).hexdigest()[:12]
    assert inner != source_digest(pendulum())
    assert has_source(pendulum(), inner)
    assert not has_source(pendulum(), source_digest(own()))


def test_another_size_of_matrix_is_refused():
    other = lgssm(A=np.eye(3) / 2, B=np.ones((3, 1)), C=np.ones((1, 3)))
    stored = {**physics_to_json(other), "physics": {}}
    with pytest.raises(ValueError, match=r"here: A: expected numbers of shape \(2, 2\), found"):
        stored_physics(lgssm(), stored, where="here")


def test_an_own_limit_that_is_not_there_comes_back():
    physics = discrete(
        "d", lambda p, x, u: jnp.minimum(x + u, p["most"]), lambda p, x, u: x, {"most": np.inf}, dt=1.0, **SIGNALS
    )
    assert_same(there_and_back(physics, physics), physics)


def test_a_nested_tree_of_numbers_comes_back():
    params = {"rate": 0.5, "more": {"list": [1.0, np.ones(3)]}}
    physics = discrete("d", decay, lambda p, x, u: x, params, dt=1.0, **SIGNALS)
    assert_same(there_and_back(physics, physics), physics)
