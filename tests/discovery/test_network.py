"""The networks that prove a discovery."""

import numpy as np
import pytest

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.network import plan_network
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import set_up
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.training.settings import training_settings


@pytest.mark.parametrize(
    ("start", "expected"), [("unknown", "estimated"), ("shared", "estimated"), ("rest", "first_output")]
)
def test_they_are_trained_as_by_recipe_auto_on_a_fitted_physics(start, expected):
    u = np.linspace(1.0, 4.0, 400)[:, None]
    signals = {"inputs": {"pump_voltage": "V"}, "outputs": {"level_voltage": "V"}, "start": start}
    train, test = (pg.record(part, np.sqrt(part), dt=4.0, **signals) for part in np.split(u, 2))
    settings = training_settings("pg_rssnn")
    setup = set_up(cascaded_tanks(), train, test, DiscoverySettings(), settings, notify=print)
    plan, _ = plan_network(setup, None)
    assert plan.fit.objective.initial.kind == expected
    assert plan.settings.model.start_from_physics
    assert plan.settings.data.folds > 1  # members take turns in what they leave out, the tail of a record is no judge
