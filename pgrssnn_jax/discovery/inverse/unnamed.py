"""Torques that follow the motion by no law of the catalogue.

    e_j ≈ Σ_k c_k cos(ω_k · s + β_k),   ω_k ~ N(0, I / ℓ²),   β_k ~ U(0, 2π)

e_j: torque errors of the recalibrated physics while joint j moves; s: [q, q̇_j] or [q_j, q̇_j], in standard deviations.
c by ridge regression without each fold of blocks, which it then predicts; s, ℓ and the ridge are those that predict
best. Where this smooth function predicts a joint clearly better than the named effects do, they stand in for something
else.
Source: Rahimi, Recht, Random features for large-scale kernel machines, NIPS 2007.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pgrssnn_jax.discovery.inverse.evidence import Samples
from pgrssnn_jax.discovery.inverse.fit import joint_gains
from pgrssnn_jax.discovery.inverse.select import Chosen, Search

_FEATURES = 120
_WIDTHS = (0.7, 2.0)  # ℓ over the root of the number of signals
_RIDGES = (0.1, 1.0, 10.0, 100.0)  # of features whose squares sum up to 1


class Unnamed(NamedTuple):
    """joints: counted from 0; share: of the energy of their errors, with the named effects, that follows the motion."""

    joints: tuple[int, ...]
    share: float


def unnamed(search: Search, chosen: Chosen) -> Unnamed | None:
    """None where the named effects, if there are any, predict every joint as well."""
    samples, named = search.samples, chosen.final.fit.left_out
    smooth = named.copy()
    for joint, error in enumerate(chosen.recalibrated.left_out):
        moving = samples.moving[joint]
        if moving.sum() > _FEATURES:
            smooth[joint, moving] = _left_out(samples, joint, moving, error[moving], search.folds)
    gains = joint_gains(named, smooth, samples, chosen.kappa)
    joints = [joint for joint, one in enumerate(gains) if search.worth(one)]
    if not joints:
        return None
    left, whole = (float((error[joints] ** 2 * samples.moving[joints]).sum()) for error in (smooth, named))
    return Unnamed(tuple(joints), 1.0 - left / whole)


def _left_out(
    samples: Samples,
    joint: int,
    moving: Bool[np.ndarray, " batch"],
    error: Float[np.ndarray, " moving"],
    folds: int,
) -> Float[np.ndarray, " moving"]:
    """Errors of one joint less the smooth function, each from a fit without its fold."""
    fold = samples.block[moving] % folds
    signals = np.vstack([samples.reading, samples.v[joint]])[:, moving]
    scaled = (signals - signals.mean(1, keepdims=True)) / np.maximum(signals.std(1, keepdims=True), 1e-12)
    tried = [
        _without_folds(_features(some, width * len(some) ** 0.5), error, fold, ridge)
        for some in (scaled, scaled[[joint, -1]])
        for width in _WIDTHS
        for ridge in _RIDGES
    ]
    return min([error, *tried], key=lambda one: float((one**2).sum()))


def _features(signals: Float[np.ndarray, "s batch"], width: float) -> Float[np.ndarray, "k batch"]:
    rng = np.random.default_rng(0)
    omega = rng.normal(size=(_FEATURES, len(signals))) / width
    waves = np.cos(omega @ signals + rng.uniform(0, 2 * np.pi, (_FEATURES, 1)))
    return np.vstack([np.ones(signals.shape[1]), (2 / _FEATURES) ** 0.5 * waves])


def _without_folds(
    features: Float[np.ndarray, "k batch"],
    error: Float[np.ndarray, " batch"],
    fold: Int[np.ndarray, " batch"],
    ridge: float,
) -> Float[np.ndarray, " batch"]:
    left = error.copy()
    for one in np.unique(fold):
        seen, own = fold != one, fold == one
        normal = features[:, seen] @ features[:, seen].T + ridge * np.eye(len(features))
        left[own] -= np.linalg.solve(normal, features[:, seen] @ error[seen]) @ features[:, own]
    return left
