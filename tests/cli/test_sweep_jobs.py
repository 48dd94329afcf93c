"""python train.py -m, as a user types it: nothing is trained twice, nothing stops the others, everything is told."""

import json
import random
import signal
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import QUICK, ROOT, command, start

from pgrssnn_jax.acceleration.devices import usable_cores
from pgrssnn_jax.training.run_folder import RunFolder, read_config

# train.py with work that takes no time: seed 1 is bad input and seed 2 an exception, until FIXED is set
STUB = f"""
import os
import signal
from pathlib import Path
import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf
from pgrssnn_jax.cli import entry
from pgrssnn_jax.cli.plan import plain_config
from pgrssnn_jax.cli.process import Interrupted
from pgrssnn_jax.training.run_folder import RunFolder

def prepare(config):
    settings, run = plain_config(config), RunFolder(Path(HydraConfig.get().runtime.output_dir))
    if settings["seed"] == 1 and "FIXED" not in os.environ:
        raise ValueError("seed: expected another one, found 1")
    def work(stop):
        run.begin(OmegaConf.to_yaml(settings), command="stub", data={{}})
        if settings["seed"] == 2 and "FIXED" not in os.environ:
            raise RuntimeError("it broke\\nhere")
        if settings["seed"] == 9:
            print("waiting", flush=True)
            stop.wait(60)
            raise Interrupted("stopped")
        if settings["seed"] == 8 and "FIXED" not in os.environ:
            os.kill(os.getpid(), signal.SIGINT)  # as a user does while the last figures are drawn
        run.write_json("metrics.json", {{"resumed": settings["resume"]}})
        run.finish()
    return entry.Work(run.path, work)

@hydra.main(version_base="1.3", config_path={str(ROOT / "conf")!r}, config_name="train")
def main(config):
    return entry.run(prepare, config)

if __name__ == "__main__":
    entry.call(main)
"""


@pytest.fixture
def stub(tmp_path) -> str:
    path = tmp_path / "stub.py"
    path.write_text(STUB)
    return str(path)


def quick(benchmark: Path, *more: str) -> list[str]:
    return ["-m", "+experiment=cascaded_tank", f"data.path={benchmark}", "data.n_validation=40", *QUICK, *more]


def folders(sweep: Path) -> dict[str, RunFolder]:
    return {path.name: RunFolder(path) for path in sweep.glob("*") if path.is_dir() and not path.name.startswith(".")}


def told(out: str, name: str) -> list[str]:
    """The last table's row of a job, in words."""
    rows = [line.split() for line in out.splitlines() if name in line.split()]
    return rows[-1]


def test_no_further_job_begins_after_ctrl_c_even_where_the_last_one_had_nothing_left_to_stop(tmp_path, stub):
    sweep = ["-m", "+experiment=cascaded_tank", "seed=7,8,9", "model=rssnn"]
    code, _, err = command(*sweep, cwd=tmp_path, script=stub)
    assert code == 130
    assert "the same command goes on with the sweep" in err
    runs = folders(tmp_path / "runs/cascaded_tank")
    assert {name: run.finished for name, run in runs.items()} == {
        "model=rssnn,seed=7": True,
        "model=rssnn,seed=8": True,
    }


@pytest.mark.slow
def test_a_failing_job_never_stops_the_others_and_the_next_start_only_does_what_is_left(tmp_path, stub):
    sweep = ["-m", "+experiment=cascaded_tank", "seed=0,1,2,3", "model=rssnn"]
    code, out, err = command(*sweep, cwd=tmp_path, script=stub)
    assert code == 2, err
    assert "4 jobs: 2 finished, 0 skipped, 2 failed" in out
    runs = folders(tmp_path / "runs/cascaded_tank")
    names = {seed: f"model=rssnn,seed={seed}" for seed in range(4)}
    assert set(runs) == set(names.values())
    assert told(out, names[1])[0] == "failed"
    assert runs[names[1]].failure == "seed: expected another one, found 1"
    assert {path.name for path in runs[names[1]].path.iterdir()} == {"FAILED"}
    assert told(out, names[2])[3:] == ["RuntimeError:", "it", "broke;", "see", "traceback.txt"]
    assert "it broke\nhere" in (runs[names[2]].path / "traceback.txt").read_text()
    assert [seed for seed in range(4) if runs[names[seed]].finished] == [0, 3]
    assert "Traceback" not in err + out

    before = {name: (run.path / "DONE").stat().st_mtime_ns for name, run in runs.items() if run.finished}
    longer = ["-m", "model=rssnn,nosuch", "seed=1,2,0,3", "+experiment=cascaded_tank"]
    code, out, err = command(*longer, cwd=tmp_path, script=stub, FIXED="1")
    assert code == 2, err
    assert "8 jobs: 2 finished, 2 skipped, 4 failed" in out
    assert "Could not find 'model/nosuch'" in (
        folders(tmp_path / "runs/cascaded_tank")["model=nosuch,seed=0"].failure or ""
    )
    assert all((run.path / "DONE").stat().st_mtime_ns == before.get(name, (run.path / "DONE").stat().st_mtime_ns)
               for name, run in runs.items())  # fmt: skip
    assert not any(run.failure for run in runs.values())
    assert not (runs[names[2]].path / "traceback.txt").exists()

    settings = runs[names[0]].path / "config.yaml"
    settings.write_text(settings.read_text().replace("patience: 500", "patience: 400"))
    code, out, err = command("-m", "+experiment=cascaded_tank", "model=rssnn", "seed=0", cwd=tmp_path, script=stub)
    assert code == 2
    sentence = "fit.patience: expected 500 as this job has it, found a run with 400: give the sweep another name"
    assert sentence in out
    assert "patience: 400" in settings.read_text()
    assert runs[names[0]].finished
    assert runs[names[0]].failure is None


