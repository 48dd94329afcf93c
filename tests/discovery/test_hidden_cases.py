"""The hidden cases of the benchmark: noise of the deviation that was asked for, and the same case in other units."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from benchmarks.hidden import noise, suite, units
from benchmarks.hidden.check import free_run
from benchmarks.hidden.nominal import nominal
from benchmarks.hidden.score import wilson
from pgrssnn_jax.effects import add_effect


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


@pytest.mark.parametrize("system", ["tanks", "lgssm", "pendulum", "chain"])
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
