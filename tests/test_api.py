"""The Python API as users call it: three lines from data to scores, results that save and load, and its refusals."""

import json
import shutil
import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest
from toys import quick_jit

import pgrssnn_jax as pg

QUICK = {"seeds": 2, "epochs": 2, "validate_every": 1, "chunk_epochs": 1, "hidden": 3, "quiet": True}


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


@pytest.fixture(scope="module")
def saved(ensemble, benchmark, tmp_path_factory):
    """The folder of the ensemble, scored on the test record; for copies."""
    folder = tmp_path_factory.mktemp("saved") / "run"
    ensemble.save(folder, benchmark[1])
    return folder


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
    settings = pg.fit("physics_only", tanks, train, **{**QUICK, "epochs": 0}).settings
    assert (settings.fit.patience, settings.run.initial_state, settings.fit.epochs) == (500, "first_output", 0)
    settings = pg.fit("physics_only", tanks, train, recipe="default", **{**QUICK, "epochs": 0}).settings
    assert settings.fit.patience == 100
    spec = pg.ModelSpec(hidden=2, recurrent=False, feedback=True, networks=False)
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


def test_an_interval_surrounds_the_mean_and_is_kept_in_the_folder(ensemble, benchmark, saved, tmp_path):
    test = benchmark[1]
    narrow, wide = (ensemble.simulate(test.u, interval=level) for level in (0.5, 0.9))
    np.testing.assert_array_equal(wide.y, ensemble.simulate(test.u))
    np.testing.assert_allclose(wide.mean, wide.y.astype(float).mean(0))
    assert (wide.low < narrow.low).all()
    assert (narrow.high < wide.high).all()
    one = ensemble.simulate(test.u[0], interval=0.9)
    assert one.y.shape == (2, 150, 1)
    np.testing.assert_array_equal(one.low, wide.low[0])
    interval = ensemble.evaluate(test).metrics["interval"]
    inside = (test.y >= wide.low) & (test.y <= wide.high)
    assert interval["coverage"] == pytest.approx([inside.mean()], abs=0.02)
    assert interval["width"] == pytest.approx([(wide.high - wide.low).mean()], rel=1e-4)
    shutil.copytree(saved, tmp_path / "run")
    again = pg.load(tmp_path / "run").simulate(test.u, interval=0.9)
    np.testing.assert_allclose(again.high, wide.high, rtol=1e-6)
    file = tmp_path / "run" / "intervals.npz"
    with np.load(file) as stored:
        kept = dict(stored)
    np.savez(file, **{name: array for name, array in kept.items() if name not in ("mean", "covariance")})
    earlier = pg.load(tmp_path / "run").simulate(test.u, interval=0.9)  # runs of versions without these
    assert (earlier.high <= wide.high).all()
    file.unlink()
    with pytest.raises(ValueError, match="interval: expected a run that left samples out"):
        pg.load(tmp_path / "run").simulate(test.u, interval=0.9)
    np.savez(file, weights=np.zeros(3))
    with pytest.raises(ValueError, match="intervals.npz: expected arrays of shapes"):
        pg.load(tmp_path / "run")


def test_one_member_is_a_rollout_of_its_numbers(ensemble, benchmark):
    u, x0 = benchmark[1].u.astype(np.float32), np.array([[4.0, 5.0]], np.float32)
    alone = quick_jit(partial(pg.rollout, ensemble.model))(ensemble.params(1), u, x0)
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
    fitted = pg.fit("physics_only", tanks, unknown, recipe="default", **QUICK)
    assert not fitted.settings.data.folds
    with pytest.raises(ValueError, match=r"x0: expected an initial state of 2 numbers.*initial_state\(record\)"):
        fitted.simulate(train.u)
    assert fitted.simulate(train.u[0], np.array([3.0, 3.0])).shape == (1, 200, 1)


def test_the_start_of_a_record_is_the_one_from_which_it_is_tested(ensemble, benchmark):
    """Here each member has the start that its training found; other members have others."""
    test = benchmark[1]
    x0 = ensemble.initial_state(test)
    assert x0.shape == (2, 1, 2)
    expected = ensemble.evaluate(test).arrays["y_hat"]
    np.testing.assert_allclose(ensemble.simulate(test.u, x0), expected, rtol=1e-5, atol=1e-5)
    with pytest.raises(ValueError, match=r"x0: expected shape .* or \(2, 1, 2\), found \(3, 1, 2\)"):
        ensemble.simulate(test.u, np.zeros((3, 1, 2)))


def test_a_start_is_estimated_from_the_first_samples_of_a_record(tanks, benchmark):
    """Of the physics alone, whose own start is known."""
    x0, u = np.array([4.0, 6.0]), benchmark[0].u[0]
    y = pg.simulate(tanks, u, x0).y
    known = {"dt": 4.0, "inputs": {"pump_voltage": "V"}, "outputs": {"level_voltage": "V"}}
    record = pg.record(u, y, **known)
    fitted = pg.fit("physics_only", tanks, record, recipe="default", initial_state="estimated", n_init=40, **QUICK)
    np.testing.assert_allclose(fitted.initial_state(record)[0, 0], x0, atol=0.05)


def test_a_callback_sees_progress_and_may_stop(tanks, benchmark):
    seen = []
    fitted = pg.fit(
        "physics_only",
        tanks,
        benchmark[0],
        **{**QUICK, "epochs": 50, "physics_parameters": "trained"},
        callback=lambda now: seen.append(now.epoch) or len(seen) == 3,
    )
    assert seen == [1, 2, 3]
    assert fitted.losses.epochs == 3


def test_what_is_saved_is_whole_and_loads_to_the_same_numbers(ensemble, benchmark, saved, tmp_path):
    test = benchmark[1]
    shutil.copytree(saved, tmp_path / "run")
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
    fitted = pg.fit("physics_only", tanks, benchmark[0], **QUICK)
    fitted.save(tmp_path / "run")
    assert not (tmp_path / "run" / "metrics.json").exists()
    np.testing.assert_array_equal(pg.load(tmp_path / "run").simulate(benchmark[1].u), fitted.simulate(benchmark[1].u))


def test_effects_go_into_the_run_folder_with_their_numbers(tanks, benchmark, tmp_path):
    leaky = pg.add(pg.add(tanks, "pump_saturation", voltage=4.0), "leak_tank1", rate=0.002)
    fitted = pg.fit("physics_only", leaky, benchmark[0], **QUICK)
    fitted.save(tmp_path / "run")
    found = pg.load(tmp_path / "run")
    assert list(json.loads((tmp_path / "run" / "physics.json").read_text())["numbers"]["effects"]) == [
        "pump_saturation",
        "leak_tank1",
    ]
    assert jax.tree.all(jax.tree.map(np.array_equal, found.physics.params, leaky.params))
    np.testing.assert_array_equal(found.simulate(benchmark[1].u), fitted.simulate(benchmark[1].u))


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
        ({"recipe": "best"}, "recipe: expected 'auto', 'experiment', 'default' or None"),
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
        pg.fit("physics_only", tanks, benchmark[0], guard="rollback", **{**QUICK, "epochs": 0})
