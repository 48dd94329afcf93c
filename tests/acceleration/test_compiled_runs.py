"""Free runs compiled from C++ against those of JAX: values, derivatives, what is not finite, batches, many programs."""

import shutil
from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from acceleration.functions import FUNCTIONS
from toys import quick_jit, toy_physics

import pgrssnn_jax as pg
from pgrssnn_jax.acceleration import build
from pgrssnn_jax.acceleration.build import COMPILERS
from pgrssnn_jax.acceleration.compiled_runs import FreeRuns, Sizes, compiled_free_runs
from pgrssnn_jax.acceleration.scalars import written_out
from pgrssnn_jax.discovery.code import Code
from pgrssnn_jax.discovery.discover import discover
from pgrssnn_jax.discovery.free_runs import free_run, with_derivatives
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import set_up
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.training.settings import training_settings

pytestmark = pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="no C++ compiler here")
PLANTS = {
    "tanks": lambda: cascaded_tanks(integrator="rk4"),
    "tanks in sub-steps": lambda: cascaded_tanks(integrator="rk4", sub_steps=3),
    "linear": lambda: lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]]),
    "toy, measured before": lambda: toy_physics("before_step"),
}


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


@cache
def codes(plant: str) -> tuple[Code, Code, np.ndarray]:
    """With the whole catalogue: compiled, and by JAX's own scan and derivatives."""
    physics = PLANTS[plant]()
    problem = build_problem(physics, catalogue(physics))
    assert problem.code.compiled is not None
    return problem.code, replace(problem.code, written_out=None), problem.theta


def arrays(code: Code, theta: np.ndarray, lanes: int, seed: int = 0) -> tuple[jax.Array, ...]:
    """Two sequences; from neutral numbers, some of which are infinite, and from empty states."""
    draw = np.random.default_rng(seed)
    many = np.repeat(theta[:, None], lanes, 1)
    many[:, -1] *= 1.01
    x0 = draw.uniform(0.0, 8.0, (len(code.full.states), 2, lanes)) * (np.arange(lanes) > 0)
    u = draw.uniform(-1.0, 4.0, (20, len(code.full.inputs), 2))
    places = np.flatnonzero(np.isfinite(theta))
    free = np.stack([draw.permutation(places)[:5] for _ in range(lanes)])
    free[0, 3:] = -1
    return tuple(map(jnp.asarray, (u, many, x0, free)))


@cache
def both(plant: str, which: int):
    """Free runs without and with derivatives, by one of the codes."""
    code = codes(plant)[which]
    return quick_jit(
        lambda u, many, x0, free: (*free_run(code, u, many, x0), *with_derivatives(code, u, many, x0, free))
    )


# lanes: less than a vector, some vectors and a rest; another plant is another program of the same loops
@pytest.mark.parametrize(("plant", "lanes"), [
    ("linear", 1), ("linear", 3), ("linear", 19), ("toy, measured before", 3),
    *(pytest.param("tanks", lanes, marks=pytest.mark.compiles) for lanes in (1, 3, 19)),
    pytest.param("tanks in sub-steps", 3, marks=pytest.mark.compiles),
    *(pytest.param("toy, measured before", lanes, marks=pytest.mark.compiles) for lanes in (1, 19)),
])  # fmt: skip
def test_free_runs_and_their_derivatives_are_those_of_jax(plant, lanes):
    ours, _, theta = codes(plant)
    given = arrays(ours, theta, lanes, seed=lanes)
    for found, expected in zip(both(plant, 0)(*given), both(plant, 1)(*given), strict=True):
        assert np.isfinite(expected).all()
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)


def sums(y, dy, measured, weight):
    """eᵀe, Jᵀe and JᵀJ of every sequence and lane, by NumPy."""
    weighted = np.nan_to_num(weight[:, :, None, :, None] * dy, nan=0.0, posinf=0.0, neginf=0.0)
    error = np.where(weight > 0, weight * np.nan_to_num(measured), 0.0)[..., None] - weight[..., None] * y
    return [
        np.einsum(how, *arrays)
        for how, *arrays in (
            ("tysl,tysl->sl", error, error),
            ("tydsl,tysl->dsl", weighted, error),
            ("tydsl,tyesl->desl", weighted, weighted),
        )
    ]


