"""Names are what scripts and files hold on to: which effects a system has, and how they are read from JSON."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import toy_physics

from pgrssnn_jax.effects.systems import add_named, catalogue, in_catalogue_order, system_of
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

ANY = {
    "sensor_offset", "sensor_saturation", "sensor_gain", "input_offset", "input_delay", "input_saturation",
    "input_dead_zone", "input_gain", "sensor_nonlinearity",
}  # fmt: skip
TANKS = {
    "overflow_1to2", "overflow_lost", "tank2_overflow", "pump_dead_zone", "pump_saturation", "pump_nonlinearity",
    "leak_tank1", "bypass", "outlet_exponent",
}  # fmt: skip
LGSSM = {"input_saturation", "input_offset", "sensor_offset", "feedthrough", "quadratic_damping"}
ARM = {
    "viscous_friction", "coulomb_friction", "stribeck_friction", "torque_bias", "torque_gain", "velocity_disturbance",
    "payload", "gravity_counterbalance", "rotor_inertia", "joint_limit", "gravity_direction", "home_offset",
    "wrist_coupling", "stiction", "linear_spring", "asymmetric_friction", "load_friction", "link_mass",
}  # fmt: skip


def state_space():
    return lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]])


def names(physics, without=()):
    return [effect.name for effect in catalogue(physics, without)]


def test_every_system_has_the_names_of_the_design():
    assert set(names(toy_physics())) >= ANY
    assert set(names(state_space())) >= LGSSM | ANY
    assert set(names(cascaded_tanks())) >= TANKS | (ANY - {"input_saturation", "input_dead_zone"})
    assert set(names(arm())) == ARM


def test_a_pump_has_one_name_for_what_an_input_would_have():
    assert not {"input_saturation", "input_dead_zone"} & set(names(cascaded_tanks()))
    assert not TANKS & set(names(state_space()))


@pytest.mark.parametrize("name", ["arm", "lgssm", "tanks", "any"])
def test_a_name_alone_does_not_make_a_system(name):
    own = toy_physics()._replace(name=name)
    assert system_of(own) == "any"
    assert names(own) == names(toy_physics())


def test_the_librarys_systems_are_known():
    assert [system_of(p) for p in (arm(), state_space(), cascaded_tanks())] == ["arm", "lgssm", "tanks"]


@pytest.mark.parametrize("build", [cascaded_tanks, state_space, toy_physics, arm])
def test_names_are_unique_and_simpler_effects_exist(build):
    found = catalogue(build())
    assert len({effect.name for effect in found}) == len(found)
    for effect in found:
        assert set(effect.simpler) <= {other.name for other in found} - {effect.name}


def test_effects_can_be_left_out_by_name_in_the_same_order():
    whole = names(cascaded_tanks())
    assert names(cascaded_tanks(), ["bypass", "input_lag"]) == [n for n in whole if n not in ("bypass", "input_lag")]


@pytest.mark.parametrize("name", ["overflow", "input_saturation", "", "Bypass"])
def test_unknown_names_are_refused(name):
    with pytest.raises(
        ValueError, match=rf"effects: expected some of \[.*'bypass'.*\] of physics 'tanks', found '{name}'"
    ):
        catalogue(cascaded_tanks(), [name])
    with pytest.raises(ValueError, match=rf"effects: expected some of .* of physics 'tanks', found '{name}'"):
        add_named(cascaded_tanks(), {name: {}})


def test_null_in_a_file_is_no_limit():
    physics = add_named(
        toy_physics(),
        {"input_saturation": {"low": [None, -1.0], "high": [2.0, None]}, "sensor_saturation": {"low": [None, None]}},
    )
    np.testing.assert_array_equal(physics.params.effects["input_saturation"]["low"], [-np.inf, -1.0])
    np.testing.assert_array_equal(physics.params.effects["input_saturation"]["high"], [2.0, np.inf])
    np.testing.assert_array_equal(physics.params.effects["sensor_saturation"]["low"], [-np.inf, -np.inf])
    np.testing.assert_array_equal(physics.params.effects["sensor_saturation"]["high"], [np.inf, np.inf])
    tanks = add_named(cascaded_tanks(), {"overflow_lost": {"level": None}, "pump_saturation": {"voltage": 3}})
    assert tanks.params.effects["overflow_lost"]["level"] == np.inf
    assert tanks.params.effects["pump_saturation"]["voltage"] == 3.0
    assert tanks.params.effects["pump_saturation"]["voltage"].dtype == np.float64


GIVEN = {"sensor_offset": {"offset": [0.1]}, "input_delay": {"delay": 4.0}, "leak_tank1": {"rate": 0.001}}


@pytest.mark.parametrize("numbers", [GIVEN, dict(reversed(GIVEN.items()))], ids=["one way", "the other"])
def test_named_effects_are_added_in_the_order_in_which_they_are_named(numbers):
    physics = add_named(cascaded_tanks(), numbers)
    assert list(physics.params.effects) == list(physics.parameters.effects) == list(numbers)


@pytest.mark.parametrize("given", [list(GIVEN), list(reversed(GIVEN))], ids=["one way", "the other"])
def test_the_catalogues_order_does_not_depend_on_how_effects_are_named(given):
    order = [name for name in names(cascaded_tanks()) if name in GIVEN]
    assert in_catalogue_order(cascaded_tanks(), given) == order
    assert in_catalogue_order(cascaded_tanks(), ["my_own", *given, "another"]) == [*order, "my_own", "another"]


def test_named_numbers_are_checked():
    with pytest.raises(ValueError, match="found 'speed'"):
        add_named(cascaded_tanks(), {"leak_tank1": {"speed": 1.0}})
    with pytest.raises(ValueError, match=r"sensor_offset.offset: expected shape \(1,\)"):
        add_named(cascaded_tanks(), {"sensor_offset": {"offset": [0.1, 0.2]}})


def test_what_is_there_is_not_missing():
    physics = add_named(cascaded_tanks(), {"leak_tank1": {"rate": 0.001}, "input_lag": {}})
    assert names(physics) == [n for n in names(cascaded_tanks()) if n not in ("leak_tank1", "input_lag")]
    assert system_of(physics) == "tanks"


def test_a_disturbance_reaches_the_plant_past_its_actuator():
    """The command rests within its dead zone: what moves the state is the disturbance alone."""
    physics = toy_physics()
    names = in_catalogue_order(physics, ["periodic_disturbance", "input_dead_zone"])
    numbers = {"periodic_disturbance": {"amplitude": 0.5, "frequency": 0.02}, "input_dead_zone": {"width": 1.0}}
    both = add_named(physics, {name: numbers[name] for name in names})
    alone = add_named(physics, {"periodic_disturbance": numbers["periodic_disturbance"]})
    u, x = jnp.full(len(physics.inputs), 0.3), jnp.zeros(len(both.states))
    x = x.at[len(physics.states) :].set(1.0)  # rad
    found, expected = (
        one.step(jax.tree.map(jnp.asarray, one.params), x, command) for one, command in ((both, u), (alone, 0.0 * u))
    )
    np.testing.assert_allclose(found, expected, atol=1e-6)
    without = physics.step(physics.params, x[: len(physics.states)], 0.0 * u)
    assert np.abs(found[: len(physics.states)] - without).max() > 1e-3
