"""Where a free run starts: x_0 of every sequence.

zero          x_0 = 0 in physical units (the published convention)
scaled_zero   x_0 = 0 in the networks' units, that is the states' offset (the published code, where states have one)
first_output  states that are `like` an output take its first measured value, the others 0
estimated     training: x_0 is trained with the weights; validation: least squares on its first n_init samples, or
              none where it was measured right after the training record: the run goes on (`objective.py`)
least_squares as estimated, but training begins at the least-squares x_0 of the physics alone over the whole record

A test record that shares its initial state with the training record starts where the training record does; otherwise
it starts from its own first output, or from the least-squares estimate over its first n_init samples alone.

    x_0 = argmin Σ_{t ≤ n_init} ((y_t - ŷ_t(x_0)) / s_y)² + prior · ((x_0 - guess) / s_x)²
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Float

from pgrssnn_jax.models.model import Model, ModelParams
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.physics.simulate import first_output_state
from pgrssnn_jax.records.record import Record

_PRIOR = 1e-4  # of one squared scaled error: decides only directions that n_init samples do not see
_STEPS = 20  # Levenberg-Marquardt; a handful of unknowns settles in fewer


@dataclass(frozen=True)
class InitialState:
    """kind as above; n_init: first samples of a record from which its start is estimated; shared: the test record
    starts where the (first) training sequence does."""

    kind: Literal["zero", "scaled_zero", "first_output", "estimated", "least_squares"] = "zero"
    n_init: int = 0
    shared: bool = False

    def __post_init__(self) -> None:
        if self.n_init < 0:
            raise ValueError(f"n_init: expected 0 or more samples, found {self.n_init}")
        if self.trained and self.n_init == 0:
            raise ValueError(f"n_init: expected at least 1 sample for initial_state={self.kind}, found 0")

    @property
    def trained(self) -> bool:
        """Is the start of the training sequences trained with the weights?"""
        return self.kind in ("estimated", "least_squares")


def start_state(model: Model, params: ModelParams, record: Record, initial: InitialState) -> Float[jax.Array, "seq x"]:
    """x_0 of every sequence of `record` from the record itself, in physical units."""
    if initial.kind == "zero":
        return jnp.zeros((record.u.shape[0], model.n_x), record.u.dtype)
    if initial.kind == "scaled_zero":
        offset = jnp.asarray(params.scaling.x.offset, record.u.dtype)
        return jnp.broadcast_to(offset, (record.u.shape[0], model.n_x))
    guess = first_output_states(model, record)
    return (
        guess if initial.kind == "first_output" else least_squares_states(model, params, record, initial.n_init, guess)
    )


def first_output_states(model: Model, record: Record) -> Float[jax.Array, "seq x"]:
    """x_0 from the first sample of every output that was measured, and the first input."""
    first = jnp.argmax(jnp.asarray(record.mask), axis=1, keepdims=True)
    y = jnp.take_along_axis(jnp.asarray(record.y), first, axis=1)[:, 0]
    if not model.spec.guided:  # its states have no physical meaning
        return jnp.zeros((len(y), model.n_x), y.dtype)
    return jnp.asarray(first_output_state(model.physics, y, jnp.asarray(record.u)[:, 0]))


def least_squares_states(
    model: Model, params: ModelParams, record: Record, n_init: int, guess: jax.Array
) -> Float[jax.Array, "seq x"]:
    """Least-squares x_0 per sequence from its first n_init samples; the guess stands where nothing better is found."""
    scaling = params.scaling

    def one(u: jax.Array, y: jax.Array, mask: jax.Array, guess: jax.Array) -> jax.Array:
        def residual(z: jax.Array) -> jax.Array:
            predicted = rollout(model, params, u[None], (guess + scaling.x.unscale_difference(z))[None]).y[0]
            error = scaling.y.to_scaled(predicted) - scaling.y.to_scaled(y)
            return jnp.concatenate([jnp.where(mask, error, 0.0).ravel(), _PRIOR**0.5 * z])

        return guess + scaling.x.unscale_difference(_levenberg_marquardt(residual, jnp.zeros_like(guess)))

    u, y, mask = (jnp.asarray(a[:, :n_init]) for a in (record.u, record.y, record.mask))
    return jax.vmap(one)(u, y, mask, guess)


def _levenberg_marquardt(residual: Callable[[jax.Array], jax.Array], start: jax.Array) -> jax.Array:
    """argmin ‖residual(z)‖² for a handful of unknowns, in a fixed number of damped Gauss-Newton steps.

    Our own, because it runs inside `shard_map` over members, which the solvers of optimistix refuse.
    """

    with_slope = _jacobian(residual, start)

    def body(_: jax.Array | int, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        z, damping = carry
        slope, r = with_slope(z)
        normal = slope.T @ slope
        step = jnp.linalg.solve(normal + damping * jnp.eye(len(z), dtype=z.dtype), slope.T @ r)
        tried = z - step
        better = jnp.sum(residual(tried) ** 2) < jnp.sum(r**2)  # False for a cost that is not finite
        return jnp.where(better, tried, z), jnp.where(better, damping / 5.0, damping * 5.0)

    return jax.lax.fori_loop(0, _STEPS, body, (start, jnp.asarray(1e-2, start.dtype)))[0]


def _jacobian(
    residual: Callable[[jax.Array], jax.Array], at: jax.Array
) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """z → dr/dz, r(z), in one run. Forward mode is the cheaper one for a handful of unknowns, but a physics with a
    derivative rule of its own (the arm) has reverse mode alone."""

    def twice(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        r = residual(z)
        return r, r

    try:
        jax.eval_shape(jax.jacfwd(residual), at)
    except TypeError:
        return jax.jacrev(twice, has_aux=True)
    return jax.jacfwd(twice, has_aux=True)
