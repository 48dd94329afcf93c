"""The Python API gives the numbers of the commands, bit for bit: both take the same path."""

import json

import numpy as np
import pytest
from commands import called, command

import pgrssnn_jax as pg

SMOKE = {"epochs": 10, "chunk_epochs": 10, "optimisation": 0, "quiet": True}


@pytest.mark.parametrize(
    ("name", "run"),
    [
        pytest.param("physics_only", called, id="physics_only"),
        pytest.param("pg_rssnn", command, id="pg_rssnn", marks=pytest.mark.compiles),
    ],
)
def test_the_api_gives_the_numbers_of_the_command(name, run, tmp_path):
    arguments = ["+experiment=cascaded_tank", "data.generated=true", "budget=smoke", f"model={name}"]
    code, _, err = run(*arguments, f"hydra.run.dir={tmp_path / 'run'}", cwd=tmp_path)
    assert not code, err
    train, test = pg.load_benchmark("cascaded_tank", generated=True)
    found = pg.fit(name, pg.physics.cascaded_tanks(clamp=True), train, seeds=2, **SMOKE).evaluate(test)
    expected = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert [m["test"] for m in found.metrics["members"]] == [m["test"] for m in expected["members"]]
    assert [m["validation"] for m in found.metrics["members"]] == [m["validation"] for m in expected["members"]]
    with np.load(tmp_path / "run" / "predictions.npz") as arrays:
        np.testing.assert_array_equal(found.arrays["y_hat"], arrays["y_hat"])


@pytest.mark.compiles
def test_the_api_chooses_the_settings_of_the_command(tmp_path):
    arguments = ["+experiment=cascaded_tank", "data.generated=true", "budget=smoke", "recipe=auto", "data.n_train=200"]
    code, _, err = command(*arguments, f"hydra.run.dir={tmp_path / 'run'}", cwd=tmp_path)
    assert not code, err
    train, test = pg.load_benchmark("cascaded_tank", generated=True, n_train=200)
    tanks = pg.physics.cascaded_tanks(clamp=True)
    found = pg.fit("pg_rssnn", tanks, train, recipe="auto", seeds=2, **SMOKE).evaluate(test)
    expected = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert found.metrics["recipe"]["chosen"] == expected["recipe"]["chosen"]
    assert [m["test"] for m in found.metrics["members"]] == [m["test"] for m in expected["members"]]


@pytest.mark.compiles
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


@pytest.mark.compiles
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
    assert repr(pg.read_physics(tmp_path / "run")) == repr(found.physics)
