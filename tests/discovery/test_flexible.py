"""Which equations nonparametric corrections are tried in, for few and for many states."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.flexible import KNOTS, continued, families, hats
from pgrssnn_jax.physics.tanks import cascaded_tanks

LENGTH = 5


def chain() -> pg.Physics:
    """dx_1/dt = -k x_1 + b u, dx_i/dt = k (x_{i-1} - x_i); x_5 is measured."""

    def rate(p, x, u):
        return p["k"] * (jnp.concatenate([p["b"] * u, x[:-1]]) - x)

    states = tuple(pg.Signal(f"level_{i + 1}", "m") for i in range(LENGTH))
    return pg.continuous(
        "chain",
        rate,
        lambda p, x, u: x[-1:],
        {"k": 2.0, "b": 1.0},
        parameters={"k": pg.Parameter("k", "1/s", bounds=(0.05, 5.0)), "b": pg.Parameter("b", bounds=(0.1, 10.0))},
        dt=0.2,
        states=states,
        inputs=(pg.Signal("flow", "m"),),
        outputs=(pg.Signal("level", "m", like="level_5"),),
    )


def masses() -> pg.Physics:
    """Three masses in a row, the first one pushed: positions, then their rates."""

    def rate(p, x, u):
        q, v = x[:3], x[3:]
        return jnp.concatenate([v, p["k"] * (jnp.roll(q, 1) - q) + jnp.array([1.0, 0.0, 0.0]) * u])

    positions = [pg.Signal(f"q{i}", "m", like="q0") for i in range(3)]
    rates = [pg.Signal(f"v{i}", "m/s", rate_of=f"q{i}") for i in range(3)]
    return pg.continuous(
        "masses",
        rate,
        lambda p, x, u: x[:1],
        {"k": 1.0},
        dt=0.1,
        states=(*positions, *rates),
        inputs=(pg.Signal("force", "N"),),
        outputs=(pg.Signal("q0", "m"),),
    )


def test_of_few_states_each_is_corrected_by_every_signal():
    names = set(families(cascaded_tanks()))
    assert {"lower_level by upper_level", "upper_level by pump_voltage", "pump_voltage by its history"} <= names


def test_of_many_first_order_states_each_is_corrected_by_itself():
    """Nothing but inputs and outputs were, because no state is the rate of another one."""
    found = {name for name, where in families(chain()).items() if where.kind == "state"}
    assert found == {f"level_{i} by level_{i}" for i in range(1, LENGTH + 1)}
    assert "flow by its history" in families(chain())


def test_of_many_mechanical_states_the_rates_are_corrected_by_themselves_and_by_their_positions():
    found = {name for name, where in families(masses()).items() if where.kind == "state"}
    assert {f"v{i} by v{i}" for i in range(3)} <= found
    assert not any(name.startswith("q") for name in found), "dq/dt = v holds by definition"


def test_a_curve_of_a_reading_goes_on_where_a_saturated_sensor_shows_nothing():
    """y + f(y) = min(y, s) of readings beyond the reach too; between the knots f is that of the dynamics."""
    low, high = jnp.asarray(-1.0), jnp.asarray(2.5)
    knots = jnp.linspace(low, high, KNOTS)
    limit = knots[-3]
    y = jnp.linspace(low - 4.0, high + 4.0, 501)
    curve = jax.vmap(lambda one: continued(one, low, high, jnp.minimum(limit - knots, 0.0)))(y)
    np.testing.assert_allclose(y + curve, np.minimum(y, limit), atol=1e-5)
    c = jnp.asarray(np.random.default_rng(0).standard_normal(KNOTS))
    inside = y[(y >= low) & (y <= high)]
    one, other = (jax.vmap(lambda v, f=f: f(v, low, high, c))(inside) for f in (continued, hats))
    np.testing.assert_allclose(one, other, atol=1e-5)


@pytest.mark.slow
def test_a_delay_that_the_catalogue_lacks_is_unknown_in_a_chain():
    """It was `unexplained`, at four times the noise, while the history of an input was not tried."""

    def emptied(t, x, flow):
        return 2.2 * (np.append(flow, x[:-1]) - x)

    def recorded(seed: int) -> pg.Record:
        draw = np.random.default_rng(seed)
        u = np.repeat(draw.uniform(0.5, 2.0, 90), 10)
        late, x, y = np.append(np.full(4, u[0]), u)[: len(u)], np.full(LENGTH, u[0]), []
        for flow in late:
            x = solve_ivp(emptied, (0.0, 0.2), x, args=(flow,), rtol=1e-8).y[:, -1]
            y.append(x[-1])
        measured = np.array(y)[:, None] + 0.01 * draw.standard_normal((len(u), 1))
        return pg.record(u[:, None], measured, dt=0.2, inputs={"flow": "m"}, outputs={"level": "m"})

    found = pg.discover(chain(), recorded(0), recorded(1), without=["input_delay"], network_epochs=0, quiet=True)
    assert found.verdict == "unknown_effect"
    assert "flow depends on its past" in found.sentence
