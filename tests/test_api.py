"""The Python API as users call it: three lines from data to scores, results that save and load, and its refusals."""

import json
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import command

import pgrssnn_jax as pg

QUICK = {"seeds": 2, "epochs": 2, "validate_every": 1, "chunk_epochs": 1, "hidden": 3, "quiet": True}
CHEAP = {"draws": 99, "steps": 4, "starts": 1, "network_epochs": 0, "p_value": 0.02, "quiet": True}
SMOKE = {"epochs": 10, "chunk_epochs": 10, "optimisation": 0, "quiet": True}


@pytest.fixture(scope="module")
def tanks():
    return pg.physics.cascaded_tanks(clamp=True)


@pytest.fixture(scope="module")
def benchmark():
    train, test = pg.load_benchmark("cascaded_tank", generated=True, n_train=200, n_validation=60)
    return train, test._replace(u=test.u[:, :150], y=test.y[:, :150], mask=test.mask[:, :150])


@pytest.fixture(scope="module")
def ensemble(tanks, benchmark):
    return pg.fit("pg_rssnn", tanks, benchmark[0], **QUICK)


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


def test_importing_the_package_loads_nothing_and_lists_its_names():
    code = "import sys, pgrssnn_jax as pg; assert 'jax' not in sys.modules; print(*dir(pg)); pg.physics.cascaded_tanks"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"fit", "discover", "load", "physics", "effects", "Record"} <= set(done.stdout.split())
    with pytest.raises(AttributeError, match="fitt"):
        pg.fitt  # noqa: B018


def test_a_flag_that_comes_too_late_is_said():
    code = (
        "import jax; jax.devices(); import warnings; warnings.simplefilter('error')\n"
        "from importlib import metadata\n"
        "needed = metadata.version('jaxlib') == '0.10.2'\n"
        "try:\n    import pgrssnn_jax\nexcept UserWarning as said:\n    assert 'already running' in str(said)\n"
        "else:\n    assert not needed\n"
    )
    flags = {"PATH": "", "XLA_FLAGS": ""}
    subprocess.run([sys.executable, "-c", code], env=flags, cwd=Path(pg.__file__).parent.parent, check=True)


def test_three_lines_train_score_and_show_themselves(ensemble, benchmark):
    scores = ensemble.score(benchmark[1])
    assert list(scores["seed"]) == [0, 1]
    assert {"status", "rmse", "nrmse", "fit_percent", "cc"} <= set(scores.columns)
    assert np.isfinite(scores["rmse"]).all()
    assert "2 finished" in repr(ensemble)
    assert "<table" in ensemble._repr_html_()
    assert ensemble.plot(benchmark[1]).axes


def test_the_benchmark_brings_its_recipe_and_settings_by_keyword_win(tanks, benchmark):
    train = benchmark[0]
    assert train.validation.u.shape == (1, 60, 1)
    settings = pg.fit("pg_rssnn", tanks, train, **{**QUICK, "epochs": 0}).settings
    assert (settings.fit.patience, settings.run.initial_state, settings.fit.epochs) == (500, "first_output", 0)
    settings = pg.fit("pg_rssnn", tanks, train, recipe="default", **{**QUICK, "epochs": 0}).settings
    assert settings.fit.patience == 100
    spec = pg.ModelSpec(hidden=2, recurrent=False, feedback=True)
    fitted = pg.fit(spec, tanks, train, seeds=1, epochs=0, quiet=True, learning_rate=0.01, seed=7)
    assert fitted.model.spec == spec
    assert fitted.trained.members[0].seed == 7


def test_an_ensemble_simulates_what_it_was_scored_on(ensemble, benchmark):
    test = benchmark[1]
    y = ensemble.simulate(test.u)
    assert y.shape == (2, 1, 150, 1)
    np.testing.assert_array_equal(ensemble.simulate(test.u[0]), y[:, 0])
    np.testing.assert_allclose(y, ensemble.evaluate(test).arrays["y_hat"], rtol=1e-5, atol=1e-5)
    start = np.array([4.0, 5.0])
    np.testing.assert_array_equal(ensemble.simulate(test.u[0], start), ensemble.simulate(test.u[0], start[None]))


