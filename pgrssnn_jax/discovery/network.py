"""How much of the prediction a network still has to supply, with the old and with the new physics.

    share = RMS(ŷ of PG-RSSNN - ŷ of its physics alone) / std(y)          on the test record, mean over members

Training begins at the physics (output heads at zero), so the physics alone is the model before its first epoch.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from pgrssnn_jax.cli.plan import Plan, plan_training
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.effects.discovered import OF_TRAINING
from pgrssnn_jax.training import evaluation as evaluate
from pgrssnn_jax.training.loop import no_losses, train
from pgrssnn_jax.training.members import jit_members, keys_of
from pgrssnn_jax.training.metrics import nrmse, rmse


def plan_network(setup: Setup, effects: str | None) -> Plan:
    """Training on the record that was examined; effects: the file of what was found, None for the nominal physics.
    Raises `ValueError` for settings of the training that are none."""
    config, given = setup.config, setup.config["physics"]
    # gradients as in training; the backend as in the discovery, because another may not know the effects
    kept = {name: given[name] for name in OF_TRAINING if name in given and name != "backend"}
    settings = {
        **{key: value for key, value in config.items() if key != "discovery"},
        "physics": {**setup.group, **kept, "effects": effects},
        "data": {name: 1 if name == "realisations" else value for name, value in config["data"].items()},
        "model": {**config["model"], "start_from_physics": True},
        "fit": {**config["fit"], "epochs": setup.settings.network_epochs},
    }
    return plan_training(settings, lambda line: None)


def network_shares(setup: Setup, effects: str, notify: Callable[[str], None], stop: threading.Event) -> dict[str, Any]:
    """effects: the file of what was found."""
    shares: dict[str, Any] = {}
    for when, added in (("before", None), ("after", effects)):
        plan = plan_network(setup, added)
        share, error, metric, unit = _one(plan, stop)
        shares |= {f"share_{when}": share, f"{metric.lower()}_{when}": error, "metric": metric, "unit": unit}
        said = f"{metric} {error:.3g} {unit}".rstrip()
        notify(f"PG-RSSNN {when}: the network supplies {100 * share:.1f} % of the prediction, {said}")
        shares["members"] = len(plan.members)
    return {**shares, "epochs": setup.settings.network_epochs}


def _one(plan: Plan, stop: threading.Event) -> tuple[float, float, str, str]:
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
    metric, unit = ("NRMSE", "") if several else ("RMSE", measured.info.outputs[0].unit)
    return float(np.mean(shares)), float(np.mean(errors)), metric, unit
