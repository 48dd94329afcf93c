"""Own physics with bad signals, bad parameters, or functions whose result is of another shape or not finite."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from sentences import U, not_a_number, own, own_record, refused, tanks

import pgrssnn_jax as pg
from pgrssnn_jax.physics.base import discrete

X = pg.Signal("x", like="y")


def bounded(bounds):
    return own(parameters={"a": pg.Parameter("a", "1/s", bounds=bounds)})


BUILT = {
    "no sample time": (
        lambda: own(dt=None),
        "physics 'own': dt: expected a positive sample time in seconds, found None",
    ),
    "a sample time in words": (lambda: own(dt="1"), "physics 'own': dt: expected a positive sample time", "found '1'"),
    "a negative sample time": (lambda: own(dt=-1.0), "physics 'own': dt: expected a positive sample time"),
    "an endless sample time": (lambda: own(dt=np.inf), "physics 'own': dt: expected a positive sample time"),
    "no sub-step": (lambda: own(sub_steps=0), "physics: sub_steps: expected at least 1, found 0"),
    "sub-steps without end": (
        lambda: own(sub_steps=10**400),
        "physics: sub_steps: expected at most 1000000, found 1000",
    ),
    "half a sub-step": (lambda: own(sub_steps=1.5), "physics: sub_steps: expected a whole number of at least 1"),
    "an integrator that there is not": (lambda: own(integrator="bdf"), "integrator: expected one of ['euler', 'rk4'"),
    "no integrator": (lambda: own(integrator=None), "physics: integrator: expected one of"),
    "names for states": (lambda: own(states=("x",)), "physics 'own': states: expected signals with names", "('x',)"),
    "one name for states": (lambda: own(states="x"), "physics 'own': states: expected signals", "found 'x'"),
    "one signal for states": (lambda: own(states=X), "physics 'own': states: expected signals", "found Signal"),
    "no states": (lambda: own(states=None), "physics 'own': states: expected signals", "found None"),
    "no state": (lambda: own(states=()), "physics 'own': states: expected signals", "found ()"),
    "names for inputs": (lambda: own(inputs=["u"]), "physics 'own': inputs: expected signals"),
    "no output": (lambda: own(outputs=()), "physics 'own': outputs: expected signals"),
    "an input without a name": (
        lambda: own(inputs=(pg.Signal(""),)),
        "physics 'own': inputs: expected signals with names",
    ),
    "a state twice": (lambda: own(states=(X, X)), "states: expected every name once, found 'x' 2 times"),
    "an output twice": (lambda: own(outputs=(pg.Signal("y"),) * 2), "outputs: expected every name once, found 'y'"),
    "like nothing that is there": (lambda: own(states=(pg.Signal("x", like="z"),)), "expected like one of ['y']"),
    "the rate of nothing": (lambda: own(states=(pg.Signal("x", rate_of="z"),)), "expected rate_of one of ['y']"),
    "the memory of nothing": (lambda: own(states=(pg.Signal("x", memory_of="z"),)), "expected memory_of one of ['u']"),
    "a unit that is None": (lambda: own(inputs=(pg.Signal("u", None),)), "inputs: u: unit: expected text"),
    "a range upside down": (lambda: own(outputs=(pg.Signal("y", range=(1, 0)),)), "y: range: expected (low, high)"),
    "a range of one number": (
        lambda: own(outputs=(pg.Signal("y", range=3),)),
        "y: range: expected (low, high)",
        "found 3",
    ),
    "a start in words": (
        lambda: own(states=(X._replace(start="full"),)),
        "x: start: expected real numbers, found text",
    ),
    "a start that is NaN": (
        lambda: own(states=(X._replace(start=np.nan),)),
        "x: start: expected a finite number or None",
    ),
    "a list of numbers": (lambda: own(params=[0.5]), "physics 'own': params: expected numbers by their names"),
    "a parameter of None": (lambda: own(params={"a": None}), "physics 'own': a: expected a number, found None"),
    "a parameter of words": (lambda: own(params={"a": "much"}), "physics 'own': a: expected real numbers, found text"),
    "a parameter of NaN": (lambda: own(params={"a": np.nan}), "physics 'own': a: expected numbers, found NaN"),
    "meanings of other parameters": (
        lambda: own(parameters={}),
        "physics 'own': parameters: expected the tree of params",
    ),
    "a number for a meaning": (
        lambda: own(parameters={"a": 3}),
        "parameters: expected a Parameter per number, found 3",
    ),
    "a number out of its bounds": (lambda: bounded((1, 2)), "physics 'own': a: expected 1 to 2 1/s, found 0.5"),
    "bounds upside down": (lambda: bounded((2, 0)), "a: bounds: expected (low, high) with low ≤ high, found (2, 0)"),
    "one bound": (lambda: bounded(3), "a: bounds: expected (low, high)", "found 3"),
    "bounds in words": (lambda: bounded(("0", "1")), "a: bounds: expected (low, high)"),
    "a bound of None": (lambda: bounded((None, 1)), "a: bounds: expected (low, high)"),
    "an output timing that there is not": (lambda: own(output_timing="later"), "output_timing: expected after_step or"),
    "a derivative that is a number": (lambda: own(3), "physics 'own': derivative: expected a function, found 3"),
    "a measurement that is text": (lambda: own(None, "x"), "physics 'own': measure: expected a function, found 'x'"),
    "a skeleton that is a number": (lambda: own(skeleton=3), "physics 'own': skeleton: expected a function, found 3"),
    "matrices that do not fit": (lambda: pg.physics.lgssm(A=[[1.0, 2.0]]), "physics 'lgssm': A: expected shape (1, 1)"),
    "a matrix of words": (lambda: pg.physics.lgssm(A="A"), "A: expected rows of numbers of equal length, found A"),
    "a matrix with NaN": (lambda: pg.physics.lgssm(A=[[np.nan, 0], [0, 0]]), "A: expected numbers, found NaN"),
    "a negative outflow": (lambda: tanks(k1=-1.0), "physics 'tanks': k1: expected 0 to 1 sqrt(V)/s, found -1"),
    "an outflow in words": (lambda: tanks(k1="small"), "physics 'tanks': k1: expected real numbers, found text"),
    "limits in words": (lambda: tanks(clamp="no"), "physics 'tanks': clamp: expected True or False, found 'no'"),
    "a variant that there is not": (lambda: tanks().variant(k9=1.0), "variant: expected settings among", "found 'k9'"),
    "a robot that there is not": (
        lambda: pg.physics.arm(robot="r2d2"),
        "physics.robot: expected one of ['kuka_kr300']",
    ),
    "ratios of two joints": (lambda: pg.physics.arm(gear_ratio=[1.0, 2.0]), "gear_ratio: expected one number or 6"),
    "limits upside down": (
        lambda: pg.physics.arm(position_min=5.0, position_max=1.0),
        "position_max: expected more than",
    ),
    "a gravity by its names": (lambda: pg.physics.arm(gravity={"z": -9.81}), "gravity: expected three numbers in m/s²"),
    "an arm that runs backwards": (lambda: pg.physics.arm(dt=-0.1), "dt: expected a positive sample time"),
}


@pytest.mark.parametrize(("call", "words"), [(call, words) for call, *words in BUILT.values()], ids=BUILT)
def test_what_is_no_physics_is_refused(call, words):
    refused(call, *words)


def raising(problem):
    def derivative(p, x, u):
        raise problem

    return derivative


STEP, MEASURE = "physics 'own': step: expected ", "physics 'own': measure: expected "
FUNCTIONS = {
    "two states for one": (own(lambda p, x, u: jnp.zeros(2)), f"{STEP}shape (1,), found (2,)"),
    "a number for a state": (own(measure=lambda p, x, u: x[0]), f"{MEASURE}shape (1,), found ()"),
    "two outputs for one": (own(measure=lambda p, x, u: jnp.zeros(2)), f"{MEASURE}shape (1,), found (2,)"),
    "a list": (own(measure=lambda p, x, u: [x[0]]), f"{MEASURE}shape (1,), found list"),
    "nothing": (own(measure=lambda p, x, u: None), f"{MEASURE}shape (1,), found NoneType"),
    "whole numbers": (own(measure=lambda p, x, u: jnp.ones(1, int)), f"{MEASURE}floating-point numbers, found int"),
    "complex numbers": (own(lambda p, x, u: x + 1j), f"{STEP}floating-point numbers, found complex"),
    "a division by zero": (own(lambda p, x, u: 1 / 0), f"{STEP}it to compute with jax.numpy", "ZeroDivisionError"),
    "an error of two lines": (own(raising(RuntimeError("a\nb"))), STEP, "found RuntimeError: a"),
    "an error without words": (own(raising(RuntimeError())), STEP, "found RuntimeError:"),
    "a parameter that is not there": (own(lambda p, x, u: p["b"] * x), STEP, "found KeyError: 'b'"),
    "NumPy in place of jax.numpy": (own(lambda p, x, u: np.sin(x)), STEP, "TracerArrayConversionError"),
    "an if": (own(lambda p, x, u: x if x[0] > 0 else u), STEP, "TracerBoolConversionError"),
    "arguments that are missing": (own(lambda p, x: x), STEP, "TypeError"),
}


@pytest.mark.parametrize("user", ["fit", "simulate", "discover", "add"])
@pytest.mark.parametrize(("physics", "words"), [(p, w) for p, *w in FUNCTIONS.values()], ids=FUNCTIONS)
def test_a_function_that_returns_something_else_is_named(physics, words, user):
    calls = {
        "fit": lambda: pg.fit("pg_rssnn", physics, own_record(), quiet=True),
        "simulate": lambda: pg.simulate(physics, U, [0.0]),
        "discover": lambda: pg.discover(physics, own_record(), own_record(), quiet=True),
        "add": lambda: pg.add(physics, "sensor_offset", offset=1.0),
    }
    refused(calls[user], *words)


def fast(**settings):
    """A time constant of 1/50 s and samples of 1 s."""
    return own(params={"a": 50.0}, **settings)


def step(p, x, u):
    return x + (u - p["a"] * x)


def discrete_step():
    signals = {"states": (X,), "inputs": (pg.Signal("u"),), "outputs": (pg.Signal("y"),)}
    return discrete("own", step, lambda p, x, u: x, {"a": 50.0}, dt=1.0, **signals)


ASTRAY = {
    "NaN": (lambda: own(not_a_number), "state 'x' beyond the floating-point range from sample 0 on"),
    "infinity": (lambda: own(lambda p, x, u: x / jnp.zeros(1)), "state 'x' beyond the floating-point range"),
    "outputs of NaN": (
        lambda: own(measure=not_a_number),
        "output 'y' beyond the floating-point range from sample 0 on",
    ),
    "a stiff system": (
        fast,
        "its step of 1 s is too long for rk4",
        "stiff",
        "sub_steps=100 in place of 1 keeps",
        "integrator=rosenbrock",
    ),
    "a stiff system by Euler": (lambda: fast(integrator="euler"), "its step of 1 s is too long for rk4"),
    "a stiff system in two steps": (
        lambda: fast(sub_steps=2),
        "its step of 0.5 s is",
        "sub_steps=20 in place of 2 keeps",
    ),
    "a stiff step": (discrete_step, "a step of dt=1 s may be too long"),
    "an unstable system": (
        lambda: own(lambda p, x, u: x**2 + 3.0),
        "shorter steps of rk4, up to sub_steps=100, do not help",
    ),
    "an unstable system in many steps": (
        lambda: own(lambda p, x, u: 0.01 * x**2, sub_steps=200),
        "shorter steps of rk4, up to sub_steps=2000, do not help",
    ),
    "a square root at zero": (
        lambda: own(lambda p, x, u: -jnp.sqrt(jnp.maximum(x, 0.0)) + u - 10.0),
        "expected finite derivatives along the free run, found one by the state 'x'",
    ),
}


@pytest.mark.parametrize(("physics", "words"), [(p, w) for p, *w in ASTRAY.values()], ids=ASTRAY)
def test_a_free_run_that_goes_astray_is_said_before_any_work(physics, words):
    refused(lambda: pg.discover(physics(), own_record(), own_record(), quiet=True), *words)


def test_the_sub_steps_that_a_message_offers_help():
    with pytest.raises(ValueError) as caught:
        pg.discover(fast(), own_record(), own_record(), quiet=True)
    offered = re.search(r"sub_steps=(\d+) in", str(caught.value))
    for better in (fast(sub_steps=int(offered[1])), fast(integrator="rosenbrock")):
        assert np.isfinite(pg.simulate(better, U, [0.0]).y).all()
    assert pg.simulate(fast(), U, [0.0]).first_bad < len(U)


@pytest.mark.parametrize("model", ["physics_only", pytest.param("pg_rssnn", marks=pytest.mark.compiles)])
def test_members_of_a_stiff_physics_that_failed_say_what_helps(model):
    small = {"hidden": 2, "gru_layers": 1} if model == "pg_rssnn" else {}
    found = pg.fit(model, fast(), own_record(), recipe="default", seeds=1, epochs=2, quiet=True, **small)
    (reason,) = found.score(own_record()).reason
    assert reason.startswith("failed: ")
    assert "its step of 1 s is too long for rk4" in reason
    assert "sub_steps=100 in place of 1 keeps the run finite, and so does the implicit integrator=rosenbrock" in reason


@pytest.mark.compiles
def test_members_that_failed_beside_a_finite_physics_have_no_such_hint():
    found = pg.fit("pg_rssnn", own(), own_record(), recipe="default", seeds=1, epochs=3, learning_rate=1e30,
                   guard="none", hidden=2, gru_layers=1, quiet=True)  # fmt: skip
    (reason,) = found.score(own_record()).reason
    assert reason.startswith("failed: ")
    assert "step of" not in reason