def test_one_member_is_a_rollout_of_its_numbers(ensemble, benchmark):
    u, x0 = benchmark[1].u.astype(np.float32), np.array([[4.0, 5.0]], np.float32)
    alone = pg.rollout(ensemble.model, ensemble.params(1), u, x0)
    np.testing.assert_allclose(alone.y, ensemble.simulate(u, x0)[1], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("u", "x0", "said"),
    [
        (np.zeros((5, 2)), None, r"u: expected \[time, 1\]"),
        (np.full((5, 1), np.nan), None, "expected finite numbers"),
        (np.zeros((5, 1)), np.zeros(3), r"x0: expected shape \(2,\)"),
    ],
)
def test_simulate_says_what_does_not_fit(ensemble, u, x0, said):
    with pytest.raises(ValueError, match=said):
        ensemble.simulate(u, x0)


def test_a_start_that_training_did_not_know_must_be_given(tanks, benchmark):
    train = benchmark[0]
    unknown = pg.record(train.u, train.y, dt=4.0, inputs={"pump_voltage": "V"}, outputs={"level_voltage": "V"})
    fitted = pg.fit("pg_rssnn", tanks, unknown, **QUICK)
    assert not fitted.settings.data.folds
    with pytest.raises(ValueError, match="x0: expected an initial state of 2 numbers"):
        fitted.simulate(train.u)
    assert fitted.simulate(train.u[0], np.array([3.0, 3.0])).shape == (2, 200, 1)


def test_a_callback_sees_progress_and_may_stop(tanks, benchmark):
    seen = []
    fitted = pg.fit(
        "pg_rssnn",
        tanks,
        benchmark[0],
        **{**QUICK, "epochs": 50},
        callback=lambda now: seen.append(now.epoch) or len(seen) == 3,
    )
    assert seen == [1, 2, 3]
    assert fitted.losses.epochs == 3


def test_what_is_saved_is_whole_and_loads_to_the_same_numbers(ensemble, benchmark, tmp_path):
    test = benchmark[1]
    ensemble.save(tmp_path / "run", test)
    found = pg.load(tmp_path / "run")
    np.testing.assert_array_equal(found.simulate(test.u), ensemble.simulate(test.u))
    np.testing.assert_allclose(found.score(test)["rmse"], ensemble.score(test)["rmse"], rtol=1e-6)
    assert {"DONE", "config.yaml", "physics.json", "metrics.json", "report.html"} <= {
        p.name for p in (tmp_path / "run").iterdir()
    }
    (tmp_path / "run" / "DONE").unlink()
    with pytest.raises(ValueError, match="expected a finished run"):
        pg.load(tmp_path / "run")
    assert pg.load(tmp_path / "run", partial=True).trained.members == ensemble.trained.members


def test_a_run_without_a_test_record_is_saved_too(tanks, benchmark, tmp_path):
    fitted = pg.fit("pg_rssnn", tanks, benchmark[0], **QUICK)
    fitted.save(tmp_path / "run")
    assert not (tmp_path / "run" / "metrics.json").exists()
    np.testing.assert_array_equal(pg.load(tmp_path / "run").simulate(benchmark[1].u), fitted.simulate(benchmark[1].u))


def test_effects_go_into_the_run_folder_with_their_numbers(tanks, benchmark, tmp_path):
    leaky = pg.add(pg.add(tanks, "pump_saturation", voltage=4.0), "leak_tank1", rate=0.002)
    fitted = pg.fit("pg_rssnn", leaky, benchmark[0], **QUICK)
    fitted.save(tmp_path / "run")
    found = pg.load(tmp_path / "run")
    assert list(json.loads((tmp_path / "run" / "physics.json").read_text())["numbers"]["effects"]) == [
        "pump_saturation",
        "leak_tank1",
    ]
    assert jax.tree.all(jax.tree.map(np.array_equal, found.physics.params, leaky.params))
    np.testing.assert_array_equal(found.simulate(benchmark[1].u), fitted.simulate(benchmark[1].u))


def test_an_own_physics_trains_saves_and_is_given_again(tmp_path):
    u, y = swing(pendulum())
    record = pg.record(u, y, dt=0.05, inputs={"torque": "Nm"}, outputs={"angle": "rad"}, start="rest")
    fitted = pg.fit("pg_rssnn", pendulum(length=1.1), record, initial_state="zero", **QUICK)
    assert np.isfinite(fitted.score(record)["rmse"]).all()
    fitted.save(tmp_path / "run")
    with pytest.raises(ValueError, match="physics of one's own"):
        pg.load(tmp_path / "run")
    found = pg.load(tmp_path / "run", physics=pendulum(length=1.1))
    np.testing.assert_array_equal(found.simulate(u), fitted.simulate(u))
    with pytest.raises(ValueError, match="physics"):
        pg.load(tmp_path / "run", physics=pg.physics.cascaded_tanks())


