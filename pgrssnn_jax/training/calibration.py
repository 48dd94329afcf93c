"""The intervals of trained members from the plan that they were trained by."""

import numpy as np
from jaxtyping import Bool, Float

from pgrssnn_jax.training.intervals import Intervals, calibrate
from pgrssnn_jax.training.left_out import left_out, optimism
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
    return calibrate(found, (plan.train, plan.validation), more)
