"""Weighted least squares of torque errors, within bounds and priors, and what is predicted of blocks left out.

    minimise  Σ (e(θ) / σ)² / κ  +  Σ ((θ - given) / prior)²

over the samples in which a joint moves. σ: its RMS error, estimated with the fit; κ: samples over which errors
remember, so that a sum counts what is independent in it. Score of two models: by how much the logarithm of the
likelihood of blocks that had no part in the fit differs, with its standard error over the blocks.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pgrssnn_jax.discovery.bounded import step_within
from pgrssnn_jax.discovery.inverse.evidence import Errors, Samples, Torques
from pgrssnn_jax.discovery.noise import autoregression, correlation_time
from pgrssnn_jax.discovery.problem import Problem

_STEPS = 8  # of Gauss-Newton: most numbers are linear and need one
_SHORTER = 8  # halvings of a step
_STILL_FALLS = 1e-4  # part of the cost: less is no progress, and what is not linear by less counts as linear
_LEAST = 1e-9  # of the largest σ


class Tangent(NamedTuple):
    """Error `[n, batch]` at θ, and its derivatives `[k, n, batch]` by the numbers at `places`."""

    theta: Float[np.ndarray, " p"]
    places: Int[np.ndarray, " k"]
    error: Errors
    derivatives: Float[np.ndarray, "k n batch"]

    def error_after(self, step: Float[np.ndarray, " k"]) -> Errors:
        return self.error + np.tensordot(step, self.derivatives, 1)


class Fit(NamedTuple):
    """theta; places that were free; error `[n, batch]` and its derivatives `[k, n, batch]`; weight `[n, batch]`, which
    is 1 / (σ² κ); left_out: error of every sample by the numbers of a fit without its fold."""

    theta: Float[np.ndarray, " p"]
    places: Int[np.ndarray, " k"]
    error: Errors
    derivatives: Float[np.ndarray, "k n batch"]
    weight: Errors
    left_out: Errors


class Gain(NamedTuple):
    """Difference of the log-likelihood of left-out blocks, and its standard error; fall: of the logarithm of the RMS
    error of the joint that gains most."""

    value: float
    error: float
    fall: float

    def clear(self, standard_errors: float) -> bool:
        return self.value > standard_errors * self.error


def fitted(
    torques: Torques,
    samples: Samples,
    theta: Float[np.ndarray, " p"],
    places: Int[np.ndarray, " k"],
    remembered: Float[np.ndarray, " n"],
    folds: int,
) -> Fit:
    """remembered: κ of every joint."""
    at = Tangent(theta, places, *torques.linearised(theta, samples, places))
    weight = weight_of(at.error, samples, remembered)
    straight = True
    for _ in range(_STEPS):
        step = _solved(torques.problem, at, *_sums(*_scaled(at, weight)))
        cost = _cost(torques, at.error, weight, at.theta)
        theta, error, after = _shortened(torques, samples, at, step, weight, cost)
        bent = error - at.error_after(theta[places] - at.theta[places])
        linear = float((weight * bent**2).sum()) <= _STILL_FALLS * after
        weight, straight = weight_of(error, samples, remembered), straight and linear
        if linear or cost - after <= _STILL_FALLS * cost:
            at = Tangent(theta, places, error, at.derivatives)
            break
        at = Tangent(theta, places, *torques.linearised(theta, samples, places))
    found = linear_fit(torques, samples, at, weight, folds)
    return found if straight else found._replace(left_out=_left_out(torques, samples, at, weight, folds))


def _shortened(
    torques: Torques, samples: Samples, at: Tangent, step: Float[np.ndarray, " k"], weight: Errors, cost: float
) -> tuple[Float[np.ndarray, " p"], Errors, float]:
    """θ, errors and cost after a step, halved until the cost does not exceed the given one."""
    for halved in range(_SHORTER):
        theta = at.theta.copy()
        theta[at.places] += step * 0.5**halved
        error = torques.errors(theta, samples)
        if (after := _cost(torques, error, weight, theta)) <= cost:
            return theta, error, after
    return at.theta, at.error, cost


def _left_out(torques: Torques, samples: Samples, at: Tangent, weight: Errors, folds: int) -> Errors:
    """Errors of every fold by the parameters of a fit without it, for a model that is not linear in them. Where one
    fold determines a parameter, the full step of the others would leave the range in which the tangent holds."""
    left_out = np.empty_like(at.error)
    for part, step in _steps_without(torques.problem, samples, at, weight, folds)[1]:
        left_out[:, part] = _settled(torques, samples, at, step, np.where(part, 0.0, weight))[:, part]
    return left_out


def _settled(torques: Torques, samples: Samples, at: Tangent, step: Float[np.ndarray, " k"], weight: Errors) -> Errors:
    """Errors at the optimum for a weight, from a tangent and its first step. A step that is shortened, or behind which
    the tangent does not hold, is followed by another one: the samples with no weight had a part in where it began."""
    error = at.error
    for _ in range(_STEPS):
        cost = _cost(torques, at.error, weight, at.theta)
        theta, error, after = _shortened(torques, samples, at, step, weight, cost)
        bent = error - at.error_after(step)
        if cost - after <= _STILL_FALLS * cost or float((weight * bent**2).sum()) <= _STILL_FALLS * after:
            break
        at = Tangent(theta, at.places, *torques.linearised(theta, samples, at.places))
        step = _solved(torques.problem, at, *_sums(*_scaled(at, weight)))
    return error


def refitted(
    torques: Torques,
    samples: Samples,
    at: Tangent,
    weight: Errors,
    remembered: Float[np.ndarray, " n"],
    folds: int,
) -> Fit:
    """`linear_fit` with weights by the errors that one step leaves."""
    error = at.error_after(_solved(torques.problem, at, *_sums(*_scaled(at, weight))))
    return linear_fit(torques, samples, at, weight_of(error, samples, remembered), folds)


def linear_fit(torques: Torques, samples: Samples, at: Tangent, weight: Errors, folds: int) -> Fit:
    """One step from θ, and the same without each fold; what is nonlinear in θ keeps its tangent."""
    step, without = _steps_without(torques.problem, samples, at, weight, folds)
    left_out = np.empty_like(at.error)
    for part, other in without:
        left_out[:, part] = at.error[:, part] + np.tensordot(other, at.derivatives[..., part], 1)
    theta = at.theta.copy()
    theta[at.places] += step
    return Fit(theta, at.places, at.error_after(step), at.derivatives, weight, left_out)


def _steps_without(
    problem: Problem, samples: Samples, at: Tangent, weight: Errors, folds: int
) -> tuple[Float[np.ndarray, " k"], list[tuple[Bool[np.ndarray, " batch"], Float[np.ndarray, " k"]]]]:
    """The step of all samples, and of every fold its samples and the step of the others."""
    fold_of = samples.block % folds
    error, columns = _scaled(at, weight)
    parts = [fold_of == fold for fold in range(folds)]
    sums = [_sums(error[:, part], columns[..., part]) for part in parts]
    normal, pull = np.sum([one for one, _ in sums], axis=0), np.sum([other for _, other in sums], axis=0)
    without = [
        (part, _solved(problem, at, normal - own_normal, pull - own_pull))
        for part, (own_normal, own_pull) in zip(parts, sums, strict=True)
    ]
    return _solved(problem, at, normal, pull), without


def gain(before: Errors, after: Errors, samples: Samples, remembered: Float[np.ndarray, " n"]) -> Gain:
    """Of left-out errors over others."""
    by_joint, falls = _gains_and_falls(before, after, samples, remembered)
    return Gain(float(by_joint.sum()), _deviation(by_joint.sum(0)), float(falls.max()))


def joint_gains(before: Errors, after: Errors, samples: Samples, remembered: Float[np.ndarray, " n"]) -> list[Gain]:
    """The same of every joint alone."""
    by_joint, falls = _gains_and_falls(before, after, samples, remembered)
    return [Gain(float(one.sum()), _deviation(one), float(fall)) for one, fall in zip(by_joint, falls, strict=True)]


def _gains_and_falls(
    before: Errors, after: Errors, samples: Samples, remembered: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n block"], Float[np.ndarray, " n"]]:
    by_joint = gains_by_block(before, after, samples, remembered)
    return by_joint, by_joint.sum(1) * remembered / before.shape[1]


def _deviation(by_block: Float[np.ndarray, " block"]) -> float:
    """Of the sum."""
    return float(by_block.std(ddof=1) * len(by_block) ** 0.5)


def gains_by_block(
    before: Errors, after: Errors, samples: Samples, remembered: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n block"]:
    """σ of a joint is that of each model."""
    by_block = np.zeros((len(remembered), samples.blocks))
    for joint, (moving, kappa) in enumerate(zip(samples.moving, remembered, strict=True)):
        one, other = (e[joint, moving] ** 2 for e in (before, after))
        if not (one.any() and other.any()):
            continue
        old, new = one.mean(), other.mean()
        terms = np.log(old / new) + one / old - other / new
        by_block[joint] = np.bincount(samples.block[moving], terms / (2 * kappa), samples.blocks)
    return by_block


def remembered(error: Errors, samples: Samples) -> Float[np.ndarray, " n"]:
    """κ: samples over which the errors of each joint remember, at least 1. Those at rest count relative to
    their own RMS: gaps in the record would bias the estimate."""
    still = samples._replace(moving=~samples.moving)
    sigma = np.where(samples.moving, _sigma(error, samples), _sigma(error, still))
    scaled = (error / sigma).reshape(len(error), -1, samples.length)
    return np.array([max(1.0, correlation_time(autoregression(one))) for one in scaled])


def _sigma(error: Errors, samples: Samples) -> Float[np.ndarray, "n 1"]:
    """σ of every joint; any where it never moves."""
    count = samples.moving.sum(1, keepdims=True)
    found = np.sqrt((samples.moving * error**2).sum(1, keepdims=True) / np.maximum(count, 1))
    largest = found.max() or 1.0
    return np.where(count > 0, np.maximum(found, _LEAST * largest), largest)


def weight_of(error: Errors, samples: Samples, kappa: Float[np.ndarray, " n"]) -> Errors:
    return samples.moving / (_sigma(error, samples) ** 2 * kappa[:, None])


def _cost(torques: Torques, error: Errors, weight: Errors, theta: np.ndarray) -> float:
    return float((weight * error**2).sum()) + torques.problem.penalty(theta)


def _scaled(at: Tangent, weight: Errors) -> tuple[Errors, Float[np.ndarray, "k n batch"]]:
    """Errors and derivatives in standard deviations."""
    root = np.sqrt(weight)
    return at.error * root, at.derivatives * root


def _sums(error: Errors, columns: Float[np.ndarray, "k n batch"]) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and pull."""
    flat = columns.reshape(len(columns), error.size)
    return flat @ flat.T, -flat @ error.ravel()


def _solved(problem: Problem, at: Tangent, normal: np.ndarray, pull: np.ndarray) -> Float[np.ndarray, " k"]:
    """Change of the numbers at `places`, with what is known of them before."""
    places, now = at.places, at.theta[at.places]
    precision = problem.precision[places]
    return step_within(
        normal + np.diag(precision),
        pull - precision * (now - problem.theta[places]),
        problem.low[places] - now,
        problem.high[places] - now,
    )
