"""python train.py, as a user types it: what it leaves, how it stops, how it goes on."""

import json
import shutil
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import QUICK, called, command, composed, start, trained, without_pictures, write_benchmark

from pgrssnn_jax.cli.resume import resume_config
from pgrssnn_jax.results.saved import load
from pgrssnn_jax.training.run_folder import RunFolder, read_config

FILES = {
    "config.yaml", "environment.json", "history.csv", "metrics.json", "predictions.npz", "intervals.npz",
    "physics.json", "checkpoint", "figures", "report.html", "DONE",
}  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def no_pictures() -> Iterator[None]:
    """Those of runs in this process; a command of its own draws them."""
    with without_pictures():
        yield


def quick(benchmark: Path, *more: str) -> list[str]:
    return ["+experiment=cascaded_tank", f"data.path={benchmark}", "data.n_validation=40", *QUICK, *more]


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> tuple[Path, str]:
    """A folder with a benchmark and a run on it, and what the command said. Nobody may change them."""
    folder = tmp_path_factory.mktemp("finished")
    benchmark = write_benchmark(folder / "tanks.csv", samples=160)
    code, out, err = command(*quick(benchmark), "hydra.run.dir=run", cwd=folder)
    assert code == 0, err
    return folder, out


def test_a_run_leaves_the_folder_of_the_contract(finished):
    folder, out = finished
    run = folder / "run"
    assert {path.name for path in run.iterdir()} == FILES
    assert {path.name for path in (run / "figures").iterdir()} >= {"prediction.png", "training.png", "members.png"}
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["schema"] == 1
    assert (metrics["system"], metrics["model"], metrics["source"], metrics["n_init"]) == (
        "tanks",
        "pg_rssnn",
        "file",
        0,
    )
    assert [(m["seed"], m["dataset"], m["status"]) for m in metrics["members"]] == [(0, 0, "ok"), (1, 0, "ok")]
    assert set(metrics["members"][0]["test"]) == {"rmse", "nrmse", "fit_percent", "cc"}
    assert {"planned": 2, "finished": 2, "failed": 0}.items() <= metrics["summary"].items()
    assert set(metrics["summary"]["by_n_init"]) == {"0", "5", "50"}
    with np.load(run / "predictions.npz") as arrays:
        y, y_hat, mean = arrays["y"], arrays["y_hat"], arrays["ensemble_mean"]
    again = np.sqrt(((y - y_hat) ** 2).mean((1, 2, 3)))
    assert [m["test"]["rmse"][0] for m in metrics["members"]] == pytest.approx(again, rel=1e-4)
    assert metrics["summary"]["rmse_mean"] == pytest.approx(again.mean(), rel=1e-4)
    assert metrics["summary"]["rmse_ensemble"] == pytest.approx(np.sqrt(((y - mean) ** 2).mean()), rel=1e-4)
    history = pd.read_csv(run / "history.csv")
    assert list(history) == ["epoch", "seed", "dataset", "train_loss", "validation_loss"]
    assert len(history) == 4
    environment = json.loads((run / "environment.json").read_text())
    assert environment["command"].startswith("python train.py +experiment=cascaded_tank")
    assert f"{metrics['summary']['rmse_mean']:.3f}"[:4] in out


@pytest.mark.slow
def test_an_interrupted_run_is_whole_and_resumes_to_the_same_numbers(tmp_path, benchmark):
    """Ctrl-C after the first chunks; the resumed run ends like one that nobody stopped, bit for bit."""
    long = [
        "+experiment=cascaded_tank", f"data.path={benchmark}", "n_seeds=2",
        "data.n_validation=40", "fit.epochs=2000", "fit.patience=2000",
    ]  # fmt: skip
    process = start(*long, "hydra.run.dir=stopped", cwd=tmp_path)
    assert process.stdout is not None
    while "epoch" not in (line := process.stdout.readline()):
        assert line, process.communicate()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "continue with: python train.py resume=stopped" in err
    assert not (tmp_path / "stopped" / "DONE").exists()
    stopped_at = pd.read_csv(tmp_path / "stopped" / "history.csv")["epoch"].max()
    assert 0 < stopped_at < 2000
    code, _, err = command("resume=stopped", cwd=tmp_path)
    assert code == 0, err
    code, _, err = command(*long, "hydra.run.dir=whole", cwd=tmp_path)
    assert code == 0, err
    for name in ("history.csv",):
        assert (tmp_path / "stopped" / name).read_text() == (tmp_path / "whole" / name).read_text()
    resumed, whole = (json.loads((tmp_path / f / "metrics.json").read_text()) for f in ("stopped", "whole"))
    assert resumed["members"] == whole["members"]
    assert resumed["summary"] == whole["summary"]
    assert (tmp_path / "stopped" / "DONE").exists()
    assert (
        sorted(path.name for path in tmp_path.iterdir()) == ["runs", "stopped", "tanks.csv", "whole"]
        or not (tmp_path / "runs").exists()
    )


