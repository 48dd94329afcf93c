"""The whole way on a plant of one state, from arrays to the folder of the discovery."""

import json

import numpy as np
import pytest

import pgrssnn_jax as pg

DT, RATE, LIMIT, NOISE = 0.5, 0.2, 1.4, 0.02  # s, 1/s, V, V


def vessel() -> pg.Physics:
    """dx/dt = gain·u - rate·x, y = x"""
    return pg.continuous(
        "vessel",
        lambda p, x, u: p["gain"] * u - p["rate"] * x,
        lambda p, x, u: x,
        {"gain": 1.0, "rate": RATE},
        states=(pg.Signal("level", "V", like="level"),),
        inputs=(pg.Signal("pump", "V"),),
        outputs=(pg.Signal("level", "V"),),
        dt=DT,
    )


def measured(seed: int, samples: int = 300) -> pg.Record:
    """By the solution of the equation for inputs that are held; the pump gives no more than LIMIT."""
    rng, kept = np.random.default_rng(seed), np.exp(-RATE * DT)
    u = np.repeat(rng.uniform(0.0, 2.0, samples // 10), 10)
    x = np.zeros(samples)
    for t, pumped in enumerate(np.minimum(u, LIMIT)):
        x[t] = kept * (x[t - 1] if t else 0.0) + (1.0 - kept) / RATE * pumped
    y = x + NOISE * rng.standard_normal(samples)
    return pg.record(u[:, None], y[:, None], dt=DT, inputs={"pump": "V"}, outputs={"level": "V"}, start="rest")


def test_a_saturated_pump_is_found_and_saved(tmp_path):
    found = pg.discover(vessel(), measured(1), measured(2), network_epochs=0, quiet=True)
    assert found.verdict == "effect_found"
    assert [effect.name for effect in found.effects] == ["input_saturation"]
    assert np.ravel(found.effects[0].parameters["high"]["value"]) == pytest.approx([LIMIT], rel=0.02)
    assert 0.95 < found.gap["closed_fraction"] < 1.05
    test = measured(2)
    simulated = pg.simulate(found.physics, test.u[0], np.zeros(len(found.physics.states)))
    assert np.std(test.y[0] - simulated.y) == pytest.approx(NOISE, rel=0.1)
    found.save(tmp_path / "run")
    saved = json.loads((tmp_path / "run" / "discovery.json").read_text(), parse_constant=pytest.fail)
    assert [effect["name"] for effect in saved["effects"]] == ["input_saturation"]
    assert found.details["sentence"] in (tmp_path / "run" / "report.html").read_text()