@pytest.mark.slow
def test_a_table_runs_without_m_and_a_smoke_run_lands_where_no_other_does(tmp_path, stub):
    code, out, err = command("+experiment=data_efficiency_tank", "budget=smoke", cwd=tmp_path, script=stub)
    assert code == 0, err
    assert "12 jobs: 12 finished, 0 skipped, 0 failed" in out
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["data_efficiency_tank_smoke"]
    runs = folders(tmp_path / "runs/data_efficiency_tank_smoke")
    assert set(runs) == {f"model={model},data.n_train={n}" for model in ("pg_rssnn", "rssnn", "physics_only")
                         for n in (128, 256, 384, 768)}  # fmt: skip
    assert all(read_config(run.path)["fit"]["epochs"] == 10 for run in runs.values())
    code, out, err = command("-m", "+experiment=data_efficiency_tank,cascaded_tank", cwd=tmp_path, script=stub)
    assert code == 2
    assert "2 jobs: 1 finished, 0 skipped, 1 failed" in out
    assert "experiment=data_efficiency_tank: expected alone" in out


@pytest.mark.slow
def test_ctrl_c_ends_the_whole_sweep(tmp_path, stub):
    process = start("-m", "+experiment=cascaded_tank", "seed=0,9,3", cwd=tmp_path, script=stub)
    assert process.stdout is not None
    while "waiting" not in (line := process.stdout.readline()):
        assert line, process.communicate()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "stopped" in err
    assert set(folders(tmp_path / "runs/cascaded_tank")) == {"seed=0", "seed=9"}
    code, out, err = command("-m", "+experiment=cascaded_tank", "seed=0,3", cwd=tmp_path, script=stub)
    assert code == 0, err
    assert "2 jobs: 1 finished, 1 skipped, 0 failed" in out


def results(run: RunFolder) -> tuple:
    """What training left, but for the times."""
    metrics = json.loads((run.path / "metrics.json").read_text())
    history = pd.read_csv(run.path / "history.csv")
    assert not history.duplicated(["epoch", "seed", "dataset"]).any()
    return metrics["members"], metrics["summary"], history.to_dict("list")


@pytest.mark.slow
def test_a_sweep_killed_at_any_time_ends_as_if_nobody_had_touched_it(tmp_path, benchmark):
    sweep = quick(benchmark, "model=rssnn", "seed=0,4", "fit.epochs=6", "fit.checkpoint_seconds=0")
    began = time.monotonic()
    code, _, err = command(*sweep, "sweep=whole", cwd=tmp_path)
    assert code == 0, err
    whole = folders(tmp_path / "runs/whole")
    assert len(whole) == 2
    moment = random.SystemRandom().uniform(0, time.monotonic() - began)
    process = start(*sweep, "sweep=killed", cwd=tmp_path)
    time.sleep(moment)
    process.kill()
    process.communicate()
    done = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/killed/*/DONE")}
    begun = {path for path, run in folders(tmp_path / "runs/killed").items() if run.has_checkpoint and not run.finished}
    code, out, err = command(*sweep, "sweep=killed", cwd=tmp_path)
    assert code == 0, f"killed after {moment} s: {err}"
    killed = folders(tmp_path / "runs/killed")
    assert killed.keys() == whole.keys()
    assert all(run.finished and run.failure is None for run in killed.values())
    assert f"2 jobs: {2 - len(done)} finished, {len(done)} skipped, 0 failed" in out
    assert out.count("going on with") == len(begun)
    assert all(path.stat().st_mtime_ns == then for path, then in done.items())
    for name, run in killed.items():
        assert results(run) == results(whole[name]), f"{name}, killed after {moment} s"


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_launchers_put_every_run_where_a_serial_sweep_does(tmp_path, benchmark, launcher):
    sweep = ["-m", "+experiment=cascaded_tank", f"data.path={benchmark}", "model=physics_only"]
    sweep += ["data.n_validation=40,160", "physics.clamp=true", f"hydra/launcher={launcher}"]
    more = ["hydra.launcher.n_jobs=2"] if launcher == "joblib" else ["hydra.launcher.timeout_min=2"]
    code, out, err = command(*sweep, *more, "sweep=s", cwd=tmp_path)
    assert code == 2, err
    assert "2 jobs: 1 finished, 0 skipped, 1 failed" in out
    runs = folders(tmp_path / "runs/s")
    assert len(runs) == 2
    (good,), (bad,) = ([run for run in runs.values() if run.finished is ended] for ended in (True, False))
    assert "n_validation" in (bad.failure or "")
    assert np.isfinite(json.loads((good.path / "metrics.json").read_text())["summary"]["rmse_mean"])
    devices = len(json.loads((good.path / "environment.json").read_text())["devices"])
    assert devices == max(1, usable_cores() // 2)
