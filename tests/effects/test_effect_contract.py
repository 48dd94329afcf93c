"""What every effect of every catalogue promises: neutral numbers change nothing, fits may start where it says."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from toys import quick_jit, toy_physics

from pgrssnn_jax.effects.base import Effect, SignalRange, add
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.base import Parameter, Physics, Signal, continuous
from pgrssnn_jax.physics.check import check_physics
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.usefixtures("x64")


def pendulum() -> Physics:
    return continuous(
        "pendulum",
        lambda p, x, u: jnp.stack([x[1], -p["g"] * jnp.sin(x[0]) - p["c"] * x[1] + u[0]]),
        lambda p, x, u: x[:1],
        {"g": 9.81, "c": 0.1},
        parameters={"g": Parameter("g", "1/s²"), "c": Parameter("c", "1/s", bounds=(0.0, 10.0))},
        dt=0.05,
        states=(Signal("angle", "rad", like="angle"), Signal("speed", "rad/s", rate_of="angle")),
        inputs=(Signal("torque", "Nm"),),
        outputs=(Signal("angle", "rad"),),
    )


SYSTEMS = {
    "tanks": lambda: cascaded_tanks(integrator="rk4"),
    "lgssm": lambda: lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0, 0.2], [0.1, 1.0]], C=[[1.0, 0.0]], inputs=["a", "b"]),
    "pendulum": pendulum,
    "toy": toy_physics,
}
SYSTEMS = {system: cache(build) for system, build in SYSTEMS.items()}
CATALOGUES = {system: {one.name: one for one in catalogue(build())} for system, build in SYSTEMS.items()}
EVERY = [(system, name) for system, effects in CATALOGUES.items() for name in effects]
FIRST = {name: system for system, name in reversed(EVERY)}  # that an effect is in the catalogue of
ONCE = [pair if FIRST[pair[1]] == pair[0] else pytest.param(*pair, marks=pytest.mark.compiles) for pair in EVERY]


def effect(system: str, name: str) -> Effect:
    return CATALOGUES[system][name]


def signal_range_of(physics: Physics) -> SignalRange:
    draw = np.random.default_rng(0)
    sizes = [len(s) for s in (physics.states, physics.inputs, physics.outputs)]
    return SignalRange(*(np.sort(draw.uniform(0.0, 5.0, (2, n)), 0) for n in sizes), lines=(0.01,))


NEVER_NEGATIVE = [
    ("pendulum", "viscous_friction", "c"), ("pendulum", "quadratic_drag", "c"), ("pendulum", "linear_spring", "k"),
    ("pendulum", "coulomb_friction", "a"), ("pendulum", "hysteresis", "k"), ("pendulum", "hysteresis", "s"),
    ("toy", "backlash", "half_width"), ("tanks", "leak_tank1", "rate"), ("tanks", "overflow_lost", "level"),
]  # fmt: skip


@pytest.mark.parametrize(("system", "name", "number"), NEVER_NEGATIVE)
def test_strengths_widths_and_levels_are_never_negative(system, name, number):
    shape = effect(system, name).shapes.get(number, ())
    with pytest.raises(ValueError, match=rf"{name}.{number}: expected 0 to"):
        add(SYSTEMS[system](), effect(system, name), numbers={name: {number: np.full(shape, -0.5)}})


@cache
def with_effects(system: str, name: str | None) -> Physics:
    """The system alone, with one effect, or with all of them; at their neutral numbers."""
    physics = SYSTEMS[system]()
    if name == "all":
        return add(physics, *CATALOGUES[system].values())
    return physics if name is None else add(physics, effect(system, name))


@cache
def mapped(system: str, name: str | None):
    """(numbers, x, u) to next states and outputs; x may be wider than the physics wants."""
    physics = with_effects(system, name)

    def both(params, x, u):
        x = x[: len(physics.states)]
        new = physics.step(params, x, u)
        return new, physics.measure(params, new if physics.output_timing == "after_step" else x, u)

    return quick_jit(jax.vmap(both, (None, 0, 0)))


def moved(physics: Physics, system: str, name: str | None, x: Any, u: Any) -> tuple[np.ndarray, np.ndarray]:
    """The system's own next states, and its outputs, with the numbers of `physics`."""
    new, y = mapped(system, name)(jax.tree.map(np.float64, physics.params), x, u)
    return np.asarray(new)[:, : len(SYSTEMS[system]().states)], np.asarray(y)


