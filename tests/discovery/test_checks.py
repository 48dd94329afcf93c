"""Which physics is refused before anything is fitted."""

import jax.numpy as jnp
import numpy as np
import pytest

import pgrssnn_jax as pg


def tank(root):
    def derivative(p, x, u):
        return jnp.stack([u[0] - p["k"] * root(x[0])])

    return pg.continuous(
        "tank",
        derivative,
        lambda p, x, u: x,
        {"k": 0.5},
        parameters={"k": pg.Parameter("k", "sqrt(m)/s", bounds=(0.0, 2.0))},
        states=(pg.Signal("level", "m", like="level"),),
        inputs=(pg.Signal("inflow", "m/s"),),
        outputs=(pg.Signal("level", "m"),),
        dt=0.1,
    )


def record():
    u = np.concatenate([np.zeros((20, 1)), np.random.default_rng(0).uniform(0.0, 1.0, (180, 1))])
    y = 0.01 * np.random.default_rng(1).standard_normal((200, 1))
    return pg.record(u, y, dt=0.1, inputs={"inflow": "m/s"}, outputs={"level": "m"}, start="rest")


def test_a_derivative_that_is_not_finite_names_the_state_and_the_sample():
    """The free run is finite: the root of an empty tank is zero, with an infinite slope."""
    bad = tank(lambda x: jnp.sqrt(jnp.maximum(x, 0.0)))
    with pytest.raises(ValueError, match=r"physics 'tank': .* finite derivatives .* state 'level' .* sample [01]"):
        pg.discover(bad, record(), record(), network_epochs=0, quiet=True)


def test_a_free_run_that_grows_without_limit_is_refused():
    with pytest.raises(ValueError, match="expected a free run that stays finite"):
        pg.discover(tank(lambda x: -1e6 * (x + 1.0)), record(), record(), network_epochs=0, quiet=True)
