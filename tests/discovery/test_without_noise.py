"""Simulated data without noise: what an integrator leaves is no finding."""

import numpy as np
import pytest
from discovery.test_stand_ins import axis, pushed

import pgrssnn_jax as pg
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import set_up
from pgrssnn_jax.training.settings import training_settings


def exact(seed: int, constant: float, monkeypatch: pytest.MonkeyPatch) -> pg.Record:
    monkeypatch.setattr("discovery.test_stand_ins.NOISE", 0.0)
    return pushed(seed, constant)


def test_records_get_a_noise_that_no_converter_would_see(monkeypatch):
    train, test = (exact(seed, 0.0, monkeypatch) for seed in (24, 25))
    setup = set_up(axis(), train, test, DiscoverySettings(), training_settings("pg_rssnn"), notify=lambda line: None)
    for given, used in ((train, setup.estimation), (test, setup.test)):
        added = np.asarray(used.y, float).ravel() - np.asarray(given.y, float).ravel()
        assert 0.8e-5 < added.std() / np.std(given.y) < 1.2e-5
        np.testing.assert_array_equal(used.u, np.asarray(given.u).reshape(used.u.shape))


@pytest.mark.slow
@pytest.mark.parametrize(("constant", "verdict", "names"), [(0.0, "miscalibrated", 0), (0.05, "effect_found", 1)])
def test_exact_data_give_the_right_answer(constant, verdict, names, monkeypatch):
    """Without that noise a delay was named, and an unknown effect beside it."""
    records = [exact(seed, constant, monkeypatch) for seed in (24, 25)]
    found = pg.discover(axis(), *records, network_epochs=0, quiet=True)
    assert (found.verdict, len(found.effects)) == (verdict, names)
