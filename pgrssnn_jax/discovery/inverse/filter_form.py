"""The numbers of an arm's filter, from a record that has its positions.

q̄, σ_q, σ_q̇, σ_q̈    mean and standard deviations of the motion
c                     argmin Σ_k (ρ(k dt; c) - ρ_k)²        ρ: autocorrelation of q̇, over half a period of its swing
σ_d, σ_r, T_d         of the torque residual: while a joint moves, what comes to it at rest, where ρ falls to 1/e
σ_v                   of the part of the residual that one sample does not share with the next
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.discovery.inverse.evidence import fastest_of, samples_of, torques
from pgrssnn_jax.discovery.inverse.filter_tuning import tuned_numbers
from pgrssnn_jax.discovery.inverse.motion import Motion, motion_of
from pgrssnn_jax.discovery.problem import build_problem
from pgrssnn_jax.effects.arm_common import an_arm
from pgrssnn_jax.physics.arms.motion_prior import FilterNumbers, motion
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Record, map_signals

_LEAST = 1e-3  # of the motor torque's standard deviation: what every standard deviation of a torque is at the least


def filter_form(physics: Physics, record: Record, *, tune: int = 0) -> Physics:
    """The arm in the form of its filter (`physics/arms/filter.py`), with its effects.

    tune: how many free runs of the record the search for better numbers may take, 0: none (500 take four minutes on
    60 sequences of 605 samples). Raises `ValueError` for a physics that is no arm in JAX, and for positions that were
    not measured throughout.
    """
    if not an_arm(masses=True).met(physics):
        raise ValueError(f"filter_form: physics: expected an arm with backend=jax, found {physics.name!r}")
    record = _flat(record)
    if record.validation is not None:
        record = record._replace(validation=_flat(record.validation))
    at_rest = record.info.start == "rest"
    numbers = filter_numbers(physics, motion_of(record, physics.dt, at_rest=at_rest))
    given = {name: np.asarray(value) for name, value in numbers._asdict().items()}
    filtered = physics.variant(form="filter", filter_numbers=given, starts_at_rest=at_rest)
    return filtered.variant(filter_numbers=tuned_numbers(filtered, record, tune)) if tune else filtered


def _flat(record: Record) -> Record:
    """The sequences of all datasets as one."""
    return map_signals(record, lambda signal: signal.reshape(-1, *signal.shape[-2:]))


def filter_numbers(physics: Physics, found: Motion) -> FilterNumbers:
    """Before any tuning."""
    samples = samples_of(found, fastest_of(found))
    sequences, time, n = found.v.shape
    problem = build_problem(physics, ())
    error = torques(problem).errors(problem.theta, samples).T.reshape(sequences, time, n)
    moving = samples.moving.T.reshape(sequences, time, n)
    least = _LEAST * found.torque.std((0, 1))
    sizes = [one.std((0, 1)) for one in (found.reading, found.v, found.a)]
    by_lag = [_correlation(error, moving, k) for k in range(1, time // 2)]
    slow_enough = next((k for k, value in enumerate(by_lag, 1) if np.mean(value) < np.exp(-1)), time // 2)
    own, still = (_mean_square(error, where) for where in (moving, ~moving))
    shared = np.clip(by_lag[0] * np.exp(1 / slow_enough), 0, 1)  # of the variance; what decays reaches the lag 0
    numbers = FilterNumbers(
        mean=found.reading.mean((0, 1)),
        position=sizes[0],
        speed=sizes[1],
        acceleration=sizes[2],
        moving=np.maximum(np.sqrt(own * shared), least),
        resting=np.sqrt(np.maximum(still - own, least**2)),
        noise=np.maximum(np.sqrt(own * (1 - shared)), least),
        slow=samples.slow,
        damping=1.0,
        time=slow_enough * found.spacing,
    )
    return numbers._replace(damping=_damping(numbers, found))


def _mean_square(error: np.ndarray, where: np.ndarray) -> Float[np.ndarray, " n"]:
    """0 for a joint that has no such sample."""
    return np.sum(error**2, (0, 1), where=where) / np.maximum(where.sum((0, 1)), 1)


def _correlation(error: np.ndarray, moving: np.ndarray, lag: int) -> Float[np.ndarray, " n"]:
    """Of samples in both of which the joint moves, over the mean square of all in which it does."""
    both = moving[:, :-lag] & moving[:, lag:]
    products = np.sum(error[:, :-lag] * error[:, lag:], (0, 1), where=both)
    squares = np.sum(error**2, (0, 1), where=moving)
    return products / np.maximum(both.sum((0, 1)), 1) * moving.sum((0, 1)) / np.maximum(squares, 1e-300)


def _damping(numbers: FilterNumbers, found: Motion) -> float:
    swing = np.median(numbers.acceleration / numbers.speed)
    lags = np.arange(1, min(round(np.pi / swing / found.spacing), found.v.shape[1] // 2))
    squares = np.mean(found.v**2, (0, 1))
    measured = np.array([np.mean(found.v[:, :-k] * found.v[:, k:], (0, 1)) / squares for k in lags])

    def mismatch(log_damping: float) -> float:
        tried = numbers._replace(damping=np.exp(log_damping))
        kernel = np.asarray(motion(jax.tree.map(jnp.asarray, tried), found.spacing)[0], np.float64)
        powers = np.stack([np.linalg.matrix_power(kernel, k) for k in lags])
        return float(np.sum((powers[..., 1, 1] - measured) ** 2))

    log = scipy.optimize.minimize_scalar(mismatch, bounds=np.log([0.01 * swing, 100 * swing]), method="bounded").x
    return float(np.exp(float(log)))
