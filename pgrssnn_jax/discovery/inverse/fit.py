"""Weighted least squares of torque errors, within bounds and priors, and what is predicted of blocks left out.

    minimise  Σ (e(θ) / σ)² / κ  +  Σ ((θ - given) / prior)²

σ: RMS error of a joint in a regime (moving, at rest), estimated with the fit; κ: samples over which errors remember, so
that a sum counts what is independent in it. Score of two models: by how much the logarithm of the likelihood of blocks
that had no part in the fit differs, with its standard error over the blocks.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.bounded import step_within
from pgrssnn_jax.discovery.inverse.evidence import Errors, Samples, Torques
from pgrssnn_jax.discovery.noise import autoregression, correlation_time
from pgrssnn_jax.discovery.problem import Problem

_STEPS = 8  # of Gauss-Newton: most numbers are linear and need one
_SHORTER = 8  # halvings of a step
_STILL_FALLS = 1e-4  # part of the cost: less is no progress, and what is not linear by less counts as linear
_LEAST = 1e-9  # of the largest σ


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
    error, derivatives = torques.linearised(theta, samples, places)
    weight = regime_weight(error, samples, remembered)
    for _ in range(_STEPS):
        sums = _sums(error, derivatives, np.sqrt(weight), np.ones(error.shape[1], bool))
        step = _solved(torques.problem, theta, places, *sums)
        now, before, cost = theta, error, _cost(torques, error, weight, theta)
        for halved in range(_SHORTER):
            theta = now.copy()
            theta[places] += step * 0.5**halved
            error = torques.errors(theta, samples)
            if (after := _cost(torques, error, weight, theta)) <= cost:
                break
        else:
            theta, error, after = now, torques.errors(now, samples), cost
        bent = error - before - np.tensordot(theta[places] - now[places], derivatives, 1)
        linear = float((weight * bent**2).sum()) <= _STILL_FALLS * after
        weight = regime_weight(error, samples, remembered)
        if linear or cost - after <= _STILL_FALLS * cost:
            break
        _, derivatives = torques.linearised(theta, samples, places)
    return linear_fit(torques, samples, theta, places, error, derivatives, weight, folds)


def linear_fit(
    torques: Torques,
    samples: Samples,
    theta: Float[np.ndarray, " p"],
    places: Int[np.ndarray, " k"],
    error: Errors,
    derivatives: Float[np.ndarray, "k n batch"],
    weight: Errors,
    folds: int,
) -> Fit:
    """One step from θ, and the same without each fold; what is nonlinear in θ keeps its tangent."""
    problem, fold_of = torques.problem, samples.block % folds
    root = np.sqrt(weight)
    sums = [_sums(error, derivatives, root, fold_of == fold) for fold in range(folds)]
    whole = np.sum([normal for normal, _ in sums], axis=0), np.sum([pull for _, pull in sums], axis=0)
    left_out = np.empty_like(error)
    for fold, (normal, pull) in enumerate(sums):
        out = fold_of == fold
        without = _solved(problem, theta, places, whole[0] - normal, whole[1] - pull)
        left_out[:, out] = error[:, out] + np.tensordot(without, derivatives[..., out], 1)
    step = _solved(problem, theta, places, *whole)
    moved = theta.copy()
    moved[places] += step
    return Fit(moved, places, error + np.tensordot(step, derivatives, 1), derivatives, weight, left_out)


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
    """Of the samples in which a joint moves, if there are any: at rest, friction holds it against any torque within its
    reach, and whatever asks for less torque there would seem to predict. σ of a joint is that of each model."""
    by_block = np.zeros((len(remembered), samples.blocks))
    for joint, kappa in enumerate(remembered):
        for regime in samples.regimes(joint)[:1]:
            one, other = (e[joint, regime] ** 2 for e in (before, after))
            old, new = one.mean(), other.mean()
            if not old > 0 or not new > 0:
                continue
            terms = np.log(old / new) + one / old - other / new
            by_block[joint] += np.bincount(samples.block[regime], terms / (2 * kappa), samples.blocks)
    return by_block


def remembered(error: Errors, samples: Samples) -> Float[np.ndarray, " n"]:
    """κ: samples over which the errors of each joint remember, at least 1."""
    scaled = (error / _sigma(error, samples)).reshape(len(error), -1, samples.length)
    return np.array([max(1.0, correlation_time(autoregression(one))) for one in scaled])


def _sigma(error: Errors, samples: Samples) -> Errors:
    """σ of every sample."""
    found = np.ones_like(error)
    for joint, one in enumerate(error):
        for regime in samples.regimes(joint):
            found[joint, regime] = np.sqrt(np.mean(one[regime] ** 2))
    return np.maximum(found, _LEAST * found.max())


def regime_weight(error: Errors, samples: Samples, kappa: Float[np.ndarray, " n"]) -> Errors:
    return samples.counted / (_sigma(error, samples) ** 2 * kappa[:, None])


def _cost(torques: Torques, error: Errors, weight: Errors, theta: np.ndarray) -> float:
    return float((weight * error**2).sum()) + torques.problem.penalty(theta)


def _sums(error: Errors, derivatives: np.ndarray, root: Errors, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and pull of the samples that are kept."""
    scaled = (error[:, kept] * root[:, kept]).ravel()
    columns = (derivatives[..., kept] * root[:, kept]).reshape(len(derivatives), len(scaled))
    return columns @ columns.T, -columns @ scaled


def _solved(
    problem: Problem, theta: np.ndarray, places: Int[np.ndarray, " k"], normal: np.ndarray, pull: np.ndarray
) -> Float[np.ndarray, " k"]:
    """Change of the numbers at `places`, with what is known of them before."""
    precision = problem.precision[places]
    return step_within(
        normal + np.diag(precision),
        pull - precision * (theta[places] - problem.theta[places]),
        problem.low[places] - theta[places],
        problem.high[places] - theta[places],
    )
