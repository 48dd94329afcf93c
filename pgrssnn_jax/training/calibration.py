"""The intervals of trained members from the plan that they were trained by.

A physics that discovery has fitted to the record has seen what members leave out. Their errors are then larger on other
records by Akaike's final prediction error, for k numbers that were fitted to samples worth n independent ones:

    E_other / E_left_out = (n + k) / (n - k),      n = samples / (1 + 2 Σ_{j>0} ρ_j)         ρ: of the left-out errors

Source: Akaike, Fitting autoregressive models for prediction, Annals of the Institute of Statistical Mathematics 1969.
"""

import jax
import numpy as np
from jaxtyping import Bool, Float

from pgrssnn_jax.physics.base import Physics, is_parameter
from pgrssnn_jax.training.blocks import correlation_time
from pgrssnn_jax.training.intervals import Intervals, calibrate
from pgrssnn_jax.training.left_out import LeftOut, left_out, optimism
from pgrssnn_jax.training.loop import Losses
from pgrssnn_jax.training.plan import Plan


def calibrated(
    plan: Plan,
    validated: Float[np.ndarray, "member seq time y"],
    usable: Bool[np.ndarray, " member"],
    losses: Losses,
) -> Intervals | None:
    """validated: what members predict of their validation records; usable: which have not failed. None where no sample
    of an output was left out."""
    usable, aside, objective = usable & np.isfinite(validated).all((1, 2, 3)), plan.validation, plan.fit.objective
    if not usable.any():
        return None
    if objective.model.graph is None and not objective.train_physics and aside.info.same_run:
        # nothing was fitted but where the record starts: all of it is left out
        aside = aside._replace(mask=np.asarray(aside.mask) | np.asarray(plan.data.train.mask))
    found = left_out(validated, aside, [m.dataset for m in plan.members], np.flatnonzero(usable).tolist())
    # members that all leave out the same record have no epoch of others
    more = optimism(losses.validation) if plan.settings.data.folds else 1.0
    if plan.physics.discovered:
        more *= _fitted_before(found, plan.physics)
    return calibrate(found, (plan.train, plan.validation), more)


def _fitted_before(found: LeftOut, physics: Physics) -> float:
    """sqrt(E_other / E_left_out), at most that of k = n / 2."""
    numbers, parameters = jax.tree.leaves(physics.params), jax.tree.leaves(physics.parameters, is_leaf=is_parameter)
    fitted = sum(np.size(n) for n, p in zip(numbers, parameters, strict=True) if p.trainable and np.isfinite(n).all())
    independent = 0.0
    for error, measured in zip(np.moveaxis(found.error, -1, 1), np.moveaxis(found.measured, -1, 1), strict=True):
        for one, which in zip(error, measured, strict=True):
            independent += which.sum() / (1.0 + 2.0 * correlation_time(np.where(which, one, 0.0)))
    share = min(fitted / max(independent, 1.0), 0.5)
    return float(np.sqrt((1.0 + share) / (1.0 - share)))
