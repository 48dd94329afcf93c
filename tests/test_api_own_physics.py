"""A user's own physics, units and effects through the Python API."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import pgrssnn_jax as pg
from pgrssnn_jax.effects.stored import physics_to_json

QUICK = {"seeds": 2, "epochs": 2, "validate_every": 1, "chunk_epochs": 1, "hidden": 3, "quiet": True}
QUICK["recipe"] = "default"  # what is chosen is a matter of other tests
TRAINED = {**QUICK, "initial_state": "zero", "physics_parameters": "trained"}  # alone, which compiles quickly
CHEAP = {"draws": 99, "steps": 15, "starts": 1, "network_epochs": 0, "p_value": 0.02, "quiet": True}


def pendulum(length=1.0, damping=0.1, dt=0.05, stiffness=0.0):
    def derivative(p, x, u):
        angle, rate = x
        push = u[0] - stiffness * angle**3
        return jnp.stack([rate, -9.81 / p["l"] * jnp.sin(angle) - p["d"] * rate + push / p["l"] ** 2])

    return pg.continuous(
        "pendulum",
        derivative,
        lambda p, x, u: x[:1],
        {"l": length, "d": damping},
        parameters={
            "l": pg.Parameter("l", "m", bounds=(0.1, 10.0)),
            "d": pg.Parameter("d", "1/s", bounds=(0.0, 10.0)),
        },
        states=(pg.Signal("angle", "rad", like="angle"), pg.Signal("rate", "rad/s", rate_of="angle")),
        inputs=(pg.Signal("torque", "Nm"),),
        outputs=(pg.Signal("angle", "rad"),),
        dt=dt,
    )


def swing(physics, samples=400, seed=0, noise=0.003, torque=6.0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-torque, torque, (samples // 20 + 1, 1)), 20, axis=0)[:samples]
    y = pg.simulate(physics, u, np.zeros(2)).y
    return u, y + noise * rng.standard_normal(y.shape)


@pytest.fixture(scope="module")
def swung():
    """Inputs and outputs."""
    return swing(pendulum())


@pytest.fixture(scope="module")
def record(swung):
    return pg.record(*swung, dt=0.05, inputs={"torque": "Nm"}, outputs={"angle": "rad"}, start="rest")


@pytest.fixture(scope="module")
def fitted(record):
    return pg.fit("physics_only", pendulum(length=1.1), record, **TRAINED)


def test_an_own_physics_trains_saves_and_is_given_again(tmp_path, swung, record, fitted):
    u, _ = swung
    assert np.isfinite(fitted.score(record)["rmse"]).all()
    fitted.save(tmp_path / "run")
    with pytest.raises(ValueError, match="physics of one's own"):
        pg.load(tmp_path / "run")
    found = pg.load(tmp_path / "run", physics=pendulum(length=1.1))
    np.testing.assert_array_equal(found.simulate(u), fitted.simulate(u))
    with pytest.raises(ValueError, match="physics"):
        pg.load(tmp_path / "run", physics=pg.physics.cascaded_tanks())


@pytest.mark.parametrize("name", ["discovery.json", "physics.json"])
def test_a_physics_is_read_back_with_its_numbers_and_effects(tmp_path, name):
    known = pg.add(pendulum(damping=0.3), "quadratic_drag", c=0.2)
    file = tmp_path / name
    file.write_text(json.dumps(physics_to_json(known)))
    u, y = swing(known, noise=0.0)
    for place in (tmp_path, file, str(file)):
        again = pg.read_physics(place, pendulum())
        np.testing.assert_array_equal(pg.simulate(again, u, np.zeros(2)).y, y)
        assert repr(again) == repr(known)


def test_a_physics_of_the_library_is_read_back_alone(tmp_path):
    tanks = pg.add(pg.physics.cascaded_tanks(k1=0.05), "leak_tank1", rate=1e-3)
    (tmp_path / "physics.json").write_text(json.dumps(physics_to_json(tanks)))
    assert repr(pg.read_physics(tmp_path)) == repr(tanks)


def test_an_arm_is_read_back_with_the_builders_settings_of_training(tmp_path):
    """A discovery differentiates forwards through the whole gradient; training does not."""
    stored = physics_to_json(pg.physics.arm(derivatives="forward", physics_gradient="full"))
    (tmp_path / "discovery.json").write_text(json.dumps(stored))
    found, usual = pg.read_physics(tmp_path).settings, pg.physics.arm().settings
    for name in ("derivatives", "physics_gradient", "backend"):
        assert found[name] == usual[name], name


def test_what_is_no_stored_physics_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"path: expected a discovery.json, found '.*discovery.json'"):
        pg.read_physics(tmp_path)
    (tmp_path / "physics.json").write_text(json.dumps(physics_to_json(pendulum())))
    with pytest.raises(ValueError, match="expected the physics of one's own"):
        pg.read_physics(tmp_path)
    with pytest.raises(ValueError, match="states: expected"):
        pg.read_physics(tmp_path, pg.physics.cascaded_tanks())


def test_units_are_converted_or_refused(swung, fitted):
    u, y = swung
    other = pg.record(1e3 * u, np.rad2deg(y), dt=0.05, inputs={"torque": "mNm"}, outputs={"angle": "deg"}, start="rest")
    again = pg.fit("physics_only", pendulum(length=1.1), other, **TRAINED)
    np.testing.assert_allclose(again.losses.train, fitted.losses.train, rtol=1e-4)
    wrong = pg.record(u, y, dt=0.05, inputs={"torque": "V"}, outputs={"angle": "rad"})
    with pytest.raises(ValueError, match="torque: expected a unit that converts to Nm, found V"):
        pg.fit("pg_rssnn", pendulum(), wrong, **QUICK)
    slow = pg.record(u, y, dt=0.5, inputs={"torque": "Nm"}, outputs={"angle": "rad"})
    with pytest.raises(ValueError, match=r"dt: expected 0.05 s"):
        pg.fit("pg_rssnn", pendulum(), slow, **QUICK)


@pytest.mark.slow
def test_discovery_finds_a_hidden_effect_of_the_users_own(tmp_path):
    spring = pg.Effect(
        "twisted_wire",
        {"k": pg.Parameter("k", "Nm/rad^3", bounds=(0.0, 50.0), neutral=0.0)},
        lambda inner: pg.effects.after_step(
            inner, "twisted_wire", lambda n, own, x, u, new: new.at[1].add(-0.05 * n["k"] * new[0] ** 3)
        ),
        title="Twisted wire",
        initial_guesses=lambda span: [{"k": np.asarray(1.0)}, {"k": np.asarray(4.0)}],
    )
    truth = pg.add(pendulum(), spring, k=4.0)
    records = []
    for seed in (0, 1):
        u, y = swing(truth, samples=600, seed=seed, torque=3.0)
        records.append(pg.record(u, y, dt=0.05, inputs={"torque": "Nm"}, outputs={"angle": "rad"}, start="rest"))
    others = [effect.name for effect in pg.effects.catalogue(pendulum()) if effect.name != "input_gain"]
    found = pg.discover(pendulum(), *records, effects=[spring], without=others, **CHEAP)
    assert [effect.name for effect in found.effects] == ["twisted_wire"]
    number = found.effects[0].parameters["k"]
    assert number["value"] == pytest.approx(4.0, rel=0.05)
    assert number["interval"][0] < number["value"] < number["interval"][1]
    assert found.gap["after"]["test"] < 0.2 * found.gap["recalibrated"]["test"]
    y = pg.simulate(found.physics, records[1].u, np.zeros(2)).y
    assert np.sqrt(np.mean((y - records[1].y) ** 2)) == pytest.approx(found.gap["after"]["test"], rel=0.2)
    found.save(tmp_path / "found")
    assert json.loads((tmp_path / "found" / "discovery.json").read_text())["verdict"] == found.verdict
    again = pg.read_physics(tmp_path / "found", pendulum(), effects=[spring])
    np.testing.assert_array_equal(pg.simulate(again, records[1].u, np.zeros(2)).y, y)
    better = pg.fit("pg_rssnn", found.physics, records[0], **QUICK)
    assert better.settings.model.start_from_physics
    assert "twisted_wire" in repr(better.physics.params)
    assert "twisted_wire" in found._repr_html_()
