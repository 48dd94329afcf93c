"""The same physics with other settings: built anew, but for the numbers and effects that it has gained since."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import TOY_PARAMS, quick_jit, toy_physics

from pgrssnn_jax.effects.base import Effect, add, effects_of, on_output, own_of
from pgrssnn_jax.effects.stored import physics_to_json, stored_physics
from pgrssnn_jax.effects.systems import add_effect
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Parameter, Physics, Signal, continuous, discrete
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.usefixtures("x64")
REFITTED = {"k1": 0.05, "k2": 0.0002, "k3": 0.04, "k4": 0.06, "k5": 0.004}


def one_step(physics: Physics, seed: int = 0) -> np.ndarray:
    """Next states and outputs at some point with positive levels."""
    draw = np.random.default_rng(seed)
    x, u = (jnp.asarray(draw.uniform(1.0, 9.0, len(s))) for s in (physics.states, physics.inputs))

    def moved(params, x, u):
        new = physics.step(params, x, u)
        return jnp.concatenate([new, physics.measure(params, new, u)])

    return np.asarray(quick_jit(moved)(jax.tree.map(jnp.asarray, physics.params), x, u))


def assert_same(one: Physics, other: Physics) -> None:
    assert jax.tree.structure(one.params) == jax.tree.structure(other.params)
    for a, b in zip(jax.tree.leaves(one.params), jax.tree.leaves(other.params), strict=True):
        np.testing.assert_array_equal(a, b)
    for field in ("name", "states", "inputs", "outputs", "dt", "output_timing", "differentiable", "discovered"):
        assert getattr(one, field) == getattr(other, field)
    assert dict(one.settings) == dict(other.settings)
    np.testing.assert_array_equal(one_step(one), one_step(other))


@pytest.mark.parametrize(
    ("build", "changes"),
    [
        (cascaded_tanks, {"integrator": "rk4", "sub_steps": 3}),
        (cascaded_tanks, {"clamp": True, "dt": 2.0}),
        (cascaded_tanks, {"k1": 0.05}),
        (lgssm, {"A": [[0.5, 0.0], [0.1, 0.2]], "inputs": ("f",)}),
        (arm, {"integrator": "euler", "derivatives": "forward", "velocity_disturbance": None}),
    ],
    ids=lambda value: value.__name__ if callable(value) else "+".join(value),
)
def test_a_variant_is_the_physics_built_anew(build, changes):
    assert_same(build().variant(**changes), build(**changes))


def test_settings_are_those_of_the_builder_with_its_defaults():
    physics = cascaded_tanks(clamp=True)
    assert physics.settings["clamp"] is True
    assert (physics.settings["integrator"], physics.settings["k1"]) == ("euler", 0.0464)
    changed = physics.variant(integrator="rk4")
    assert (changed.settings["integrator"], changed.settings["clamp"]) == ("rk4", True)
    assert changed.origin.target == physics.origin.target == "pgrssnn_jax.physics.cascaded_tanks"
    assert physics.settings["integrator"] == "euler"


def test_nothing_to_change_is_the_same_physics():
    physics = cascaded_tanks()
    assert physics.variant() is physics


def test_there_and_back_is_the_same_physics():
    physics = cascaded_tanks()._replace(params=REFITTED)
    assert_same(physics.variant(integrator="rk4", clamp=True).variant(integrator="euler", clamp=False), physics)


def test_refitted_numbers_stay_but_for_those_that_are_set():
    physics = cascaded_tanks()._replace(params=REFITTED)
    assert physics.variant(integrator="rk4").params == REFITTED
    assert physics.variant(k3=0.03, clamp=True).params == {**REFITTED, "k3": 0.03}
    np.testing.assert_array_equal(
        one_step(physics.variant(integrator="rk4")), one_step(cascaded_tanks(**REFITTED, integrator="rk4"))
    )


def test_a_refitted_matrix_stays_while_another_one_is_set():
    fitted = {**lgssm().params, "A": np.array([[0.5, 0.1], [0.0, 0.3]])}
    found = lgssm()._replace(params=fitted).variant(C=[[1.0, 0.0]])
    np.testing.assert_array_equal(found.params["A"], fitted["A"])
    np.testing.assert_array_equal(found.params["C"], [[1.0, 0.0]])


def test_effects_stay_with_their_refitted_numbers_and_in_their_order():
    physics = add_effect(add_effect(cascaded_tanks(), "sensor_offset", offset=0.1), "overflow_lost", level=7.0)
    refitted = {**physics.params.effects, "overflow_lost": {"level": np.float64(6.5)}}
    physics = physics._replace(params=physics.params._replace(own=REFITTED, effects=refitted))
    found = physics.variant(integrator="rk4")
    assert list(effects_of(found.parameters)) == ["sensor_offset", "overflow_lost"]
    assert own_of(found.params) == REFITTED
    assert found.params.effects["overflow_lost"]["level"] == 6.5
    expected = cascaded_tanks(**REFITTED, integrator="rk4")
    for name, numbers in {"sensor_offset": {"offset": 0.1}, "overflow_lost": {"level": 6.5}}.items():
        expected = add_effect(expected, name, **numbers)
    np.testing.assert_array_equal(one_step(found), one_step(expected))


def test_a_limit_that_is_not_there_stays_absent():
    found = add_effect(cascaded_tanks(), "pump_saturation").variant(clamp=True)
    assert found.params.effects["pump_saturation"]["voltage"] == np.inf
    assert found.settings["clamp"] is True


def test_effects_of_a_users_own_stay_too():
    def shifted(n, y):
        return y + n["by"]

    own = Effect(
        "shift", {"by": Parameter("b", "V", neutral=0.0)}, lambda physics: on_output(physics, "shift", shifted)
    )
    found = add(cascaded_tanks(), own, numbers={"shift": {"by": 0.5}}).variant(integrator="rk4")
    plain = one_step(cascaded_tanks(integrator="rk4"))
    np.testing.assert_allclose(one_step(found) - plain, [0.0, 0.0, 0.5], atol=1e-12)


def test_what_an_effect_remembers_is_among_the_states():
    found = add_effect(cascaded_tanks(), "input_lag", time_constant=6.0).variant(integrator="rk4")
    assert [state.name for state in found.states] == ["upper_level", "lower_level", "pump_voltage_lagged"]


@pytest.mark.parametrize("name", ["speed", "K1", "effects", "params"])
def test_settings_that_the_builder_does_not_have_are_refused(name):
    with pytest.raises(ValueError, match=rf"physics 'tanks': variant: expected settings among .*, found '{name}'"):
        cascaded_tanks().variant(**{"clamp": True, name: 1.0})


def test_values_that_the_builder_refuses_are_refused():
    with pytest.raises(ValueError, match="integrator: expected one of"):
        cascaded_tanks().variant(integrator="midpoint")
    with pytest.raises(ValueError, match=r"physics 'tanks': k1: expected 0 to 1"):
        cascaded_tanks().variant(k1=-1.0)


SIGNALS = {"states": (Signal("x"),), "inputs": (Signal("u"),), "outputs": (Signal("y"),)}


def decay(p, x, u):
    return -p["rate"] * x + u


def own(**settings) -> Physics:
    return continuous("c", decay, lambda p, x, u: x, {"rate": 0.5}, dt=0.5, **settings, **SIGNALS)


def test_a_continuous_physics_remembers_its_integrator():
    assert own().settings == {"integrator": "rk4", "sub_steps": 1}
    assert_same(own(integrator="euler").variant(integrator="rk4", sub_steps=2), own(sub_steps=2))
    assert one_step(own()) != pytest.approx(one_step(own(integrator="euler")), rel=1e-3)
    refitted = own(integrator="euler")._replace(params={"rate": 0.7}).variant(integrator="rk4")
    assert refitted.params == {"rate": 0.7}
    with pytest.raises(ValueError, match=r"variant: expected settings among \['integrator', 'sub_steps'\], found 'dt'"):
        own().variant(dt=0.1)


def test_a_discrete_physics_of_a_users_own_has_no_settings():
    assert dict(toy_physics().settings) == {}
    assert toy_physics().variant().params is TOY_PARAMS or toy_physics().variant().params == TOY_PARAMS
    with pytest.raises(ValueError, match=r"physics 'toy': variant: expected settings among \[\], found 'integrator'"):
        toy_physics().variant(integrator="rk4")
    physics = discrete("d", decay, lambda p, x, u: x, {"rate": 0.5}, dt=1.0, **SIGNALS)
    assert physics.origin is None


def test_a_discovered_physics_stays_one():
    changed = cascaded_tanks()._replace(discovered=True, optimism=1.5).variant(clamp=True)
    assert changed.discovered
    assert changed.optimism == 1.5


def known_start() -> Physics:
    stored = {**physics_to_json(cascaded_tanks()), "initial_state": {"upper_level": 3.0, "lower_level": 2.5}}
    return stored_physics(cascaded_tanks(), stored, where="here")


def test_a_start_that_was_found_stays():
    physics = known_start()
    assert [state.start for state in physics.states] == [3.0, 2.5]
    assert [state.start for state in physics.variant(integrator="rk4").states] == [3.0, 2.5]
