"""Effects of any physics against a solver of the equation that has them, and the same in any unit."""

from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oscillators import oscillator
from scipy.integrate import solve_ivp
from toys import quick_jit

from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.effects import add_effect, catalogue
from pgrssnn_jax.effects.base import Effect, SignalRange
from pgrssnn_jax.effects.generic import generic_effects
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics, Signal, continuous
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.usefixtures("x64")
FORCES = [
    "viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag", "linear_spring", "cubic_spring",
    "constant_force", "hysteresis", "hard_stop",
]  # fmt: skip
FLOWS = ["leak", "inflow", "power_law", "ceiling", "floor"]


def carts(unit: float = 1.0, dt: float = 0.05) -> Physics:
    """Two carts on springs beside a tank that fills; lengths and levels in `unit` of what they are."""

    def slope(p: Any, x: Any, u: Any, xp: Any = jnp) -> Any:
        way, level, speed, other, rate = x
        return xp.stack(
            [speed, 0.3 * p["unit"] * u[0] - 0.1 * level, p["unit"] * u[0] - 2 * way, rate, way - 3 * other]
        )

    return continuous(
        "carts",
        slope,
        lambda p, x, u: x[:2],
        {"unit": unit},
        states=(
            Signal("way", "m", like="way"),
            Signal("level", "V", like="level"),
            Signal("speed", "m/s", rate_of="way"),
            Signal("other"),
            Signal("rate", rate_of="other"),
        ),
        inputs=(Signal("force"),),
        outputs=(Signal("way", "m"), Signal("level", "V")),
        dt=dt,
    )


#: numbers (of both carts), and what they add to the derivative of (way, level, speed, other, rate)
CASES: dict[str, tuple[dict[str, Any], Any]] = {
    "viscous_friction": ({"c": [0.8, 0.3]}, lambda x: [0, 0, -0.8 * x[2], 0, -0.3 * x[4]]),
    "coulomb_friction": (
        {"a": [0.15, 0.1]},
        lambda x: [0, 0, -0.15 * np.tanh(x[2] / 1e-4), 0, -0.1 * np.tanh(x[4] / 1e-4)],
    ),
    "stribeck_friction": (
        {"a": [0.1, 0.05], "d": [0.1, 0.1], "v_s": [0.2, 0.3]},
        lambda x: [
            0,
            0,
            -(0.1 + 0.1 * np.exp(-((x[2] / 0.2) ** 2))) * np.tanh(x[2] / 1e-4),
            0,
            -(0.05 + 0.1 * np.exp(-((x[4] / 0.3) ** 2))) * np.tanh(x[4] / 1e-4),
        ],
    ),
    "quadratic_drag": ({"c": [0.9, 1.5]}, lambda x: [0, 0, -0.9 * abs(x[2]) * x[2], 0, -1.5 * abs(x[4]) * x[4]]),
    "linear_spring": ({"k": [1.5, 0.7]}, lambda x: [0, 0, -1.5 * x[0], 0, -0.7 * x[3]]),
    "cubic_spring": ({"k": [2.0, -0.9]}, lambda x: [0, 0, -2.0 * x[0] ** 3, 0, 0.9 * x[3] ** 3]),
    "constant_force": ({"a": [0.4, -0.3]}, lambda x: [0, 0, 0.4, 0, -0.3]),
    "leak": ({"r": [0.5]}, lambda x: [0, -0.5 * x[1], 0, 0, 0]),
    "inflow": ({"f": [-0.2]}, lambda x: [0, -0.2, 0, 0, 0]),
    "power_law": ({"c": [0.3], "n": [1.7]}, lambda x: [0, -0.3 * np.sign(x[1]) * abs(x[1]) ** 1.7, 0, 0, 0]),
}
#: power of the unit of lengths that a number is in
POWERS = {
    "viscous_friction": 0, "coulomb_friction": 1, "stribeck_friction": 1, "quadratic_drag": -1, "linear_spring": 0,
    "cubic_spring": -2, "constant_force": 1, "leak": 0, "inflow": 1,
}  # fmt: skip
#: one of each kind; the others differ by their equation, which is compared with a solver as it is
OF_A_KIND = {"stribeck_friction", "quadratic_drag", "power_law"}
START = np.array([0.8, 1.0, -0.2, -0.5, 0.6])


