"""The intervals of trained members from the plan that they were trained by.

A physics that discovery has fitted to the record has seen what members leave out. Their errors are then larger on other
records by what the discovery has measured on quarters of the record (`Physics.optimism`). Where it has not, as on arms,
Akaike's final prediction error says it, for k numbers that were fitted to samples worth n independent ones:

    E_other / E_left_out = (n + k) / (n - k),      n = samples / (1 + 2 Σ_{j>0} ρ_j)         ρ: of the left-out errors

Source: Akaike, Fitting autoregressive models for prediction, Annals of the Institute of Statistical Mathematics 1969.
"""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from pgrssnn_jax.physics.base import Physics, is_parameter
from pgrssnn_jax.training.intervals import Intervals, calibrate
from pgrssnn_jax.training.left_out import LeftOut, by_long_blocks, left_out, optimism
from pgrssnn_jax.training.loop import Losses
from pgrssnn_jax.training.plan import Plan


def calibrated(
    plan: Plan,
    predicted: Float[np.ndarray, "member seq time y"],
    usable: Bool[np.ndarray, " member"],
    losses: Losses,
    recipe: Mapping[str, Any] | None = None,
) -> Intervals | None:
    """predicted: by members, of their validation records, from starts that are found as those of a test record
    (`Objective.as_tested`); usable: which have not failed; recipe: `Chosen.report`, where settings were chosen. None
    where no sample of an output was left out."""
    usable, aside, objective = usable & np.isfinite(predicted).all((1, 2, 3)), plan.validation, plan.fit.objective
    if not usable.any():
        return None
    mask = np.asarray(aside.mask)
    alone = objective.model.graph is None and not objective.train_physics
    if alone and aside.info.same_run:
        # nothing was fitted but where the record starts: all of it is left out
        mask = mask | np.asarray(plan.data.train.mask)
    if objective.starts_as_tested(plan.data.validation):
        counted = np.arange(mask.shape[-2]) >= objective.initial.n_init  # the start was found from the samples before
        mask = mask & counted[:, None]
    found = left_out(
        predicted, aside._replace(mask=mask), [m.dataset for m in plan.members], np.flatnonzero(usable).tolist()
    )
    # members that all leave out the same record have no epoch of others
    more = optimism(losses.validation) if plan.settings.data.folds else 1.0
    if recipe and recipe["tried"] and not alone:
        chosen = recipe["tried"][0]
        more *= by_long_blocks(losses.validation, chosen["left_out_nrmse"], chosen["epochs"])
    if plan.physics.discovered:
        more *= plan.physics.optimism or _by_akaike(found, plan.physics)
    return calibrate(found, (plan.train, plan.validation), more)


def _by_akaike(found: LeftOut, physics: Physics) -> float:
    """sqrt(E_other / E_left_out), at most that of k = n / 2."""
    numbers, parameters = jax.tree.leaves(physics.params), jax.tree.leaves(physics.parameters, is_leaf=is_parameter)
    fitted = sum(np.size(n) for n, p in zip(numbers, parameters, strict=True) if p.trainable and np.isfinite(n).all())
    share = min(fitted / found.independent.sum(), 0.5)
    return float(np.sqrt((1.0 + share) / (1.0 - share)))
