"""Functions written out in numbers, against the arrays that they came from."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from acceleration.functions import FUNCTIONS
from toys import quick_jit, toy_physics

from pgrssnn_jax.acceleration.scalars import written_out
from pgrssnn_jax.discovery.free_runs import with_derivatives
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def numbers(seed: int, shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    draw = np.random.default_rng(seed)
    return draw.normal(size=(3, *shape)), draw.normal(size=(2, *shape))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_it_is_the_function_of_arrays_for_all_lanes_at_once(name):
    function = FUNCTIONS[name]
    program = written_out(function, (3, 2), moving=2)
    assert program is not None
    a, b = numbers(1, (5,))
    da, db = numbers(2, (7, 5))  # seven tangents each

    def along(da: jax.Array, db: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(jax.vmap(function, -1, -1), (jnp.asarray(a), jnp.asarray(b)), (da, db))

    (values, tangents), found = quick_jit(lambda *d: (jax.vmap(along, 1)(*d), program(*a, *b, *d[0], *d[1])))(da, db)
    n = len(found) // 2
    np.testing.assert_allclose(found[:n], values[0], rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(
        np.stack([np.broadcast_to(t, (7, 5)) for t in found[n:]], 1), tangents, rtol=1e-12, atol=1e-14
    )


def test_later_arguments_may_be_without_tangents():
    program = written_out(lambda a, b: a * b[0], (3, 2), moving=1)
    assert program is not None
    a, b = numbers(3, ())
    np.testing.assert_allclose(program(*map(jnp.asarray, (*a, *b, *np.ones(3))))[3:], np.full(3, b[0]))


def test_what_a_number_is_and_what_it_is_not():
    """Loops over arrays or of unknown length, derivatives of one's own, places that depend on the numbers and long
    functions stay arrays."""

    @jax.custom_jvp
    def own(a: jax.Array) -> jax.Array:
        return a

    own.defjvp(lambda primals, tangents: (primals[0], 2.0 * tangents[0]))
    for function in (
        lambda a: jax.lax.while_loop(lambda c: c[0] < 9.0, lambda c: c * a, a),
        lambda a: jax.lax.scan(lambda c, b: (c * b, None), a, a)[0],
        lambda a: jax.lax.fori_loop(0, 1000, lambda i, c: c * a, a),
        own,
        lambda a: jnp.zeros(3).at[jnp.argmax(a)].set(1.0),
        lambda a: jnp.exp(jnp.arange(1000.0) * a[0])[:2],
        lambda a: jnp.ones((300, 3)) @ a,
        lambda a: jnp.broadcast_to(a, (300, 3)).sum(0),
    ):
        assert written_out(function, (3,), moving=1) is None


PLANTS = {
    "tanks": lambda: cascaded_tanks(integrator="rk4"),
    "tanks by one step": cascaded_tanks,
    "linear": lambda: lgssm(A=[[0.7, 0.8], [0.0, 0.1]], B=[[-1.0], [0.1]], C=[[1.0, 0.0]]),
    "toy": toy_physics,
    "toy, measured before": lambda: toy_physics("before_step"),
}


@cache
def programs(plant: str):
    """The problem with the whole catalogue, and its derivatives by numbers and by arrays, which serve every seed."""
    physics = PLANTS[plant]()
    problem = build_problem(physics, catalogue(physics))
    codes = (replace(problem.code, accelerate=False), replace(problem.code, written_out=None))
    return problem, *(jax.jit(partial(with_derivatives, code)) for code in codes)


# the same lines again, of more numbers
MORE = [pytest.param(plant, marks=pytest.mark.compiles) for plant in ("tanks", "toy", "toy, measured before")]


@pytest.mark.parametrize("plant", [*MORE, "tanks by one step", "linear"])
@pytest.mark.parametrize("seed", [0, 1])
def test_free_runs_have_the_same_derivatives_either_way(plant, seed):
    """From neutral numbers, some of which are infinite, and from empty states."""
    problem, by_numbers, by_arrays = programs(plant)
    assert problem.code.written_out is not None
    draw = np.random.default_rng(seed)
    lanes, p = 3, len(problem.theta)
    theta = np.repeat(problem.theta[:, None], lanes, 1)
    theta[:, 1] *= 1.01
    x0 = draw.uniform(0.0, 8.0, (len(problem.full.states), 2, lanes)) * (np.arange(lanes) > 0)
    u = draw.uniform(-1.0, 4.0, (20, len(problem.full.inputs), 2))
    places = [i for i in range(p) if np.isfinite(problem.theta[i])]
    free = np.stack([draw.permutation(places)[:5] for _ in range(lanes)])
    free[0, 3:] = -1
    arguments = tuple(map(jnp.asarray, (u, theta, x0, free)))
    found, expected = by_numbers(*arguments), by_arrays(*arguments)
    for one, other in zip(found, expected, strict=True):
        assert np.isfinite(other).all()
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11)