def forces(dt: float) -> np.ndarray:
    """Held for half a second, over six seconds."""
    return np.repeat(np.random.default_rng(5).normal(0.6, 1.0, 12), round(0.5 / dt))


@cache
def solved(name: str | None) -> np.ndarray:
    """States at every half second."""
    more = CASES[name][1] if name else lambda x: [0.0] * 5

    def slope(_: float, x: np.ndarray, u: float) -> np.ndarray:
        way, level, speed, other, rate = x
        return np.array([speed, 0.3 * u - 0.1 * level, u - 2 * way, rate, way - 3 * other]) + np.array(more(x))

    x, found = START, []
    for u in forces(0.5):
        x = solve_ivp(slope, (0.0, 0.5), x, method="LSODA", args=(u,), rtol=1e-9, atol=1e-10).y[:, -1]
        found.append(x)
    return np.array(found)


@cache
def with_effect(name: str, dt: float, only_steps: bool) -> Physics:
    physics = carts(dt=dt)
    physics = physics._replace(extension=None) if only_steps else physics
    return add_effect(physics, name, **CASES[name][0])


@partial(quick_jit, static_argnums=0)
def states(step: Any, params: Any, x: jax.Array, u: jax.Array) -> jax.Array:
    def body(x, one):
        x = step(params, x, one)
        return x, x

    return jax.lax.scan(body, x, u)[1]


def simulated(physics: Physics, start: Any = START, numbers: Any = None, unit: float = 1.0) -> np.ndarray:
    """By the steps of `physics`, with its own numbers or those of the same in another unit."""
    params = jax.tree.map(jnp.asarray, physics.params if numbers is None else numbers)
    u = forces(physics.dt)[:, None]
    return np.asarray(states(physics.step, params, unit * jnp.asarray(start), jnp.asarray(u)))


def error(name: str, dt: float, *, only_steps: bool) -> float:
    """Largest error at the half seconds, in parts of what the effect changes."""
    found = simulated(with_effect(name, dt, only_steps))[round(0.5 / dt) - 1 :: round(0.5 / dt)]
    moved = np.abs(solved(name) - solved(None)).max()
    assert moved > 0.1, "this record says nothing about the effect"
    return float(np.abs(found - solved(name)).max() / moved)


def effect(name: str, physics: Physics) -> Effect:
    return next(one for one in generic_effects(physics) if one.name == name)


@pytest.mark.parametrize("name", CASES)
def test_an_effect_is_what_its_equation_says(name):
    """A term of the derivative is as accurate as the integrator; dry friction is of second order."""
    coarse, fine = error(name, 0.05, only_steps=False), error(name, 0.025, only_steps=False)
    assert coarse < {"coulomb_friction": 3e-4, "stribeck_friction": 2e-3}.get(name, 1e-4)
    assert fine < coarse / (3.0 if name.endswith(("coulomb_friction", "stribeck_friction")) else 10.0)


@pytest.mark.parametrize(
    "name", [name if name in OF_A_KIND else pytest.param(name, marks=pytest.mark.compiles) for name in CASES]
)
def test_of_a_physics_that_has_only_steps_it_is_of_second_order(name):
    coarse, fine = error(name, 0.05, only_steps=True), error(name, 0.025, only_steps=True)
    assert coarse < 0.006
    assert fine < coarse / 3.0