def same_with_neutral_numbers(system: str, name: str, seed: int) -> None:
    physics, draw = SYSTEMS[system](), np.random.default_rng(seed)
    x, u = draw.uniform(-1.0, 9.0, (500, 80)), draw.uniform(-2.0, 6.0, (500, len(physics.inputs)))
    x[0], u[0] = 0.0, 0.0
    new, y = moved(with_effects(system, name), system, name, x, u)
    expected, expected_y = moved(physics, system, None, x, u)
    np.testing.assert_allclose(new, expected, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(y, expected_y, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(("system", "name"), ONCE)
def test_neutral_numbers_change_nothing(system, name):
    """Memory states, whatever they hold, come behind the others and are not looked at."""
    same_with_neutral_numbers(system, name, 0)


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_whole_catalogue_with_neutral_numbers_changes_nothing(system):
    same_with_neutral_numbers(system, "all", 1)
    check_physics(with_effects(system, "all"), system)


@pytest.mark.parametrize(("system", "name"), EVERY)
def test_the_numbers_of_an_effect_are_what_it_says(system, name):
    physics, one = SYSTEMS[system](), effect(system, name)
    whole = add(physics, one)
    assert set(whole.params.effects[name]) == set(whole.parameters.effects[name]) == set(one.parameters)
    assert set(one.shapes) <= set(one.parameters)
    assert one.acts_on in ("input", "dynamics", "measurement")
    assert one.title
    assert one.cause
    assert one.equation
    for key, meaning in one.parameters.items():
        low, high = meaning.bounds
        assert meaning.neutral is not None
        assert low <= meaning.neutral <= high
        assert np.all(whole.params.effects[name][key] == meaning.neutral)
    starts = one.initial_guesses(signal_range_of(physics))
    assert starts
    for start in starts:
        assert set(start) == set(one.parameters)
        add(physics, one, numbers={name: start})
        for key, value in start.items():
            low, high = one.parameters[key].bounds
            assert np.all((np.asarray(value) >= low) & (np.asarray(value) <= high))
            assert not np.any(np.isnan(value))


@pytest.mark.parametrize(("system", "name"), ONCE)
def test_starting_numbers_change_something(system, name):
    physics, one = SYSTEMS[system](), effect(system, name)
    draw, reach = np.random.default_rng(2), signal_range_of(physics)
    for start in one.initial_guesses(reach):
        changed = add(physics, one, numbers={name: start})
        x, u = draw.uniform(-3.0, 9.0, (500, 80)), draw.uniform(-1.0, 6.0, (500, len(physics.inputs)))
        after, before = moved(changed, system, name, x, u), moved(physics, system, None, x, u)
        assert max(np.abs(new - old).max() for new, old in zip(after, before, strict=True)) > 1e-6


@pytest.mark.parametrize("system", ["tanks", "lgssm", pytest.param("pendulum", marks=pytest.mark.compiles), "toy"])
def test_derivatives_at_neutral_numbers_are_finite(system):
    whole = with_effects(system, "all")
    slopes = quick_jit(jax.jacfwd(whole.step, (0, 1)))
    params, u = jax.tree.map(jnp.asarray, whole.params), jnp.full(len(whole.inputs), 1.5)
    for x in (np.zeros(len(whole.states)), np.linspace(0.5, 3.0, len(whole.states))):
        found = slopes(params, jnp.asarray(x), u)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


@pytest.mark.parametrize("system", SYSTEMS)
def test_single_precision_stays_single(system):
    whole = with_effects(system, "all")
    x, u = (jax.ShapeDtypeStruct((len(s),), jnp.float32) for s in (whole.states, whole.inputs))
    params = jax.tree.map(lambda p: jax.ShapeDtypeStruct(np.shape(p), jnp.float32), whole.params)
    assert jax.eval_shape(whole.step, params, x, u).dtype == jnp.float32
    assert jax.eval_shape(whole.measure, params, x, u).dtype == jnp.float32


@pytest.mark.parametrize(("system", "name"), EVERY)
def test_an_effect_that_is_there_cannot_be_added_again(system, name):
    physics, one = SYSTEMS[system](), effect(system, name)
    with pytest.raises(ValueError, match=f"expected each effect once, found '{name}'"):
        add(add(physics, one), one)
    with pytest.raises(ValueError, match="expected each effect once"):
        add(physics, one, one)


def test_numbers_that_are_not_the_effects_are_refused():
    tanks, level = cascaded_tanks(), effect("tanks", "overflow_1to2")
    with pytest.raises(ValueError, match=r"overflow_1to2: expected \['level', 'share'\], found 'height'"):
        add(tanks, level, numbers={"overflow_1to2": {"height": 1.0}})
    with pytest.raises(ValueError, match=r"sensor_offset.offset: expected shape \(1,\), found \(2,\)"):
        add(tanks, effect("tanks", "sensor_offset"), numbers={"sensor_offset": {"offset": [1.0, 2.0]}})
