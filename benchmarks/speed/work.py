"""What a case has to do: floating-point operations, and the steps that wait for one another.

Networks are counted by hand, so that the count is that of the equations whatever the program looks like; a function of
the physics by its operations on numbers. A multiply-add counts as two, a function such as tanh as one.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Physics

_GATES = 14  # operations of a GRU per unit beside its products
# fmt: off
_ARITHMETIC = frozenset({
    "abs", "add", "add_any", "clamp", "cos", "div", "exp", "integer_pow", "log", "logistic", "max", "min", "mul", "neg",
    "pow", "rsqrt", "sign", "sin", "sqrt", "square", "sub", "tanh",
})
# fmt: on


class Work(NamedTuple):
    """flops: floating-point operations; steps: recurrent products that wait for one another; stages: evaluations of
    the physics that do; product: rows and hidden units of a recurrent product."""

    flops: float
    steps: int
    stages: int
    product: tuple[int, int]


def rollout_work(spec: ModelSpec, physics: Physics, stages: int, sequences: int, samples: int) -> Work:
    """One rollout of one member; stages: evaluations of the physics per sample that wait for each other."""
    products, rest = network_operations(spec, physics)
    flops = sequences * samples * (products + rest + physics_operations(physics))
    return Work(flops, samples, stages * samples, (sequences, spec.hidden))


def epoch_work(
    spec: ModelSpec, physics: Physics, stages: int, sequences: int, samples: int, *, members: int = 1
) -> Work:
    """One epoch: a rollout and its derivatives, which cost two products for each of the rollout, but for that with the
    inputs. A physics that lets no gradient through is evaluated forwards alone."""
    products, rest = network_operations(spec, physics)
    through = physics.differentiable
    known = 2 * len(physics.inputs) * spec.hidden
    per_sample = 3 * (products + rest) - known + physics_operations(physics, derivative=through)
    passes = 2 if through else 1
    flops = members * sequences * samples * per_sample
    return Work(flops, 2 * samples, passes * stages * samples, (sequences, spec.hidden))


def network_operations(spec: ModelSpec, physics: Physics) -> tuple[int, int]:
    """Of one sample: those of matrix products, and the others."""
    n_u, n_x, n_y, n_h = len(physics.inputs), len(physics.states), len(physics.outputs), spec.hidden
    layers = [(n_u, n_h, n_h), (2 * n_h, n_h, n_h), (n_h, n_h, n_x), (n_u + n_x, n_h, n_h), (n_h, n_h, n_y)]
    products = sum(2 * (a * b + b * c) for a, b, c in layers) + spec.gru_layers * 2 * 2 * n_h * 3 * n_h
    rest = sum(2 * b + c for _, b, c in layers) + spec.gru_layers * _GATES * n_h + 2 * (n_u + n_x + n_y)
    return products, rest


def physics_operations(physics: Physics, *, derivative: bool = False) -> int:
    """Of one sample, with the derivative by the state where that is asked for."""
    x, u = jnp.zeros(len(physics.states)), jnp.zeros(len(physics.inputs))

    def both(x: jax.Array) -> Any:
        value, pull = jax.vjp(lambda x: physics.step(physics.params, x, u), x)
        return value, pull(value)

    step = operations(both, x) if derivative else operations(lambda x: physics.step(physics.params, x, u), x)
    return step + operations(lambda x: physics.measure(physics.params, x, u), x)


def operations(function: Callable[..., Any], *arguments: Any, products_alone: bool = False) -> int:
    """Of a function of arrays, loops as often as they run. Raises `ValueError` for what hides its operations."""
    return _operations(jax.make_jaxpr(function)(*arguments).jaxpr, products_alone)


def _operations(jaxpr: Any, products_alone: bool) -> int:
    return sum(_of(equation, products_alone) for equation in jaxpr.eqns)


def _of(equation: Any, products_alone: bool) -> int:
    name, params = equation.primitive.name, equation.params
    if name in ("while", "pure_callback", "ffi_call", "cond"):
        raise ValueError(f"operations: expected plain operations and scans, found {name}")
    inner = [part for part in params.values() if hasattr(part, "eqns") or hasattr(part, "jaxpr")]
    if inner:
        body = getattr(inner[0], "jaxpr", inner[0])
        return _operations(body, products_alone) * (params["length"] if name == "scan" else 1)
    size = int(equation.outvars[0].aval.size)
    if name == "dot_general":
        (over, _), _ = params["dimension_numbers"]
        return 2 * size * int(np.prod([equation.invars[0].aval.shape[axis] for axis in over]))
    if products_alone:
        return 0
    if name == "reduce_sum":
        return int(equation.invars[0].aval.size)
    return size if name in _ARITHMETIC else 0