@pytest.mark.parametrize("name", CASES)
@settings(max_examples=2, deadline=None)
@given(unit=st.floats(1e-3, 1e3))
def test_units_change_no_answer(name, unit):
    """The same numbers in other units move the same carts, and fits begin at the same ones."""
    with jax.enable_x64(True):
        one, other = effect(name, carts()), effect(name, carts(unit))
        span = np.array([[-0.4, 0.1, -1.0, -0.6, -0.7], [0.9, 2.0, 0.8, 0.5, 0.9]])
        here, there = (SignalRange(s * span, np.zeros((2, 1)), s * span[:, :2]) for s in (1.0, unit))
        for given_, rescaled in zip(one.guesses(here), other.guesses(there), strict=True):
            for key, value in given_.items():
                np.testing.assert_allclose(rescaled[key], in_unit(name, given_, unit)[key], rtol=1e-12)
                low, high = one.parameters[key].bounds
                assert np.all((value >= low) & (value <= high) & (value != one.parameters[key].neutral))
        numbers = {key: np.array(value) for key, value in CASES[name][0].items()}
        here, there = with_effect(name, 0.05, False), add_effect(carts(unit), other, **in_unit(name, numbers, unit))
        found, expected = simulated(here, numbers=there.params, unit=unit), unit * simulated(here)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * unit)


def in_unit(name: str, numbers: Any, unit: float) -> dict[str, Any]:
    if name == "power_law":
        return {"c": numbers["c"] * unit ** (1.0 - numbers["n"]), "n": numbers["n"]}
    return {key: value * unit ** POWERS[name] for key, value in numbers.items()}


def test_numbers_have_the_units_of_the_states():
    alone = carts()._replace(states=carts().states[:3])
    units = {one.name: next(iter(one.parameters.values())).unit for one in generic_effects(alone)}
    assert units == {
        "viscous_friction": "1/s", "coulomb_friction": "m/s^2", "stribeck_friction": "m/s^2", "quadratic_drag": "1/m",
        "linear_spring": "1/s^2", "cubic_spring": "1/(s^2 m^2)", "constant_force": "m/s^2", "leak": "1/s",
        "inflow": "V/s", "power_law": "", "hysteresis": "1/s^2", "hard_stop": "m", "ceiling": "V", "floor": "V",
        "backlash": "",
    }  # fmt: skip
    assert effect("coulomb_friction", carts()).parameters["a"].unit == ""  # the other cart's is not known
    assert "speed, rate" in effect("coulomb_friction", carts()).equation


@pytest.mark.compiles
def test_steps_with_every_effect_are_written_out_in_numbers():
    """All at once for one velocity, for two of them one by one."""
    groups = [(oscillator(), catalogue(oscillator())), *((carts(), [one]) for one in generic_effects(carts()))]
    for physics, effects in groups:
        assert build_problem(physics, effects).code.written_out is not None


@pytest.mark.compiles
@pytest.mark.parametrize("only_steps", [False, True])
def test_derivatives_are_finite_at_every_kink(only_steps):
    physics = carts()._replace(extension=None) if only_steps else carts()
    for name, (numbers, _) in CASES.items():
        physics = add_effect(physics, name, **(numbers if name != "power_law" else {"c": 0.3, "n": 0.3}))
    slope = quick_jit(jax.jacfwd(physics.step, (0, 1)))
    params = jax.tree.map(jnp.asarray, physics.params)
    for x in (np.zeros(5), -START, START, [1e-300, -1e-300, 0.0, 1e-9, -1e-12], [0.0, -2.0, 1e-3, 0.0, -1e-3]):
        for u in (0.0, 1.5):
            found = jax.tree.leaves(slope(params, jnp.asarray(x), jnp.full(1, u)))
            assert all(np.isfinite(leaf).all() for leaf in found)


