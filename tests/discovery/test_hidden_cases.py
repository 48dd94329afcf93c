"""The hidden cases of the benchmark: noise of the deviation that was asked for, and the same case in other units."""

from collections.abc import Iterator
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from benchmarks.hidden import bench, chain, circuit, drive, hysteretic, noise, reactor, servo, suite, units
from benchmarks.hidden.check import difference, free_run
from benchmarks.hidden.nominal import USERS, nominal
from benchmarks.hidden.score import wilson
from pgrssnn_jax.effects import add_effect
from pgrssnn_jax.effects.systems import catalogue

MODULES = {"hysteretic": hysteretic, "drive": drive, "circuit": circuit, "reactor": reactor}
SAMPLES = {chain: 100, servo: 100, hysteretic: 100, drive: 300, circuit: 100, reactor: 100}


@pytest.fixture(autouse=True, scope="module")
def short() -> Iterator[None]:
    """Plants are simulated in NumPy, sample by sample: fewer of them, and once for all tests of a case."""
    with pytest.MonkeyPatch.context() as patch:
        for module, samples in SAMPLES.items():
            patch.setattr(module, "build", cache(partial(bench.build, module.PLANT._replace(samples=samples))))
        yield


@pytest.mark.parametrize("kind", noise.KINDS)
def test_noise_of_every_kind_has_its_deviation(kind):
    """A t with 2.5 degrees has no variance of its variance: there the quartiles tell."""
    reading = np.sin(np.linspace(0.0, 700.0, 200_000)) * 3.0
    e = noise.errors(np.random.default_rng(0), kind, 0.02, reading)
    if kind == "heavy":
        expected = 0.02 * 5.0**-0.5 * stats.t.ppf(0.75, 2.5)
        np.testing.assert_allclose(np.quantile(np.abs(e), 0.5), expected, rtol=0.02)
    else:
        np.testing.assert_allclose(e.std(), 0.02, rtol=0.08 if kind == "ar99" else 0.02)
    np.testing.assert_allclose(e.mean(), 0.0, atol=0.02 * 0.1)


def test_a_kind_of_noise_changes_nothing_but_the_noise():
    white = suite.build(suite.Plan("servo", 3, "single", ("coulomb_friction",), (), 0.001))
    other = suite.build(suite.Plan("servo", 3, "single", ("coulomb_friction",), (), 0.001, "ar95"))
    np.testing.assert_array_equal(white.train.u, other.train.u)
    assert white.magnitudes["dry"] == other.magnitudes["dry"]
    assert np.abs(np.asarray(white.train.y) - np.asarray(other.train.y)).max() > 0.0


@pytest.mark.parametrize(
    "system",
    ["tanks", "circuit", *(pytest.param(n, marks=pytest.mark.slow) for n in ("lgssm", "pendulum", "chain", "hysteretic",
                                                                             "drive", "reactor"))],
)  # fmt: skip
def test_a_case_in_other_units_is_the_same_case(system):
    plan = suite.plans(system, 1, 300, ("none",))[0]
    here, there = suite.build(plan), suite.build(plan._replace(in_other_units=True))
    with jax.enable_x64(True):
        one, other = nominal(here), nominal(there)
        scale = [there.units[1] if s.like or s.rate_of else 1.0 for s in one.states]
        start = jnp.full(len(one.states), 0.5)
        found = free_run(other, np.asarray(there.test.u, float), start * jnp.array(scale)) / there.units[1]
        np.testing.assert_allclose(found, free_run(one, np.asarray(here.test.u, float), start), atol=1e-10)
    assert there.units == units.drawn(system, plan.seed) != (1.0, 1.0)


def test_effects_act_inside_the_derivative_in_any_unit():
    plan = suite.Plan("servo", 3, "single", ("coulomb_friction",), (), 0.001)
    here, there = suite.build(plan), suite.build(plan._replace(in_other_units=True))
    with jax.enable_x64(True):
        dry, c_y, found = here.magnitudes["dry"], there.units[1], []
        for case, a, scale in ((here, dry, 1.0), (there, dry * c_y, c_y)):
            physics = add_effect(nominal(case), "coulomb_friction", a=a)
            found.append(free_run(physics, np.asarray(case.test.u, float), jnp.full(2, 0.01 * scale)) / scale)
    np.testing.assert_allclose(found[0], found[1], atol=1e-10)


def test_intervals_of_shares_are_wilsons():
    np.testing.assert_allclose(wilson(9, 10), (0.596, 0.982), atol=1e-3)
    assert wilson(0, 10)[0] == pytest.approx(0.0)


@pytest.mark.parametrize("system", MODULES)
def test_without_effects_a_simulator_is_the_physics_of_its_owner(system):
    case = MODULES[system].build(0, noise=0.0)
    with jax.enable_x64(True):
        physics = USERS[system](**case.magnitudes["parameters"])
        found = difference(case, physics, case.magnitudes["start"][1])
    assert np.all(found < 1e-4 * np.asarray(case.test.y).std(axis=(0, 1)))


@pytest.mark.parametrize("system", MODULES)
def test_the_library_has_the_names_of_what_is_hidden(system):
    known = suite.catalogue(system)
    case = MODULES[system].build(0, noise=0.0)
    there = {effect.name for effect in catalogue(nominal(case))}
    assert {name for one in known.named for name in known.removed_with(one)} <= there
    assert there.isdisjoint(known.unnamed)


def test_an_effect_without_a_name_is_hidden_only_to_come_out_as_unknown():
    plans = suite.plans("circuit", 120, 0)
    kinds = {plan.kind for plan in plans if "coil_saturation" in plan.truth}
    assert kinds == {"removed"}


@pytest.mark.parametrize(
    ("system", "name", "effect", "numbers"),
    [
        ("drive", "backlash", "backlash", lambda m: {"half_width": m["u_play"]}),
        ("circuit", "sensor_gain", "sensor_gain", lambda m: {"gain": m["y_gain"]}),
    ],
)
def test_play_and_gain_are_those_of_the_library(system, name, effect, numbers):
    """Play begins where nobody knows: it is forgotten when the input has turned."""
    case = MODULES[system].build(1, (name,), noise=0.0)
    own, plain = case.magnitudes["start"][1], case._replace(physics=case.magnitudes["parameters"])
    with jax.enable_x64(True):
        physics = add_effect(nominal(plain), effect, **numbers(case.magnitudes))
        start = np.zeros(len(physics.states))
        start[: len(own)] = own
        found = free_run(physics, np.asarray(case.test.u, float), start)
    error = np.sqrt(np.mean((found - np.asarray(case.test.y)) ** 2))
    assert error < 0.05 * case.change


def test_an_element_with_hysteresis_loses_energy_and_stays_bounded():
    sizes = hysteretic.build(2, ("hysteresis",), noise=0.0).magnitudes
    q = 0.5 * np.sin(np.linspace(0.0, 4.0 * np.pi, 20_001))
    z = np.zeros_like(q)
    own = {**hysteretic.PLANT.nominal, **sizes}
    for t in range(1, len(q)):
        x = np.array([[q[t - 1]], [q[t] - q[t - 1]], [z[t - 1]]])
        z[t] = z[t - 1] + hysteretic.PLANT.slope(own, x, np.zeros(1))[2, 0]
    top = (sizes["beta"] + sizes["gamma"]) ** (-1 / sizes["n"])
    assert np.abs(z).max() == pytest.approx(top, rel=0.05)
    assert np.trapezoid(z[10_000:], q[10_000:]) > 0.5 * top
