"""How much of the prediction a network still has to supply, with the old and with the new physics.

    share = RMS(ŷ of PG-RSSNN - ŷ of its physics alone) / std(y)          on the test record, mean over members

Training begins at the physics (output heads at zero), so the physics alone is the model before its first epoch.
"""

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pgrssnn_jax import evaluate
from pgrssnn_jax.members import jit_members, keys_of
from pgrssnn_jax.metrics import nrmse, rmse
from pgrssnn_jax.plan import plan_training
from pgrssnn_jax.training import no_losses, train


def network_shares(
    config: Mapping[str, Any],
    old: Mapping[str, Any],
    new: Mapping[str, Any],
    epochs: int,
    notify: Callable[[str], None],
    stop: threading.Event,
) -> dict[str, Any]:
    """config: of a training run; old, new: its `physics` group without and with the effects."""
    settings = {
        **{key: value for key, value in config.items() if key != "discovery"},
        "model": {**config["model"], "start_from_physics": True},
        "fit": {**config["fit"], "epochs": epochs},
    }
    shares = {}
    for when, group in (("before", old), ("after", new)):
        share, error, unit = _one({**settings, "physics": dict(group)}, stop)
        shares |= {f"share_{when}": share, f"rmse_{when}": error, "unit": unit}
        notify(f"PG-RSSNN {when}: the network supplies {100 * share:.1f} % of the prediction, error {error:.3g} {unit}")
    return {**shares, "epochs": epochs, "members": config["n_seeds"]}


def _one(config: Mapping[str, Any], stop: threading.Event) -> tuple[float, float, str]:
    plan = plan_training(config, lambda line: None)
    begun = jit_members(plan.fit.begin, plan.mapping)(keys_of(plan.members), plan.data)
    alone = evaluate.predict(plan.fit.objective, begun, plan.data, plan.test, plan.mapping).test
    done = train(
        plan.fit, plan.mapping, begun, plan.data, no_losses(len(plan.members)),
        on_chunk=lambda state, losses, now: None, stop=stop,
    )  # fmt: skip
    together = evaluate.predict(plan.fit.objective, done.state, plan.data, plan.test, plan.mapping).test
    measured = plan.measured.test
    several = measured.y.shape[-1] > 1
    shares, errors = [], []
    for i in range(len(together)):
        y, mask = np.asarray(measured.y[i], np.float64), np.asarray(measured.mask[i])
        spread = np.nanstd(np.where(mask, y, np.nan), axis=(0, 1))
        added = np.sqrt(np.mean((together[i] - alone[i]).astype(np.float64) ** 2, axis=(0, 1)))
        shares.append(float(np.mean(added / spread)))
        error = (nrmse if several else rmse)(measured=y, predicted=together[i], mask=mask, n_init=plan.report_n_init[0])
        errors.append(float(np.mean(error)))
    unit = "" if several else measured.info.outputs[0].unit
    return float(np.mean(shares)), float(np.mean(errors)), unit
