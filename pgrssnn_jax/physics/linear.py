"""Linear Gaussian state-space model, mean part.

    x_t = A x_{t-1} + B u_t,   y_t = C x_t

x [2], u [1], y [1], all without unit; u_t acts on y_t. The process noise w and the measurement noise v belong
to the data (`data/lgssm.py`), not to the model. Source: Li, Seth, Kok, IFAC 2026, section 4.1.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Parameter, Physics, Signal, discrete, remembered
from pgrssnn_jax.records.record import Array

Matrix = Sequence[Sequence[float]] | np.ndarray


def step(p: Any, x: Float[jax.Array, " x"], u: Float[jax.Array, " u"]) -> Float[jax.Array, " x"]:
    return times(p["A"], x) + times(p["B"], u)


def measure(p: Any, x: Float[jax.Array, " x"], u: Float[jax.Array, " u"]) -> Float[jax.Array, " y"]:
    return times(p["C"], x)


def times(matrix: Float[Array, "rows columns"], vector: Float[Array, " columns"]) -> Float[jax.Array, " rows"]:
    """Matrix times vector as a sum of products: over a batch the small matrices of a model stay one vector loop, where
    a matrix product would become as many small ones."""
    return (jnp.asarray(matrix) * jnp.asarray(vector)[None]).sum(-1)


def _matrix(name: str, rows: Any) -> Float[np.ndarray, "rows columns"]:
    try:
        matrix = np.asarray(rows, np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.ndim != 2:
        raise ValueError(f"physics 'lgssm': {name}: expected rows of numbers of equal length, found {rows}")
    return matrix


@remembered
def lgssm(
    *,
    A: Matrix = ((0.6, 0.7), (-0.1, 0.0)),  # noqa: N803 - the field's symbols
    B: Matrix = ((-1.1,), (0.0,)),  # noqa: N803
    C: Matrix = ((0.9, -0.1),),  # noqa: N803
    dt: float = 1.0,
    inputs: Sequence[str] = ("u",),
    outputs: Sequence[str] = ("y",),
) -> Physics:
    """Any discrete linear model; A `[n_x, n_x]`, B `[n_x, n_u]`, C `[n_y, n_x]`, dt: s, or 1 for a system without time.

    The defaults are the imperfect Model 1 of the paper. Its text prints `A[1][1] = 1`; only 0 reproduces the published
    physics-only figure (1.68; with data.published_scaling=true: 1.680 on the first realisation, 1.703 on the mean of
    50).

    Raises `ValueError` when the matrices' shapes do not fit together or with the signal names.
    """
    a, b, c = (_matrix(name, m) for name, m in zip("ABC", (A, B, C), strict=True))
    n_x = len(a)
    shapes = {"A": (n_x, n_x), "B": (n_x, len(inputs)), "C": (len(outputs), n_x)}
    for name, matrix in zip("ABC", (a, b, c), strict=True):
        if matrix.shape != shapes[name]:
            raise ValueError(f"physics 'lgssm': {name}: expected shape {shapes[name]}, found {matrix.shape}")
    return discrete(
        "lgssm",
        step,
        measure,
        {"A": a, "B": b, "C": c},
        parameters={name: Parameter(name) for name in "ABC"},
        states=tuple(Signal(f"x{i + 1}") for i in range(n_x)),
        inputs=tuple(Signal(name) for name in inputs),
        outputs=tuple(Signal(name) for name in outputs),
        dt=dt,
    )