@pytest.mark.slow
def test_a_second_process_in_a_folder_is_told_who_is_at_work_there(tmp_path, benchmark):
    """The first one goes on as if nothing had happened."""
    busy = quick(benchmark, "fit.epochs=1000000", "fit.patience=1000000", "hydra.run.dir=run")
    process = start(*busy, cwd=tmp_path)
    try:
        assert process.stdout is not None
        while "epoch" not in (line := process.stdout.readline()):
            assert line, process.communicate()
        before = (tmp_path / "run/environment.json").read_bytes()
        for again in (busy, ["resume=run"]):
            code, out, err = called(*again, cwd=tmp_path)
            assert (code, out) == (2, "")
            who = f"found process {process.pid} on {socket.gethostname()} at work there"
            assert err.startswith("error: ")
            assert err.endswith(f"run: expected a run folder in which nobody writes, {who}\n")
            assert err.count("\n") == 1
            assert process.poll() is None
        assert (tmp_path / "run/environment.json").read_bytes() == before
    finally:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert not list(tmp_path.glob(".*.lock"))


def test_a_sweep_leaves_a_folder_per_job(tmp_path, benchmark):
    arguments = quick(benchmark, "model=physics_only", "seed=3,4", "hydra.sweep.dir=sweep")
    code, _, err = called("-m", *arguments, cwd=tmp_path)
    assert code == 0, err
    seeds = [
        json.loads(p.read_text())["members"][0]["seed"] for p in sorted((tmp_path / "sweep").glob("*/metrics.json"))
    ]
    assert seeds == [3, 4]


def test_physics_only_runs_one_member_because_all_would_be_equal(tmp_path, benchmark):
    run = trained(tmp_path / "run", *quick(benchmark, "model=physics_only"))
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert metrics["summary"]["planned"] == 1
    assert metrics["members"][0]["best_epoch"] == 0


def test_resume_refuses_another_run_and_takes_more_epochs(tmp_path, benchmark):
    saved = composed(*quick(benchmark))
    longer = {**saved, "fit": {**saved["fit"], "epochs": 9}}
    for given in (["fit.epochs=9", "resume=x"], ["+experiment=cascaded_tank", "fit.epochs=9"]):
        assert resume_config(longer, saved, given, tmp_path) == {**longer, "resume": str(tmp_path)}
    assert resume_config(longer, saved, ["resume=x"], tmp_path) == {**saved, "resume": str(tmp_path)}
    other = {**saved, "model": {**saved["model"], "hidden": 8}}
    assert resume_config(other, saved, ["seed=0"], tmp_path)["model"]["hidden"] == 3
    with pytest.raises(ValueError, match=r"resume: model.hidden: expected 3 as in .*config.yaml, found 8"):
        resume_config(other, saved, ["model.hidden=8"], tmp_path)


@pytest.mark.slow
def test_a_killed_run_resumes_from_its_first_checkpoint(tmp_path, benchmark):
    """SIGKILL before anything was trained: the run is there, unfinished, and resumes to its end."""
    process = start(*quick(benchmark), "fit.epochs=40", "hydra.run.dir=killed", cwd=tmp_path)
    while not (tmp_path / "killed/checkpoint/0").exists() and process.poll() is None:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert not (tmp_path / "killed/DONE").exists()
    code, _, err = called("resume=killed", "fit.epochs=60", cwd=tmp_path)
    assert code == 0, err
    assert pd.read_csv(tmp_path / "killed/history.csv")["epoch"].max() == 60
    assert read_config(tmp_path / "killed")["fit"]["epochs"] == 60
    assert json.loads((tmp_path / "killed/environment.json").read_text())["command"].endswith("fit.epochs=40")


