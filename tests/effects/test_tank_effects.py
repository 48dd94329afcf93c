"""Effects of the tanks against a plant in NumPy with forty steps per sample, in which they act all the time."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from discovery.small_cases import fine_tanks, pump
from scipy.integrate import solve_ivp
from toys import quick_jit

from pgrssnn_jax.effects.base import Effect, SignalRange, add
from pgrssnn_jax.effects.tanks import tank_effects
from pgrssnn_jax.physics.base import Params, Physics
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.usefixtures("x64")
U, START = pump(250, 3, high=5.0), (3.0, 2.0)
#: numbers of an effect, the same for the plant, and how far levels may be apart, in parts of what it changes
CASES = {
    "overflow_1to2": ({"level": 4.5, "share": 0.7}, {"rim": 4.5, "share": 0.7}, 0.03),
    "overflow_lost": ({"level": 4.5}, {"rim": 4.5}, 0.03),
    "tank2_overflow": ({"level": 4.0}, {"rim2": 4.0}, 0.03),
    "pump_dead_zone": ({"voltage": 1.2}, {"dead": 1.2}, 1e-3),
    "pump_saturation": ({"voltage": 3.0}, {"most": 3.0}, 1e-3),
    "pump_nonlinearity": ({"curvature": -0.4, "exponent": 1.3}, {"curve": -0.4, "power": 1.3}, 1e-3),
    "leak_tank1": ({"rate": 0.004}, {"leak": 0.004}, 2e-3),
    "bypass": ({"share": 0.3}, {"bypass": 0.3}, 2e-3),
    "outlet_exponent": ({"exponent": 0.65}, {"exponent": 0.65}, 2e-3),
}
NAMES = sorted(CASES)


def tanks():
    return cascaded_tanks(integrator="rk4")


@cache
def effect(name: str) -> Effect:
    return next(e for e in tank_effects(tanks()) if e.name == name)


@cache
def changed(name: str | None) -> Physics:
    return tanks() if name is None else add(tanks(), effect(name), numbers={name: CASES[name][0]})


def numbers_of(name: str | None, numbers: dict | None) -> Params:
    """Of the tanks with the effect; its own by default."""
    physics = changed(name) if numbers is None else add(tanks(), effect(name), numbers={name: numbers})
    return jax.tree.map(jnp.asarray, physics.params)


@cache
def free_run(name: str | None):
    def run(params, start, u):
        def body(x, v):
            x = changed(name).step(params, x, v)
            return x, x

        return jax.lax.scan(body, start, u)[1]

    return quick_jit(run)


def levels(name: str | None, numbers: dict | None = None, u=U, start=START) -> np.ndarray:
    """States `[time, 2]` of the free run."""
    return np.asarray(free_run(name)(numbers_of(name, numbers), jnp.asarray(start), jnp.asarray(u)[:, None]))


def step(name: str | None, x, u, numbers: dict | None = None) -> np.ndarray:
    """Not compiled as a whole, which would round each physics in its own way."""
    each = jax.vmap(changed(name).step, (None, 0, 0))
    return np.asarray(each(numbers_of(name, numbers), jnp.asarray(x), jnp.asarray(u)))


def many(seed: int, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    return draw.uniform(0.0, 9.0, (count, 2)), draw.uniform(0.0, 6.0, (count, 1))


@pytest.fixture(scope="module")
def plant() -> dict[str, np.ndarray]:
    """Levels of every case, and of none."""
    keys = sorted({key for _, numbers, _ in CASES.values() for key in numbers})
    neutral = {"rim": np.inf, "rim2": np.inf, "most": np.inf, "exponent": 0.5, "power": 1.0}
    rows = [numbers for _, numbers, _ in CASES.values()] + [{}]
    arrays = {key: np.array([row.get(key, neutral.get(key, 0.0)) for row in rows]) for key in keys}
    found = fine_tanks(U, START, **arrays)
    return {name: found[..., i] for i, name in enumerate([*CASES, "none"])}


def test_the_plant_without_effects_is_the_physics(plant):
    np.testing.assert_allclose(levels(None), plant["none"], atol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_is_what_happens_in_the_plant(name, plant):
    numbers, _, tolerance = CASES[name]
    moved, error = plant[name] - plant["none"], levels(name, numbers) - plant[name]
    assert np.abs(moved).max() > 0.2, "this record says nothing about the effect"
    assert np.abs(error).max() < tolerance * np.abs(moved).max()


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_what_spills_lands_in_the_lower_tank_to_its_share(share):
    x, u = many(8, 2000)
    free, lost = step(None, x, u), step("overflow_lost", x, u, {"level": 4.5})
    kept = step("overflow_1to2", x, u, {"level": 4.5, "share": share})
    spilled = free.sum(1) - lost.sum(1)
    assert np.all(spilled >= -1e-12)
    np.testing.assert_array_equal(spilled > 1e-12, free[:, 0] > 4.5 + 1e-12)
    np.testing.assert_allclose(free.sum(1) - kept.sum(1), (1 - share) * spilled, atol=1e-12)
    np.testing.assert_allclose(kept[:, 0], lost[:, 0], atol=1e-12)
    # a sample leaves the upper tank at its rim, but for what ran through the drain while it stood above it
    dry = free[:, 0] <= 4.5
    np.testing.assert_array_equal(kept[dry], free[dry])


@pytest.mark.parametrize("name", ["overflow_1to2", "overflow_lost"])
def test_a_full_upper_tank_stays_at_its_rim(name):
    found = levels(name, {"level": 4.5}, u=np.full(200, 6.0))[50:, 0]
    np.testing.assert_allclose(found, 4.5, rtol=0.01)


def test_pump_limits_are_clipped_inputs():
    u = np.concatenate([pump(60, 1), np.linspace(-1.0, 8.0, 60)])
    for name, numbers, changed in (
        ("pump_saturation", {"voltage": 2.5}, np.clip(u, None, 2.5)),
        ("pump_dead_zone", {"voltage": 0.7}, np.where(u > 0, np.clip(u - 0.7, 0.0, None), u)),
        ("pump_nonlinearity", {"curvature": 0.2}, u + 0.02 * u**2),
    ):
        np.testing.assert_allclose(levels(name, numbers, u), levels(None, u=changed), rtol=1e-12)


def test_the_lower_tank_never_stands_above_its_rim():
    x, u = many(5)
    free, found = step(None, x, u), step("tank2_overflow", x, u, {"level": 4.0})
    np.testing.assert_array_equal(found, np.stack([free[:, 0], np.minimum(free[:, 1], 4.0)], 1))


def test_a_bypass_takes_from_the_upper_tank_what_it_gives_to_the_lower():
    x = np.array([[2.0, 3.0]])
    u = np.array([[3.0]])
    free, found = step(None, x, u), step("bypass", x, u, {"share": 0.25})
    passed = 4.0 * 0.25 * 0.0412 * 3.0
    np.testing.assert_allclose(found - free, [[-passed, passed]], rtol=0.06)


@pytest.mark.parametrize("level", [0.2, 0.8, 5.0])
def test_an_outlet_exponent_counts_at_every_level(level):
    x, u, own = np.array([[0.0, level]]), np.array([[0.0]]), tanks().params
    flows = (lambda t, y, power=power: own["k5"] * y - own["k4"] * y**power for power in (0.5, 0.7))
    free, expected = (solve_ivp(flow, (0.0, 4.0), [level], rtol=1e-9).y[0, -1] for flow in flows)
    found = step("outlet_exponent", x, u, {"exponent": 0.7}) - step(None, x, u)
    np.testing.assert_allclose(found[0, 1], expected - free, rtol=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_empty_tanks_have_finite_derivatives(name):
    one = effect(name)
    reach = SignalRange(np.array([[1.0, 1.0], [6.0, 6.0]]), np.array([[0.0], [5.0]]), np.array([[1.0], [6.0]]))
    slopes = quick_jit(jax.jacfwd(changed(name).step, (0, 1)))
    for numbers in (one.neutral(), *one.initial_guesses(reach)):
        found = slopes(numbers_of(name, numbers), jnp.zeros(2), jnp.zeros(1))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


@pytest.mark.parametrize("name", ["overflow_1to2", "overflow_lost", "tank2_overflow"])
def test_an_overflow_acts_where_the_level_is_at_the_rim(name):
    numbers, _, _ = CASES[name]
    one, x = effect(name), levels(name, numbers)
    index = 1 if name == "tank2_overflow" else 0
    acting = one.active(numbers, x, U[:, None])
    moved = np.abs(x - step(None, np.concatenate([[START], x[:-1]]), U[:, None]))[:, index] > 1e-5
    assert 0.02 < moved.mean() < 0.98
    assert np.mean(acting == moved) > 0.98


def test_pump_limits_act_beyond_their_voltage():
    x = np.zeros((len(U), 2))
    assert effect("pump_saturation").active({"voltage": 3.0}, x, U[:, None]).mean() == np.mean(U > 3.0)
    assert effect("pump_dead_zone").active({"voltage": 1.2}, x, U[:, None]).mean() == np.mean(U < 1.2)