# a sample that was not measured is NaN in some records
@pytest.mark.parametrize(("plant", "lanes"), [
    ("linear", 3), ("toy, measured before", 19), pytest.param("tanks", 19, marks=pytest.mark.compiles),
])  # fmt: skip
def test_normal_equations_are_those_of_the_derivatives(plant, lanes):
    code, _, theta = codes(plant)
    assert code.compiled is not None
    given = arrays(code, theta, lanes, seed=lanes)
    y, dy = map(np.asarray, code.compiled.along(*given))
    draw = np.random.default_rng(1)
    weight = draw.uniform(0.5, 2.0, y.shape[:-1]) * (draw.uniform(size=y.shape[:-1]) > 0.3)
    measured = np.where(weight > 0, draw.normal(size=y.shape[:-1]), np.nan)
    found = code.compiled.normal(*given, jnp.asarray(measured), jnp.asarray(weight))
    for one, expected in zip(found, sums(y, dy, measured, weight), strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def toy_code(measure, p: int, x: int, y: int) -> FreeRuns | str:
    """Free runs in which the state stays as it is; measure(θ, x, u)."""
    step = written_out(lambda theta, x, u: x, (p, x, 1), moving=2)
    seen = written_out(measure, (p, x, 1), moving=2)
    assert step is not None
    assert seen is not None
    return compiled_free_runs(step, seen, Sizes(p, x, 1, y, tuple(range(x))), True)


def toy_runs(measure, p: int, x: int, y: int) -> FreeRuns:
    found = toy_code(measure, p, x, y)
    assert isinstance(found, FreeRuns), found
    return found


def test_every_operation_and_its_derivative():
    """All functions of numbers at once, at points on both sides of every choice in them."""

    def measure(b, a, u):
        return jnp.concatenate([jnp.ravel(function(a, b)) for function in FUNCTIONS.values()])

    draw = np.random.default_rng(0)
    a, b = draw.normal(size=(3, 1, 7)), draw.normal(size=(2, 7))

    def one(b, a):
        return jax.vmap(measure, (-1, -1, None), -1)(b, a, jnp.zeros(1))

    expected, (by_b, by_a) = quick_jit(lambda *both: (one(*both), jax.jacfwd(one, (0, 1))(*both)))(b, a[:, 0])
    runs = toy_runs(measure, 2, 3, len(expected))
    free = jnp.tile(jnp.arange(2), (7, 1))
    y, dy = runs.along(jnp.zeros((1, 1, 1)), jnp.asarray(b), jnp.asarray(a), free)
    np.testing.assert_allclose(y[0, :, 0], expected, rtol=1e-12, atol=1e-15)
    lanes = np.arange(7)
    derivatives = np.concatenate(
        [np.asarray(by_b)[:, lanes, :, lanes], np.asarray(by_a)[:, lanes, :, lanes]], -1
    )  # [lane, y, d]
    np.testing.assert_allclose(np.moveaxis(dy[0, :, :, 0], -1, 0), derivatives, rtol=1e-11, atol=1e-13)


def test_the_branch_that_is_not_taken_says_nothing():
    """Its derivative may be infinite, or not a number."""
    runs = toy_runs(lambda theta, x, u: jnp.where(x > 0, theta[0] * jnp.sqrt(x), x / theta[0]), 1, 1, 1)
    x = jnp.asarray([[[-4.0, 0.0, 4.0]]])
    _, dy = runs.along(jnp.zeros((1, 1, 1)), jnp.asarray([[2.0, 2.0, 2.0]]), x, jnp.zeros((3, 1), int))
    np.testing.assert_allclose(dy[0, 0, :, 0], [[1.0, 0.0, 2.0], [0.5, 0.5, 0.5]])


def test_what_is_not_finite_stays_so():
    runs = toy_runs(lambda theta, x, u: jnp.stack([jnp.maximum(x[0], 1.0), jnp.clip(x[0], -1, 1), x[0] ** 3]), 1, 1, 3)
    x = jnp.asarray([[[np.nan, np.inf, -np.inf]]])
    y, _ = runs.run(jnp.zeros((2, 1, 1)), jnp.ones((1, 3)), x)
    np.testing.assert_array_equal(y[1, :, 0], [[np.nan, np.inf, 1.0], [np.nan, 1.0, -1.0], [np.nan, np.inf, -np.inf]])


def test_normal_equations_leave_out_derivatives_that_are_not_finite_but_no_error_that_is_not():
    runs = toy_runs(lambda theta, x, u: theta[0] + jnp.sqrt(x), 1, 1, 1)
    x = jnp.asarray([[[-1.0, 0.0, 4.0]]])  # no value; no derivative; both
    given = (jnp.zeros((1, 1, 1)), jnp.zeros((1, 3)), x, jnp.zeros((3, 1), int), jnp.ones((1, 1, 1)))
    squares, pull, matrix = runs.normal(*given, jnp.full((1, 1, 1), 2.0))
    np.testing.assert_allclose(squares[0], [np.nan, 4.0, 4.0])
    np.testing.assert_allclose(pull[:, 0, 1:], [[4.0, -4.0], [0.0, -1.0]])
    np.testing.assert_allclose(matrix[:, :, 0, 1], [[4.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(matrix[:, :, 0, 2], [[4.0, 1.0], [1.0, 0.25]])


def test_programs_in_one_process_do_not_mix():
    """Each has its own tables, also where both were compiled before either ran."""
    first = toy_runs(lambda theta, x, u: theta[:1] * x[:1], 2, 2, 1)
    second = toy_runs(lambda theta, x, u: theta[1:] * x[1:], 2, 2, 1)
    given = (jnp.zeros((1, 1, 1)), jnp.asarray([[2.0], [3.0]]), jnp.asarray([[[5.0]], [[7.0]]]), jnp.asarray([[0, 1]]))
    np.testing.assert_array_equal(first.along(*given)[1].ravel(), [5.0, 0.0, 2.0, 0.0])
    np.testing.assert_array_equal(second.along(*given)[1].ravel(), [0.0, 7.0, 0.0, 3.0])


def test_a_batch_is_one_run_after_the_other():
    code, _, theta = codes("tanks")
    u, many, x0, free = arrays(code, theta, 3)
    thetas, starts = jnp.stack([many, 1.1 * many]), jnp.stack([x0, x0 + 1.0])
    found = jax.vmap(partial(with_derivatives, code, u), (0, 0, None))(thetas, starts, free)
    for i in range(2):
        for one, expected in zip(found, with_derivatives(code, u, thetas[i], starts[i], free), strict=True):
            np.testing.assert_array_equal(one[i], expected)


def test_arrays_of_another_physics_are_refused():
    code, _, theta = codes("tanks")
    u, many, x0, _ = arrays(code, theta, 3)
    with pytest.raises(jax.errors.JaxRuntimeError, match="another physics"):
        jax.block_until_ready(free_run(code, u, many[:-1], x0))


def test_an_unknown_operation_is_the_reason_why_there_are_none():
    whole = toy_code(lambda theta, x, u: jnp.where(x > 0, x.astype(int) + 1, 2).astype(float), 1, 1, 1)
    assert whole == "no C++ is written for numbers of type int64"


def test_without_a_compiler_a_discovery_says_why_it_takes_longer(monkeypatch):
    """It goes no further here: everything behind the first line is tested elsewhere."""
    monkeypatch.setattr(build, "COMPILERS", ())
    monkeypatch.delenv("CXX", raising=False)
    physics = cascaded_tanks(dt=3.9)  # none of its programs was compiled before
    u = np.linspace(1.0, 4.0, 400)[:, None]
    volts = {"inputs": {"pump_voltage": "V"}, "outputs": {"level_voltage": "V"}}
    train, test = (pg.record(part, np.sqrt(part), dt=3.9, **volts) for part in np.split(u, 2))
    setup = set_up(physics, train, test, DiscoverySettings(), training_settings("pg_rssnn"), notify=print)

    def heard(line):
        raise InterruptedError(line)

    with pytest.raises(InterruptedError, match="^free runs take longer, not compiled: no C.. compiler found"):
        discover(setup, heard)