def test_units_are_converted_or_refused():
    u, y = swing(pendulum())
    plain = pg.record(u, y, dt=0.05, inputs={"torque": "Nm"}, outputs={"angle": "rad"}, start="rest")
    other = pg.record(1e3 * u, np.rad2deg(y), dt=0.05, inputs={"torque": "mNm"}, outputs={"angle": "deg"}, start="rest")
    settings = {**QUICK, "initial_state": "zero"}
    one, two = (pg.fit("pg_rssnn", pendulum(), record, **settings) for record in (plain, other))
    np.testing.assert_allclose(one.losses.train, two.losses.train, rtol=1e-4)
    wrong = pg.record(u, y, dt=0.05, inputs={"torque": "V"}, outputs={"angle": "rad"})
    with pytest.raises(ValueError, match="torque: expected a unit that converts to Nm, found V"):
        pg.fit("pg_rssnn", pendulum(), wrong, **QUICK)
    slow = pg.record(u, y, dt=0.5, inputs={"torque": "Nm"}, outputs={"angle": "rad"})
    with pytest.raises(ValueError, match=r"dt: expected 0.05 s"):
        pg.fit("pg_rssnn", pendulum(), slow, **QUICK)


def test_a_csv_file_becomes_a_record_of_the_physics(tanks, tmp_path):
    (tmp_path / "A.csv").write_text("time,pump_voltage,level_voltage\n0,3.2,5.2\n4,3.1,5.1\n8,3.0,5.0\n")
    record = pg.read_csv(tmp_path / "A.csv", tanks, start="rest")
    assert (record.u.shape, record.info.start, record.info.outputs[0].unit) == ((1, 3, 1), "rest", "V")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"model": "pg_rsnn"}, "model: expected one of"),
        ({"epoch": 3}, "settings: expected some of .*found 'epoch'"),
        ({"epochs": -1}, "fit: epochs: expected 0 or more"),
        ({"epochs": "many"}, "fit.epochs: expected int, found 'many'"),
        ({"initial_state": "warm"}, "initial_state: expected zero"),
        ({"recipe": "best"}, "recipe: expected 'experiment', 'default' or None"),
        ({"seeds": 0}, "n_seeds: expected 1 to"),
    ],
)
def test_settings_that_cannot_be_are_answered_in_one_sentence(tanks, benchmark, arguments, said):
    with pytest.raises(ValueError, match=said):
        pg.fit(arguments.pop("model", "pg_rssnn"), tanks, benchmark[0], quiet=True, **arguments)


def test_an_effect_that_a_physics_cannot_take_is_refused_by_name(tanks):
    with pytest.raises(ValueError, match="payload"):
        pg.add(tanks, "payload", mass=3.0)
    assert "leak_tank1" in [effect.name for effect in pg.effects.catalogue(tanks)]


@pytest.mark.slow
def test_discovery_finds_a_hidden_effect_of_the_users_own(tmp_path):
    spring = pg.Effect(
        "cubic_spring",
        {"k": pg.Parameter("k", "Nm/rad^3", bounds=(0.0, 50.0), neutral=0.0)},
        lambda inner: pg.effects.after_step(
            inner, "cubic_spring", lambda n, own, x, u, new: new.at[1].add(-0.05 * n["k"] * new[0] ** 3)
        ),
        title="Cubic spring",
        initial_guesses=lambda span: [{"k": np.asarray(1.0)}, {"k": np.asarray(4.0)}],
    )
    truth = pg.add(pendulum(), spring, k=4.0)
    records = []
    for seed in (0, 1):
        u, y = swing(truth, samples=600, seed=seed, torque=3.0)
        records.append(pg.record(u, y, dt=0.05, inputs={"torque": "Nm"}, outputs={"angle": "rad"}, start="rest"))
    others = [effect.name for effect in pg.effects.catalogue(pendulum()) if effect.name != "input_gain"]
    found = pg.discover(pendulum(), *records, effects=[spring], without=others, **{**CHEAP, "steps": 15})
    assert [effect.name for effect in found.effects] == ["cubic_spring"]
    number = found.effects[0].parameters["k"]
    assert number["value"] == pytest.approx(4.0, rel=0.05)
    assert number["interval"][0] < number["value"] < number["interval"][1]
    assert found.gap["after"]["test"] < 0.2 * found.gap["recalibrated"]["test"]
    y = pg.simulate(found.physics, records[1].u, np.zeros(2)).y
    assert np.sqrt(np.mean((y - records[1].y) ** 2)) == pytest.approx(found.gap["after"]["test"], rel=0.2)
    found.save(tmp_path / "found")
    assert json.loads((tmp_path / "found" / "discovery.json").read_text())["verdict"] == found.verdict
    better = pg.fit("pg_rssnn", found.physics, records[0], **QUICK)
    assert better.settings.model.start_from_physics
    assert "cubic_spring" in repr(better.physics.params)
    assert "cubic_spring" in found._repr_html_()


