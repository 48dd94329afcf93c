"""An effect that a physics cannot take is refused by name, and an extension point is never assembled over a change."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import toy_physics

from pgrssnn_jax.effects.arm import arm_effects, gravity_direction, home_offset, joint_effects, mass_effects
from pgrssnn_jax.effects.arm_torques import torque_effects
from pgrssnn_jax.effects.arm_wrist import wrist_coupling
from pgrssnn_jax.effects.base import Effect, add
from pgrssnn_jax.effects.delay import input_delay
from pgrssnn_jax.effects.lgssm import feedthrough, quadratic_damping
from pgrssnn_jax.effects.sensors_actuators import any_system_effects
from pgrssnn_jax.effects.systems import add_effect, catalogue
from pgrssnn_jax.effects.tanks import leak_tank1, pump_effects, tank_effects
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Signal, discrete
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks


def named(name: str, effects: tuple[Effect, ...]) -> Effect:
    return next(effect for effect in effects if effect.name == name)


PAYLOAD, ROTOR_INERTIA = (named(name, mass_effects(6, np.ones(6))) for name in ("payload", "rotor_inertia"))


def state_space(inputs=("u",)):
    return lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[1.0] * len(inputs)] * 2, C=[[1.0, 0.0]], inputs=inputs)


REFUSED = {
    "load on tanks": (cascaded_tanks, PAYLOAD, "payload: expected an arm with backend=jax, found physics 'tanks'"),
    "bias on tanks": (
        cascaded_tanks,
        named("torque_bias", torque_effects(1, np.ones(1))),
        "torque_bias: expected an arm of 1 joint, found physics 'tanks'",
    ),
    "reading of a toy": (toy_physics, home_offset(2), "home_offset: expected an arm of 2 joints, found physics 'toy'"),
    "joints of another arm": (
        arm,
        named("stiction", joint_effects(2)),
        "stiction: expected an arm of 2 joints, found physics 'arm'",
    ),
    "leak of an arm": (arm, leak_tank1(0.1), "leak_tank1: expected two cascaded tanks with k1 to k5, one pump and"),
    "leak of other samples": (cascaded_tanks, leak_tank1(2.0), "leak_tank1: .* and dt=2 s, found physics 'tanks'"),
    "pump of a toy": (
        toy_physics,
        named("pump_dead_zone", pump_effects()),
        "pump_dead_zone: expected two cascaded tanks",
    ),
    "matrix of tanks": (cascaded_tanks, feedthrough(state_space()), "feedthrough: expected a linear state-space model"),
    "matrix of another": (
        lambda: state_space(("a", "b")),
        quadratic_damping(state_space()),
        r"quadratic_damping: expected a linear state-space model with A \(2, 2\), B \(2, 1\) and C \(1, 2\), found",
    ),
    "two channels": (
        cascaded_tanks,
        named("input_offset", any_system_effects(toy_physics())),
        "input_offset: expected 2 inputs, found physics 'ta",
    ),
    "one reading": (
        toy_physics,
        named("sensor_gain", any_system_effects(cascaded_tanks())),
        "sensor_gain: expected 1 output, found physics 'toy'",
    ),
    "other inputs": (
        toy_physics,
        input_delay(state_space(("f", "h"))),
        "input_delay: expected the inputs f, h with dt=1 s, found physics 'toy'",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_effect_that_a_physics_cannot_take_is_refused_by_name(case):
    build, effect, sentence = REFUSED[case]
    with pytest.raises(ValueError, match=f"^effects: {sentence}"):
        add(build(), effect)


@pytest.mark.parametrize("effect", [PAYLOAD, ROTOR_INERTIA, gravity_direction()], ids=lambda e: e.name)
def test_pinocchios_masses_are_its_own(effect):
    physics = arm(backend="pinocchio")
    joints = " of 6 joints" if effect.name == "rotor_inertia" else ""
    with pytest.raises(ValueError, match=f"{effect.name}: expected an arm{joints} with backend=jax, found"):
        add(physics, effect)
    with pytest.raises(ValueError, match=f"{effect.name}: expected an arm{joints} with backend=jax, found"):
        add_effect(physics, effect.name)
    assert effect.name not in [e.name for e in catalogue(physics)]
    assert effect.name in [e.name for e in arm_effects(physics)]


def test_every_effect_says_what_it_needs():
    for physics in (arm(), cascaded_tanks(), state_space(), toy_physics()):
        own = {"arm": arm_effects, "tanks": tank_effects}.get(physics.name, any_system_effects)(physics)
        for effect in (*own, *catalogue(physics)):
            assert effect.needs.words != "any physics"
            assert effect.needs.met(physics)
            add(physics, effect)


def test_a_changed_step_is_not_assembled_again():
    """An arm whose step somebody replaced has no extension points any more: they would undo the replacement."""
    own = arm()
    other = own._replace(step=lambda p, x, u: 0.5 * own.step(p, x, u))
    with pytest.raises(ValueError, match="payload: expected an arm"):
        add(other, PAYLOAD)
    unmeasured = own._replace(measure=lambda p, x, u: 2.0 * x[:6])
    with pytest.raises(ValueError, match="stiction: expected an arm of 6 joints"):
        add(unmeasured, named("stiction", joint_effects(6)))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("outside", [
    "input_offset",
    *(pytest.param(name, marks=pytest.mark.compiles) for name in ("input_delay", "sensor_gain", "home_offset")),
])  # fmt: skip
def test_effects_around_a_step_and_inside_it_come_in_any_order(outside):
    physics = arm(integrator="euler")
    inside = (PAYLOAD, wrist_coupling(6))
    around = home_offset(6) if outside == "home_offset" else {e.name: e for e in any_system_effects(physics)}[outside]
    numbers = {
        "payload": {"mass": 40.0, "distance": 0.3},
        "wrist_coupling": {"c45": 0.1, "c46": -0.2, "c56": 0.3},
        "input_offset": {"offset": np.linspace(-1.0, 1.0, 6)},
        "input_delay": {"delay": np.full(6, 0.05)},
        "sensor_gain": {"gain": np.linspace(0.8, 1.2, 6)},
        "home_offset": {"offset": np.linspace(-0.1, 0.1, 6)},
    }
    draw = np.random.default_rng(0)
    x, u = draw.normal(size=100), jnp.asarray(draw.normal(size=6))

    def once(*order):
        changed = add(physics, *order, numbers=numbers)
        params = jax.tree.map(jnp.asarray, changed.params)
        new = changed.step(params, jnp.asarray(x[: len(changed.states)]), u)
        return np.concatenate([new[:12], changed.measure(params, new, u)])

    expected = once(*inside, around)
    np.testing.assert_allclose(once(around, *inside), expected, rtol=1e-12)
    np.testing.assert_allclose(once(inside[0], around, inside[1]), expected, rtol=1e-12)
    assert np.abs(once(*inside) - expected).max() > 1e-4


def test_other_numbers_than_the_effects_are_refused():
    tanks = cascaded_tanks()
    with pytest.raises(ValueError, match=re.escape("leak_tank1.rate: expected 0 to 0.1 1/s, found 3.0")):
        add(tanks, leak_tank1(4.0), numbers={"leak_tank1": {"rate": 3.0}})
    with pytest.raises(ValueError, match=r"leak_tank1.rate: expected numbers, found 'much'"):
        add_effect(tanks, "leak_tank1", rate="much")


def test_an_own_parameter_may_have_the_name_of_an_effect():
    """Whatever the names of the physics' numbers, those of effects are others."""
    physics = discrete(
        "own",
        lambda p, x, u: p["sensor_offset"] * x + u,
        lambda p, x, u: x,
        {"sensor_offset": 0.5},
        states=(Signal("x"),),
        inputs=(Signal("u"),),
        outputs=(Signal("y"),),
        dt=1.0,
    )
    changed = add_effect(physics, "sensor_offset", offset=3.0)
    assert changed.params.own == physics.params
    assert changed.parameters.own == physics.parameters
    assert jax.tree.structure(changed.params).num_leaves == 2
    x, u = jnp.ones(1), jnp.ones(1)
    np.testing.assert_allclose(changed.step(changed.params, x, u), [1.5])
    np.testing.assert_allclose(changed.measure(changed.params, x, u), [4.0])
