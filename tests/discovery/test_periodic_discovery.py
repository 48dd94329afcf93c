"""A periodic disturbance that no signal records is found with its place, its size and its frequency."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pgrssnn_jax as pg

pytestmark = pytest.mark.slow
DT, NOISE = 0.02, 0.005


def swing(g: float = 9.81, c: float = 0.3) -> pg.Physics:
    return pg.continuous(
        "swing",
        lambda p, x, u: jnp.stack([x[1], -p["g"] * jnp.sin(x[0]) - p["c"] * x[1] + u[0]]),
        lambda p, x, u: x[:1],
        {"g": g, "c": c},
        parameters={"g": pg.Parameter("g", "1/s^2"), "c": pg.Parameter("c", "1/s", bounds=(0.0, 10.0))},
        dt=DT,
        states=(pg.Signal("angle", "rad", like="angle"), pg.Signal("speed", "rad/s", rate_of="angle")),
        inputs=(pg.Signal("torque", "Nm"),),
        outputs=(pg.Signal("angle", "rad"),),
    )


def recorded(seed: int, torque: float, hum: float, frequency: float, phase: float, samples: int = 1200):
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.uniform(-4.0, 4.0, samples // 25 + 1), 25)[:samples]
    x, y = np.array([0.1, 0.0]), []

    def slope(t, x, held):
        pushed = held + torque * np.sin(2 * np.pi * frequency * t + phase)
        return [x[1], -9.0 * np.sin(x[0]) - 0.36 * x[1] + pushed]

    for k, held in enumerate(u):
        x = solve_ivp(slope, (k * DT, (k + 1) * DT), x, args=(held,), rtol=1e-7, atol=1e-9).y[:, -1]
        y.append(x[0] + hum * np.sin(2 * np.pi * frequency * (k + 1) * DT + phase))
    measured = np.array(y)[:, None] + NOISE * draw.standard_normal((samples, 1))
    return pg.record(u[:, None], measured, dt=DT, inputs={"torque": "Nm"}, outputs={"angle": "rad"})


@pytest.mark.parametrize(
    ("torque", "hum", "frequency", "name"),
    [
        (1.0, 0.0, 0.9, "periodic_disturbance"),
        (0.0, 0.1, 1.6, "periodic_sensor_error"),
        (0.0, 0.05, 9.7, "periodic_sensor_error"),
    ],
)
def test_a_hidden_sinusoid_is_named_by_its_place(torque, hum, frequency, name):
    train = recorded(0, torque, hum, frequency, 1.0)
    test = recorded(1, torque, hum, frequency, 2.9)
    found = pg.discover(swing(), train, test, network_epochs=0, quiet=True)
    assert found.verdict == "effect_found"
    assert [effect.name for effect in found.effects] == [name]
    numbers = found.effects[0].parameters
    assert numbers["amplitude"]["value"][0] == pytest.approx(torque + hum, rel=0.03)
    assert numbers["frequency"]["value"] == pytest.approx(frequency, rel=1e-3)
    assert found.gap["after"]["test"] < 1.15 * NOISE < 0.6 * found.gap["recalibrated"]["test"]


@pytest.mark.parametrize("hum", [10.0 * NOISE, 0.9 * NOISE])
def test_where_its_names_are_removed_it_is_told_as_a_line(hum):
    names = ["periodic_disturbance", "periodic_sensor_error"]
    train, test = (recorded(seed, 0.0, hum, 9.7, 2.0) for seed in (2, 3))
    found = pg.discover(swing(), train, test, without=names, network_epochs=0, quiet=True)
    assert found.verdict == "unknown_effect"
    assert "a periodic disturbance of angle every 0.103 s" in found.sentence
    assert found.gap["floor"] == pytest.approx(NOISE, rel=0.1)