@pytest.mark.parametrize("name", ["pg_rssnn", "physics_only"])
def test_the_api_gives_the_numbers_of_the_command(name, tmp_path):
    """Bit for bit: both take the same path."""
    arguments = ["+experiment=cascaded_tank", "data.generated=true", "budget=smoke", f"model={name}"]
    code, _, err = command(*arguments, f"hydra.run.dir={tmp_path / 'run'}", cwd=tmp_path)
    assert not code, err
    train, test = pg.load_benchmark("cascaded_tank", generated=True)
    found = pg.fit(name, pg.physics.cascaded_tanks(clamp=True), train, seeds=2, **SMOKE).evaluate(test)
    expected = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert [m["test"] for m in found.metrics["members"]] == [m["test"] for m in expected["members"]]
    assert [m["validation"] for m in found.metrics["members"]] == [m["validation"] for m in expected["members"]]
    with np.load(tmp_path / "run" / "predictions.npz") as arrays:
        np.testing.assert_array_equal(found.arrays["y_hat"], arrays["y_hat"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "build", "more"),
    [
        ("lgssm", lambda: pg.physics.lgssm(), {"realisations": 2}),
        ("robot_real", lambda: pg.physics.arm(), {}),
        (
            "robot_simulated",
            lambda: pg.physics.arm(velocity_disturbance=[-0.05, 0.1, -0.2, 0.05, 0.1, -0.1]),
            {"realisations": 2},
        ),
    ],
)
def test_the_api_gives_the_numbers_of_the_command_on_every_benchmark(name, build, more, tmp_path):
    arguments = [f"+experiment={name}", "data.generated=true", "budget=smoke", f"hydra.run.dir={tmp_path / 'run'}"]
    code, _, err = command(*arguments, cwd=tmp_path)
    assert not code, err
    less = {} if name == "lgssm" else {"n_train": 4, "n_validation": 1, "n_test": 1, "n_samples": 60}
    train, test = pg.load_benchmark(name, generated=True, **more, **less)
    found = pg.fit("pg_rssnn", build(), train, seeds=None if more else 2, **SMOKE).evaluate(test)
    with np.load(tmp_path / "run" / "predictions.npz") as arrays:
        np.testing.assert_array_equal(found.arrays["y_hat"], arrays["y_hat"])


@pytest.mark.slow
def test_discover_gives_the_numbers_of_the_command(tmp_path):
    cheap = {"steps": 4, "draws": 99, "starts": 1, "most": 1, "p_value": 0.02, "network_epochs": 2}
    arguments = [f"discovery.{name}={value}" for name, value in cheap.items()]
    code, _, err = command(
        "+experiment=cascaded_tank", "data.generated=true", *arguments, f"hydra.run.dir={tmp_path / 'run'}",
        cwd=tmp_path, script="discover.py",
    )  # fmt: skip
    assert not code, err
    expected = json.loads((tmp_path / "run" / "discovery.json").read_text())
    train, test = pg.load_benchmark("cascaded_tank", generated=True)
    found = pg.discover(pg.physics.cascaded_tanks(clamp=True), train, test, quiet=True, **cheap)
    found.save(tmp_path / "same")
    same = json.loads((tmp_path / "same" / "discovery.json").read_text())
    assert {key: same[key] for key in ("verdict", "numbers", "gap", "network", "parameters")} == {
        key: expected[key] for key in ("verdict", "numbers", "gap", "network", "parameters")
    }


def test_old_spellings_are_taken_with_one_warning(tanks, benchmark):
    with pytest.warns(FutureWarning, match="output_timing") as said:
        old = pg.continuous(
            "one",
            lambda p, x, u: u - x,
            lambda p, x, u: x,
            {},
            states=(pg.Signal("x"),),
            inputs=(pg.Signal("u"),),
            outputs=(pg.Signal("y"),),
            dt=1.0,
            reads="before_step",
        )
    assert len(said) == 1
    assert old.output_timing == "before_step"
    with pytest.warns(FutureWarning, match=r"pgrssnn_jax\.load"):
        from pgrssnn_jax.finished import load_run
    assert load_run is pg.load
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pg.fit("pg_rssnn", tanks, benchmark[0], guard="rollback", **{**QUICK, "epochs": 0})