def test_a_finished_run_that_cannot_be_resumed_stays_as_it_is(tmp_path, finished):
    """To fewer epochs, on other data, without its checkpoint; then another run takes its folder."""
    run, benchmark = RunFolder(tmp_path / "run"), finished[0] / "tanks.csv"
    shutil.copytree(finished[0] / "run", run.path)
    before = (run.path / "metrics.json").read_text()

    def refused(*arguments: str) -> str:
        code, _, err = called("resume=run", *arguments, cwd=tmp_path)
        assert code == 2
        assert (run.path / "metrics.json").read_text() == before
        assert run.finished
        return err

    fewer = "resume: fit.epochs: expected at least the 2 already trained, found 1"
    assert fewer in refused("fit.epochs=1")
    kept = benchmark.read_bytes()
    write_benchmark(benchmark, samples=160, seed=1)
    try:
        assert "resume: data: expected" in refused("fit.epochs=9")
    finally:
        benchmark.write_bytes(kept)
    shutil.rmtree(run.checkpoint)
    assert "checkpoint: expected one in" in refused()
    run = trained(tmp_path / "run", *quick(benchmark, "model=physics_only"))
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert metrics["summary"]["planned"] == 1
    assert run.finished


def test_a_stop_before_training_writes_nothing(tmp_path):
    """Ctrl-C while the data is read."""
    (tmp_path / "slow.py").write_text(
        "import os, signal\nfrom pgrssnn_jax.physics.tanks import cascaded_tanks\n"
        "def physics():\n    os.kill(os.getpid(), signal.SIGINT)\n    return cascaded_tanks()\n"
    )
    path = write_benchmark(tmp_path / "tanks.csv", samples=160)
    code, _, err = called(
        "physics._target_=slow.physics", "data=cascaded_tank", f"data.path={path}", "data.n_validation=40", cwd=tmp_path
    )
    assert code == 130
    assert "stopped before training; nothing was written" in err
    assert not list(tmp_path.rglob("config.yaml"))


@pytest.mark.slow
def test_a_finished_run_is_read_back_without_its_data(tmp_path, benchmark):
    run = trained(tmp_path / "run", *quick(benchmark, "data.published_scaling=true", "initial_state=zero"))
    with np.load(run.path / "predictions.npz") as arrays:
        u, y_hat, x0 = arrays["u"][0], arrays["y_hat"][:, 0], arrays["x0"][0, 0]
    benchmark.unlink()
    again = load(run.path).simulate(u, x0)
    with pytest.raises(
        ValueError, match=r"simulate: x0: expected shape \(2,\) or \(1, 2\) or \(\d, 1, 2\), found \(3,\)"
    ):
        load(run.path).simulate(u, np.zeros(3))
    np.testing.assert_allclose(again, y_hat, rtol=1e-3, atol=1e-3)
    with pytest.raises(ValueError, match="run folder: expected one"):
        load(tmp_path)


@pytest.mark.slow
def test_a_run_with_chosen_settings_says_what_was_chosen_and_goes_on_with_it(tmp_path, benchmark):
    run = trained(tmp_path / "run", *quick(benchmark, "recipe=auto", "n_seeds=2", "data.n_train=80"))
    metrics, config = run.read_json("metrics.json"), read_config(run.path)
    recipe = metrics["recipe"]
    assert recipe["name"] == config["recipe"]["name"] == "auto"
    assert recipe["tried"][0]["settings"] == recipe["chosen"] == config["recipe"]["chosen"]
    assert any(one["settings"].startswith("the physics alone") for one in recipe["tried"])
    assert "How the settings were chosen" in (run.path / "report.html").read_text(encoding="utf-8")
    again = load(run.path)
    assert again.recipe["chosen"] == recipe["chosen"]
    assert again.settings.data.folds == config["data"]["folds"] > 0


def test_own_data_chooses_its_settings_and_experiments_keep_theirs():
    csv = ("physics=tanks", "data=csv", "data.train=A.csv", "data.test=B.csv")
    assert composed(*csv)["recipe"] == "auto"
    assert composed(*csv, "recipe=default")["recipe"] == "default"
    assert composed("+experiment=cascaded_tank")["recipe"] == "cascaded_tank"
    assert composed("+experiment=cascaded_tank", "recipe=auto")["recipe"] == "auto"


def test_a_setting_that_is_typed_stays_as_it_is_where_it_is_the_usual_one_too(tmp_path, benchmark, monkeypatch):
    held = set[str]()

    def choose(physics, train, settings, kept, **_) -> None:
        held.update(kept)

    monkeypatch.setattr("pgrssnn_jax.cli.train.choose_settings", choose)
    code, _, err = called(*quick(benchmark, "recipe=auto", "initial_state=first_output"), cwd=tmp_path)
    assert (code, "nothing was written" in err) == (130, True), err
    assert "initial_state" in held
    assert "correction" not in held
