"""How much of the prediction a network still has to supply, with the old and with the new physics.

    share = RMS(ŷ of PG-RSSNN - ŷ of its physics alone) / std(y)          on the test record, mean over members

The physics alone is the model without its networks (`training/shares.py`).
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.effects.stored import OF_TRAINING, stored_physics
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import take
from pgrssnn_jax.training.choose import on_fitted, settled
from pgrssnn_jax.training.evaluation import predict, trained_members
from pgrssnn_jax.training.loop import train
from pgrssnn_jax.training.metrics import nrmse, rmse
from pgrssnn_jax.training.plan import MemberTests, Plan, member_tests, plan_training
from pgrssnn_jax.training.settings import RunSettings
from pgrssnn_jax.training.shares import network_share
from pgrssnn_jax.training.train import first_checkpoint


def plan_network(setup: Setup, found: Mapping[str, Any] | None) -> tuple[Plan, MemberTests]:
    """Training on the record that was examined; found: `discovery.json`, None for the nominal physics. Raises
    `ValueError` for settings of the training that are none."""
    given, chosen = setup.nominal.settings, setup.training
    # gradients as in training; the backend as in the discovery, because another may not know the effects
    kept = {name: given[name] for name in OF_TRAINING if name in given and name != "backend"}
    physics: Physics = setup.physics.variant(**kept)
    if found is not None:
        physics = stored_physics(physics, found, where="discovery", extra=setup.effects)
    settings = chosen._replace(fit=replace(chosen.fit, epochs=setup.settings.network_epochs))
    if not settings.data.folds:  # as with recipe=auto: the tail of a record may be quiet, and tells little
        settings = on_fitted(physics, setup.train, setup.validation, settings, {"patience"})
    settings = settings._replace(
        model=replace(chosen.model, start_from_physics=True),
        run=_started(setup, settings.run) if physics.differentiable else chosen.run,
    )
    plan = plan_training(physics, setup.train, settings, validation=setup.validation)
    wanted = settings.run.report_n_init
    return plan, member_tests(plan.fit.objective, plan.members, plan.units, wanted, setup.test)


def _started(setup: Setup, chosen: RunSettings) -> RunSettings:
    """The first output is no initial state where a sensor has an offset or an effect has memory. Where nothing is known
    of it, it is estimated from the first samples, at most half of the shortest record."""
    if setup.start is Start.UNKNOWN and chosen.initial_state == "first_output":
        chosen = replace(chosen, initial_state="estimated")
    shortest = min(record.u.shape[-2] for record in (setup.train, setup.validation, setup.test))
    return replace(chosen, n_init=max(1, min(chosen.n_init, shortest // 2)))


def network_shares(
    setup: Setup, found: Mapping[str, Any], notify: Callable[[str], None], stop: threading.Event
) -> dict[str, Any]:
    """found: `discovery.json`."""
    shares: dict[str, Any] = {}
    for when, added in (("before", None), ("after", found)):
        plan, tests = plan_network(setup, added)
        share, error, metric, unit = _one(plan, tests, stop)
        shares |= {f"share_{when}": share, f"{metric.lower()}_{when}": error, "metric": metric, "unit": unit}
        notify(f"PG-RSSNN {when}: {_part(share)}, {metric} {error:.3g} {unit}".rstrip())
        shares["members"] = len(plan.members)
    return {**shares, "epochs": setup.settings.network_epochs}


def _part(share: float) -> str:
    """A sentence's main clause."""
    if share <= 1.0:
        return f"the network supplies {100 * share:.1f} % of the prediction"
    return f"the network adds {share:.3g} standard deviations of the measurement, more than the measurement varies"


def _one(plan: Plan, tests: MemberTests, stop: threading.Event) -> tuple[float, float, str, str]:
    first = first_checkpoint(plan)
    done = train(
        plan.fit, plan.mapping, first.state, plan.data, first.losses,
        on_chunk=lambda state, losses, now: None, stop=stop,
    )  # fmt: skip
    kept, _ = settled(plan, done.state, {})  # a member that is no better than its physics is that physics
    found, measured = predict(trained_members(plan, kept), tests.record), tests.measured
    assert found.alone is not None  # a guided model with networks
    several, shares, errors = measured.y.shape[-1] > 1, [], []
    for i, (predicted, alone) in enumerate(zip(found.y, found.alone, strict=True)):
        record = take(measured, i)
        shares.append(float(np.mean(network_share(record, predicted, alone))))
        error = (nrmse if several else rmse)(
            measured=record.y, predicted=predicted, mask=record.mask, n_init=tests.n_inits[0]
        )
        errors.append(float(np.mean(error)))
    metric, unit = ("NRMSE", "") if several else ("RMSE", measured.info.outputs[0].unit)
    return float(np.mean(shares)), float(np.mean(errors)), metric, unit
