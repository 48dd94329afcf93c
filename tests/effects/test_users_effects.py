"""Effects that a user writes, on a physics that the user wrote: added, simulated, differentiated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_effect_contract import pendulum
from toys import quick_jit

import pgrssnn_jax.effects as effects
from pgrssnn_jax.effects import Effect, Needs, add, add_effect, after_step, catalogue
from pgrssnn_jax.effects.base import SignalRange, WithEffects
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Parameter
from pgrssnn_jax.physics.check import check_physics
from pgrssnn_jax.physics.tanks import cascaded_tanks

pytestmark = pytest.mark.usefixtures("x64")
DT = 0.05
SPAN = SignalRange(np.array([[-1.0, -2.0], [1.0, 2.0]]), np.array([[-1.0], [1.0]]), np.array([[-1.0], [1.0]]))


def twisted_wire(**fields) -> Effect:
    """q̈ = ... - k q³, as a change of speed in every sample."""

    def pull(n, own, x, u, new):
        return new.at[1].add(-DT * n["k"] * x[0] ** 3)

    meaning = Parameter("k", "1/(s² rad²)", bounds=(0.0, 50.0), neutral=0.0)
    return Effect("twisted_wire", {"k": meaning}, lambda physics: after_step(physics, "twisted_wire", pull), **fields)


def simulate(physics, params, u, x0=(0.8, 0.0)):
    def body(x, u_t):
        x = physics.step(params, x, u_t)
        return x, physics.measure(params, x, u_t)

    return jax.lax.scan(body, jnp.asarray(x0), jnp.asarray(u))[1]


def loop(k: float, u: np.ndarray) -> np.ndarray:
    """The same in NumPy: RK4 of the pendulum, then the spring's change of speed."""

    def f(x, v):
        return np.array([x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1] + v])

    x, found = np.array([0.8, 0.0]), []
    for (v,) in u:
        k1 = f(x, v)
        k2 = f(x + 0.5 * DT * k1, v)
        k3 = f(x + 0.5 * DT * k2, v)
        k4 = f(x + DT * k3, v)
        x = x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4) - np.array([0.0, DT * k * x[0] ** 3])
        found.append(x[:1])
    return np.array(found)


U = np.sin(0.3 * np.arange(60))[:, None]


def test_three_fields_make_an_effect():
    changed = add(pendulum(), twisted_wire())
    check_physics(changed, "here")
    assert changed.params == WithEffects({"g": 9.81, "c": 0.1}, {"twisted_wire": {"k": 0.0}})
    assert changed.parameters.effects["twisted_wire"]["k"].symbol == "k"
    found = simulate(changed, jax.tree.map(jnp.asarray, changed.params), U)
    np.testing.assert_array_equal(found, simulate(pendulum(), pendulum().params, U))


def test_it_is_simulated_and_differentiated():
    changed = add_effect(pendulum(), twisted_wire(), k=12.0)
    params = jax.tree.map(jnp.asarray, changed.params)

    def run(params):
        return simulate(changed, params, U)

    np.testing.assert_allclose(quick_jit(run)(params), loop(12.0, U), rtol=1e-10)

    def at(k):
        return params._replace(effects={"twisted_wire": {"k": k}})

    slope = quick_jit(jax.jacfwd(lambda k: run(at(k))))(12.0)
    np.testing.assert_allclose(slope, (loop(12.0 + 1e-5, U) - loop(12.0 - 1e-5, U)) / 2e-5, rtol=1e-5, atol=1e-8)
    pulled = quick_jit(jax.grad(lambda params: run(params).sum()))(params)
    np.testing.assert_allclose(pulled.effects["twisted_wire"]["k"], slope.sum(), rtol=1e-9)


def test_fits_begin_between_neutral_and_the_bound():
    assert [float(start["k"]) for start in twisted_wire().guesses(SPAN)] == [0.0, 5.0, 25.0]
    free = {"k": Parameter("k", neutral=2.0)}
    assert [float(start["k"]) for start in twisted_wire()._replace(parameters=free).guesses(SPAN)] == [2.0]
    given = twisted_wire(initial_guesses=lambda span: [{"k": span.x[1, 0]}])
    assert given.guesses(SPAN) == [{"k": 1.0}]
    limit = twisted_wire()._replace(parameters={"level": Parameter("L", neutral=np.inf)})
    with pytest.raises(ValueError, match="twisted_wire: expected initial_guesses beside an infinite neutral"):
        limit.guesses(SPAN)
    with pytest.raises(ValueError, match="twisted_wire.k: expected a neutral value, found none"):
        add(pendulum(), twisted_wire()._replace(parameters={"k": Parameter("k")}))


def test_the_catalogue_takes_it_at_its_end():
    known = effects.catalogue(pendulum())
    assert catalogue(pendulum(), extra=[twisted_wire()])[-1].name == "twisted_wire"
    assert len(catalogue(pendulum(), extra=[twisted_wire()])) == len(known) + 1
    taken = twisted_wire()._replace(name="sensor_offset")
    with pytest.raises(ValueError, match="extra effects with names of their own, found another 'sensor_offset'"):
        catalogue(pendulum(), extra=[taken])
    with pytest.raises(ValueError, match="found another 'twisted_wire'"):
        catalogue(pendulum(), extra=[twisted_wire(), twisted_wire()])
    own = next(effect for effect in known if effect.name == "sensor_offset")._replace(title="of one's own")
    assert catalogue(pendulum(), without=["sensor_offset"], extra=[own])[-1] is own
    of_angle = Needs("a state called angle", lambda physics: any(s.name == "angle" for s in physics.states))
    assert catalogue(pendulum(), extra=[twisted_wire(needs=of_angle)])
    with pytest.raises(ValueError, match="twisted_wire: expected a state called angle, found physics 'tanks'"):
        catalogue(cascaded_tanks(), extra=[twisted_wire(needs=of_angle)])


def test_one_number_stands_for_all_channels_and_none_for_no_limit():
    physics = add_effect(arm(), "coulomb_friction", Tc=0.3)
    np.testing.assert_array_equal(physics.params.effects["coulomb_friction"]["Tc"], np.full(6, 0.3))
    physics = add_effect(physics, "joint_limit", lower=None, upper=[0.1, None, 0.2, None, None, 1.0])
    limits = physics.params.effects["joint_limit"]
    np.testing.assert_array_equal(limits["lower"], np.full(6, -np.inf))
    np.testing.assert_array_equal(limits["upper"], [0.1, np.inf, 0.2, np.inf, np.inf, 1.0])
    with pytest.raises(ValueError, match=r"joint_limit.upper: expected shape \(6,\), found \(2,\)"):
        add_effect(arm(), "joint_limit", upper=[0.1, 0.2])
    with pytest.raises(
        ValueError, match=r"payload: expected \['distance', 'gyration', 'mass', 'x', 'y'\], found 'weight'"
    ):
        add_effect(arm(), "payload", weight=1.0)
    with pytest.raises(ValueError, match=r"expected some of \['torque_gain', .* of physics 'arm', found 'load'"):
        add_effect(arm(), "load", mass=1.0)
    with pytest.raises(ValueError, match="expected each effect once, found 'coulomb_friction'"):
        add_effect(physics, "coulomb_friction")