@pytest.mark.parametrize("n", [0.3, 0.999, 1.0, 1.001, 2.0, 4.0])
def test_a_power_law_alone_is_its_solution_and_empties_at_most(n):
    still = carts()._replace(step=lambda p, x, u: x, extension=None)
    physics = add_effect(still, "power_law", c=0.7, n=n)
    step, params, h, c = quick_jit(physics.step), jax.tree.map(jnp.asarray, physics.params), 0.05, 0.7
    for level in (-3.0, -1e-3, 0.0, 1e-6, 0.02, 5.0):
        found = step(params, np.eye(5)[1] * level, np.zeros(1))[1]
        left = abs(level) ** (1 - n) - (1 - n) * c * h if level and n != 1 else np.inf
        expected = np.exp(-c * h) * abs(level) if n == 1 or not level else max(left, 0.0) ** (1 / (1 - n))
        np.testing.assert_allclose(found, np.sign(level) * expected, rtol=1e-7, atol=1e-9)


def test_a_vessel_with_an_orifice_runs_empty_and_stays_so():
    """√x has an infinite slope at zero, where the last drops run out slowly in place of at once."""
    physics = add_effect(carts(), "power_law", c=0.7, n=0.5)
    params = jax.tree.map(jnp.asarray, physics.params)
    step, slope = quick_jit(physics.step), quick_jit(jax.jacfwd(physics.step, (0, 1)))
    x = jnp.asarray([0.0, 1.0, 0.0, 0.0, 0.0])
    for k in range(100):
        x = step(params, x, jnp.zeros(1))
        without_leak = max(np.sqrt(1.0) - 0.35 * 0.05 * (k + 1), 0.0) ** 2  # and without the vessel's own 0.1 x
        assert -1e-12 <= x[1] <= without_leak + (0.7 * 0.05) ** 2
        found = jax.tree.leaves(slope(params, x, jnp.zeros(1)))
        assert all(np.isfinite(leaf).all() and np.abs(leaf).max() < 1e3 for leaf in found)
    assert x[1] < 1e-6


def test_friction_stops_a_cart_and_never_turns_it_around():
    physics = add_effect(carts(), "coulomb_friction", a=100.0)
    found = simulated(physics, np.array([0.1, 0.0, 0.5, 0.2, -0.5]))
    np.testing.assert_array_equal(found[:, [2, 4]], 0.0)
    np.testing.assert_allclose(found[:, [0, 3]], [0.1, 0.2] * np.ones((len(found), 1)), atol=0.2)


def test_the_catalogue_of_a_users_physics_has_what_its_states_allow():
    def names(physics: Physics) -> list[str]:
        return [one.name for one in catalogue(physics)]

    first = ["periodic_disturbance", *FORCES, *FLOWS, "backlash"]
    assert names(carts())[: len(first)] == first
    states = carts().states
    assert not set(FLOWS) & set(names(carts()._replace(states=(states[0], *states[2:]))))
    assert not set(FORCES) & set(names(carts()._replace(states=tuple(Signal(s.name) for s in states))))
    without_position = carts()._replace(states=states[1:])  # of the first cart, whose way is measured
    assert effect("viscous_friction", without_position).shapes == {"c": (2,)}
    assert effect("linear_spring", without_position).shapes == {"k": (1,)}
    chain = tuple(
        Signal(s, rate_of=of) for s, of in (("q", None), ("v", "q"), ("thrust", "v"), ("a", None), ("b", None))
    )
    found = carts()._replace(states=chain)  # a rate of a rate is no velocity: a force acts on v
    assert effect("quadratic_drag", found).equation.endswith("(v: v)")
    assert effect("leak", found).equation.endswith("(x: a, b)")
    for physics in (cascaded_tanks(), lgssm(), arm()):
        assert not {"quadratic_drag", "cubic_spring", "constant_force", "leak", "inflow"} & set(names(physics))


def test_another_physics_or_sample_time_is_refused():
    one = effect("viscous_friction", carts())
    with pytest.raises(ValueError, match="viscous_friction: expected the states way, level, speed, other, rate and dt"):
        add_effect(cascaded_tanks(), one)
    with pytest.raises(ValueError, match="and dt=0.05 s, found physics 'carts'"):
        add_effect(carts(dt=0.1), one)
