import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pgrssnn_jax.physics.base import Parameter, Signal, continuous, discrete, is_parameter
from pgrssnn_jax.physics.check import check_physics
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.signals import checked_span
from pgrssnn_jax.physics.tanks import cascaded_tanks

SIGNALS = {"states": (Signal("x"),), "inputs": (Signal("u"),), "outputs": (Signal("y"),)}


def decay(p, x, u):
    return -p["rate"] * x + u


def read(p, x, u):
    return x


@pytest.mark.parametrize(
    "physics",
    [
        cascaded_tanks(),
        cascaded_tanks(clamp=True),
        lgssm(A=[[0.5]], B=[[1.0]], C=[[2.0]]),
        discrete("nested", decay, read, {"rate": 1.0, "more": {"list": [1.0, np.ones(3)]}}, dt=1.0, **SIGNALS),
    ],
    ids=["tanks", "clamped", "lgssm", "nested"],
)
def test_parameter_tree_has_the_shape_of_the_numbers(physics):
    meanings = jax.tree.leaves(physics.parameters, is_leaf=is_parameter)
    assert meanings
    assert all(isinstance(m, Parameter) for m in meanings)
    assert jax.tree.structure(physics.parameters, is_leaf=is_parameter) == jax.tree.structure(physics.params)
    # "freeze one number" is therefore one `tree.map`
    kept = jax.tree.map(
        lambda m, a: np.all((m.bounds[0] <= a) & (a <= m.bounds[1])),
        physics.parameters,
        physics.params,
        is_leaf=is_parameter,
    )
    assert all(jax.tree.leaves(kept))


def test_discrete_takes_functions_and_numbers_as_they_are():
    physics = discrete("d", decay, read, {"rate": 0.5}, dt=2.0, output_timing="before_step", **SIGNALS)
    assert physics.params == {"rate": 0.5}
    assert (physics.dt, type(physics.dt)) == (2.0, float)
    assert physics.output_timing == "before_step"
    x = physics.step(physics.params, jnp.ones(1), jnp.full(1, 3.0))
    np.testing.assert_allclose(x, [2.5])
    np.testing.assert_allclose(physics.measure(physics.params, x, x), [2.5])


def test_continuous_integrates_over_one_sample():
    p = {"rate": 0.5}
    for integrator, expected in [("euler", 1 - 0.1), ("rk4", np.exp(-0.1))]:
        physics = continuous("c", decay, read, p, dt=0.2, integrator=integrator, **SIGNALS)
        x = physics.step(physics.params, jnp.ones(1), jnp.zeros(1))
        np.testing.assert_allclose(x, [expected], rtol=1e-6)
    halves = continuous("c", decay, read, p, dt=0.2, integrator="euler", sub_steps=2, **SIGNALS)
    np.testing.assert_allclose(halves.step(p, jnp.ones(1), jnp.zeros(1)), [(1 - 0.05) ** 2], rtol=1e-6)


@pytest.mark.parametrize("parameters", [{}, {"other": Parameter()}, {"rate": {"value": Parameter()}}])
def test_parameters_of_another_shape_are_refused(parameters):
    with pytest.raises(ValueError, match=r"physics 'd': parameters: expected the tree of params"):
        discrete("d", decay, read, {"rate": 0.5}, parameters=parameters, dt=1.0, **SIGNALS)


@pytest.mark.parametrize("kind", ["like", "rate_of"])
def test_states_resemble_outputs_that_exist(kind):
    signals = {**SIGNALS, "states": (Signal("x", **{kind: "z"}),)}
    with pytest.raises(ValueError, match=r"state 'x': expected .*one of \['y'\], found 'z'"):
        discrete("d", decay, read, {"rate": 0.5}, dt=1.0, **signals)


@pytest.mark.parametrize("dt", [0.0, -1.0, float("nan")])
def test_sample_time_is_positive(dt):
    with pytest.raises(ValueError, match=rf"dt: expected a positive sample time in seconds, found {dt}"):
        discrete("d", decay, read, {"rate": 0.5}, dt=dt, **SIGNALS)
    with pytest.raises(ValueError, match="dt: expected a positive"):
        continuous("c", decay, read, {"rate": 0.5}, dt=dt, **SIGNALS)


def test_continuous_passes_the_integrators_errors_on():
    with pytest.raises(ValueError, match="integrator: expected one of"):
        continuous("c", decay, read, {"rate": 0.5}, dt=1.0, integrator="midpoint", **SIGNALS)
    with pytest.raises(ValueError, match="sub_steps: expected at least 1"):
        continuous("c", decay, read, {"rate": 0.5}, dt=1.0, sub_steps=0, **SIGNALS)


def test_parameter_is_one_leaf_of_meaning():
    assert is_parameter(Parameter("k", "1/s"))
    assert not is_parameter(("k", "1/s"))
    assert Parameter().trainable
    assert Parameter().bounds == (-np.inf, np.inf)


def test_check_physics_finds_wrong_shapes_without_computing():
    good = discrete("d", decay, read, {"rate": 0.5}, dt=1.0, **SIGNALS)
    check_physics(good, "here")
    with pytest.raises(ValueError, match="physics: here: expected it to return a Physics, found dict"):
        check_physics({}, "here")
    with pytest.raises(ValueError, match=r"physics 'd': measure: expected shape \(1,\), found \(2,\)"):
        check_physics(good._replace(measure=lambda p, x, u: jnp.ones(2)), "here")
    with pytest.raises(ValueError, match=r"physics 'd': step: expected shape \(1,\), found \(\)"):
        check_physics(good._replace(step=lambda p, x, u: x[0]), "here")
    with pytest.raises(ValueError, match=r"physics 'd': step: .*found KeyError: 'speed'"):
        check_physics(good._replace(step=lambda p, x, u: x * p["speed"]), "here")


def test_a_span_ends_at_its_numbers_and_at_infinity_where_no_float_holds_them():
    largest = np.finfo(np.float64).max
    assert checked_span("here", (-largest, largest)) == (-largest, largest)
    assert checked_span("here", [-(10**400), 10**400]) == (-np.inf, np.inf)
    assert checked_span("here", (2, 2)) == (2.0, 2.0)
    for wrong in ((1.0, 0.0), (0.0, np.nan), (0.0, "1"), (0.0, 1.0, 2.0), 0.0):
        with pytest.raises(ValueError, match=r"here: expected \(low, high\) with low ≤ high, found"):
            checked_span("here", wrong)


def test_a_physics_shows_its_signals_and_numbers():
    numbers = {"rate": 0.51234, "more": {"gains": np.array([1.0, 2.5])}}
    meanings = {"rate": Parameter("r", "1/s"), "more": {"gains": Parameter("g")}}
    physics = discrete("d", decay, read, numbers, dt=0.25, parameters=meanings, **SIGNALS)
    said = repr(physics._replace(outputs=(Signal("level", "V"), Signal("flow", "l/s"))))
    assert said.splitlines() == [
        "Physics 'd', one sample every 0.25 s",
        "  inputs: u (–)",
        "  states: x (–)",
        "  outputs: level (V), flow (l/s)",
        "  parameters: more.gains = [1, 2.5], rate = 0.5123 1/s",
    ]


def test_a_physics_shows_itself_inside_a_compiled_function():
    said = []

    def inside(rate):
        said.append(repr(discrete("d", decay, read, {"rate": 1.0}, dt=1.0, **SIGNALS)._replace(params={"rate": rate})))
        return rate

    jax.jit(inside)(1.0)
    assert "rate = " in said[0]
