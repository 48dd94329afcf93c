"""Own data of several kinds through one call of `pg.fit`, which chooses the settings: many short records, missing
samples, several inputs and outputs, states that are not measured."""

import jax.numpy as jnp
import numpy as np
import pytest

import pgrssnn_jax as pg

FEW = {"seeds": 2, "epochs": 20, "validate_every": 5, "chunk_epochs": 5, "hidden": 3, "quiet": True}


def heater(loss=0.08, gain=0.5):
    """T' = -loss (T - 20) + gain u: one state that is measured."""
    return pg.continuous(
        "heater",
        lambda p, x, u: jnp.stack([-p["loss"] * (x[0] - 20.0) + p["gain"] * u[0]]),
        lambda p, x, u: x,
        {"loss": loss, "gain": gain},
        parameters={n: pg.Parameter(n, unit, bounds=(0.0, 10.0)) for n, unit in (("loss", "1/s"), ("gain", "K/s"))},
        states=(pg.Signal("temperature", "degC", like="temperature"),),
        inputs=(pg.Signal("power", "-"),),
        outputs=(pg.Signal("temperature", "degC"),),
        dt=1.0,
    )


def pendulum(damping=0.8):
    """angle'' = -9.81 sin(angle) - d angle' + torque: the rate is not measured."""
    return pg.continuous(
        "pendulum",
        lambda p, x, u: jnp.stack([x[1], -9.81 * jnp.sin(x[0]) - p["d"] * x[1] + u[0]]),
        lambda p, x, u: x[:1],
        {"d": damping},
        parameters={"d": pg.Parameter("d", "1/s", bounds=(0.0, 10.0))},
        states=(pg.Signal("angle", "rad", like="angle"), pg.Signal("rate", "rad/s", rate_of="angle")),
        inputs=(pg.Signal("torque", "Nm"),),
        outputs=(pg.Signal("angle", "rad"),),
        dt=0.05,
    )


def room(wall=0.05):
    """Two rooms that are measured and a wall that is not, two heaters in kW."""

    def derivative(p, x, u):
        left, right, middle = x
        flows = p["wall"] * jnp.stack([middle - left, middle - right, left + right - 2 * middle])
        return flows + 0.02 * jnp.stack([u[0] - left, u[1] - right, 0.0])

    temperatures = ("left", "right")
    return pg.continuous(
        "rooms",
        derivative,
        lambda p, x, u: x[:2],
        {"wall": wall},
        parameters={"wall": pg.Parameter("wall", "1/min", bounds=(0.0, 1.0))},
        states=(*(pg.Signal(n, "K", like=n) for n in temperatures), pg.Signal("wall", "K")),
        inputs=(pg.Signal("heat_left", "K"), pg.Signal("heat_right", "K")),
        outputs=tuple(pg.Signal(n, "K") for n in temperatures),
        dt=1.0,
    )


def driven(plant, x0, samples, seed, noise, size, missing=0.0):
    """Inputs in steps and noisy outputs, of which a part is missing."""
    rng, n_u = np.random.default_rng(seed), len(plant.inputs)
    u = np.repeat(rng.uniform(0.0, size, (samples // 10 + 1, n_u)), 10, axis=0)[:samples]
    y = pg.simulate(plant, u, np.asarray(x0, float)).y
    y = y + noise * rng.standard_normal(y.shape)
    return u, np.where(rng.random(y.shape) < missing, np.nan, y)


def recorded(physics, u, y, **more):
    named = ({s.name: s.unit for s in signals} for signals in (physics.inputs, physics.outputs))
    return pg.record(u, y, dt=physics.dt, inputs=next(named), outputs=next(named), **more)


def check(ensemble, test, worst):
    """Every member is finite and predicts, an interval stands beside it, and the choice is on record."""
    found = ensemble.evaluate(test).metrics
    assert found["summary"]["failed"] == 0
    assert max(found["members"][0]["test"]["nrmse"]) < worst
    assert len(found["interval"]["coverage"]) == len(ensemble.physics.outputs)
    assert min(found["interval"]["coverage"]) > 0.6
    assert any(one["settings"].startswith("the physics alone") for one in found["recipe"]["tried"])


@pytest.mark.compiles
def test_many_short_records_of_unequal_length_with_missing_samples():
    lengths = range(28, 40, 2)
    parts = [driven(heater(), [25.0 + k], n, k, 0.05, 6.0, 0.2) for k, n in enumerate(lengths)]
    record = recorded(heater(), [u for u, _ in parts], [y for _, y in parts])
    ensemble = pg.fit("pg_rssnn", heater(loss=0.1), record, **{**FEW, "epochs": 200, "seeds": 5})
    assert ensemble.settings.data.folds == 5  # of six records whole ones are left out
    u, y = driven(heater(), [27.0], 38, 77, 0.05, 6.0)
    check(ensemble, recorded(heater(), u, y), worst=0.8)


@pytest.mark.compiles
def test_several_inputs_and_outputs_and_a_state_that_is_not_measured():
    u, y = driven(room(), [18.0, 21.0, 19.0], 300, 1, 0.05, 40.0, 0.3)
    ensemble = pg.fit("pg_rssnn", room(wall=0.06), recorded(room(), u, y), **FEW)
    assert ensemble.settings.run.initial_state == "least_squares"
    again = recorded(room(), *driven(room(), [20.0, 17.0, 22.0], 200, 2, 0.05, 40.0))
    check(ensemble, again, worst=0.3)
    assert ensemble.simulate(again.u, np.array([20.0, 17.0, 22.0]), interval=0.9).low.shape == (1, 200, 2)


@pytest.mark.compiles
def test_one_record_of_an_own_physics_that_lacks_something():
    u, y = driven(pendulum(damping=1.6), [0.3, 0.0], 400, 3, 0.005, 3.0)
    ensemble = pg.fit("pg_rssnn", pendulum(), recorded(pendulum(), u, y), **{**FEW, "epochs": 200})
    test = recorded(pendulum(), *driven(pendulum(damping=1.6), [0.0, 0.5], 300, 4, 0.005, 3.0))
    check(ensemble, test, worst=0.5)
    alone = pg.fit("physics_only", pendulum(), recorded(pendulum(), u, y), recipe="default",
                   initial_state="least_squares", quiet=True)  # fmt: skip
    assert ensemble.score(test)["rmse"].mean() <= 1.02 * alone.score(test)["rmse"].mean()
