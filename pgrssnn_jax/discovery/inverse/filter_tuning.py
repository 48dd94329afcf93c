"""Better numbers for an arm's filter: those with which it follows a record best from the torques alone.

    argmin mean_j RMS(q_j - q̂_j) / std(q_j)

The numbers are multiplied by factors: first by the same for all joints, by differential evolution, because the error
has many local minima (a joint that lost its way stays lost); then by those of single joints, one after another, for as
long as the error on the validation record falls.
Source: Storn and Price, Differential Evolution, J. Global Optimization, 1997.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy

from pgrssnn_jax.effects.base import WithEffects, own_of
from pgrssnn_jax.physics.arms.motion_prior import OF_ALL_JOINTS
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.simulate import first_output_state, simulated_states
from pgrssnn_jax.records.record import Record

_OF_JOINTS = ("position", "acceleration", "moving", "resting", "noise", "slow")
_FURTHEST = 8.0  # what a common factor is at the most, and one over it at the least
_PER_FACTOR = 4  # points of the evolution for each factor
_SHARE = 0.4  # of the free runs that the evolution takes
_FIRST, _FINEST = 0.3, 0.05  # logarithm of a factor: what a search along one number begins with and where it ends
_LOST = 5.0  # standard deviations of a position: no error counts for more
Numbers = dict[str, np.ndarray]
Error = Callable[[Numbers], float]


def tuned_numbers(filtered: Physics, record: Record, most: int) -> Numbers:
    """The filter's numbers after at most about `most` free runs of the record."""
    error, numbers = _free_run_error(filtered, record), own_of(filtered.params)["filter"]
    judged = error if record.validation is None else _free_run_error(filtered, record.validation)
    return _joint_by_joint(error, judged, _together(error, numbers, int(_SHARE * most)), int((1 - _SHARE) * most))


def _free_run_error(filtered: Physics, record: Record) -> Error:
    u, y = jnp.asarray(record.u, jnp.float32), np.asarray(record.y, np.float64)
    start = jnp.asarray(first_output_state(filtered, np.zeros_like(y[:, 0]), np.asarray(record.u)[:, 0]))
    size, outputs, params, own = y.std((0, 1)), y.shape[-1], filtered.params, own_of(filtered.params)

    def error(numbers: Numbers) -> float:
        tried: Any = {**own, "filter": numbers}
        tried = params._replace(own=tried) if isinstance(params, WithEffects) else tried
        found = np.asarray(simulated_states(filtered.step, tried, start, u)[..., :outputs], np.float64)
        wrong = np.sqrt(np.mean((found - y) ** 2, (0, 1))) / size
        return float(np.nan_to_num(wrong, nan=_LOST).clip(max=_LOST).mean())

    return error


def _together(error: Error, numbers: Mapping[str, Any], most: int) -> Numbers:
    names = (*_OF_JOINTS, *OF_ALL_JOINTS)

    def scaled(logs: np.ndarray) -> Numbers:
        return {**numbers, **{name: numbers[name] * np.exp(log) for name, log in zip(names, logs, strict=True)}}

    found = scipy.optimize.differential_evolution(
        lambda logs: error(scaled(logs)), [(-np.log(_FURTHEST), np.log(_FURTHEST))] * len(names),
        x0=np.zeros(len(names)), popsize=_PER_FACTOR, maxiter=max(most // (_PER_FACTOR * len(names)) - 1, 0), tol=0,
        polish=False, rng=np.random.default_rng(0), init="sobol",
    )  # fmt: skip
    return scaled(found.x)


def _joint_by_joint(error: Error, judged: Error, numbers: Numbers, most: int) -> Numbers:
    """Along one number after another, with steps that grow where they help and halve where they do not."""
    places: list[tuple[str, Any]] = [(name, j) for name in _OF_JOINTS for j in range(len(numbers["mean"]))]
    steps = dict.fromkeys(places + [(name, ()) for name in OF_ALL_JOINTS], _FIRST)
    best, left, kept, lowest = error(numbers), most, numbers, judged(numbers)
    while left > 0 and max(map(abs, steps.values())) > _FINEST:
        for (name, place), step in steps.items():
            for log in (step, -step):
                value = np.array(numbers[name], np.float64)
                value[place] *= np.exp(log)
                tried = {**numbers, name: value}
                left, found = left - 1, error(tried)
                if found < best:
                    best, numbers, steps[name, place] = found, tried, 1.5 * log
                    break
            else:
                steps[name, place] = step / 2
        if (now := judged(numbers)) >= lowest:
            break
        kept, lowest = numbers, now
    return kept
