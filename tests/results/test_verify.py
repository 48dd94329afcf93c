"""`report.py verify=RUN`: a run is what it says, or the command tells how far it is from it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import QUICK, called, trained, without_pictures, write_benchmark

from pgrssnn_jax.results.verify import verify


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Callable[[str], Path]:
    """Makes a run of some name, always the same."""
    folder = tmp_path_factory.mktemp("verify")
    data = write_benchmark(folder / "data.csv", samples=160)
    arguments = ["+experiment=cascaded_tank", f"data.path={data}", "data.n_validation=40", "model=rssnn", *QUICK]

    def make(name: str) -> Path:
        with without_pictures():
            return trained(folder / name, *arguments).path

    return make


@pytest.fixture(scope="module")
def run(made) -> Path:
    return made("run")


@pytest.fixture
def copy(run, tmp_path) -> Path:
    return Path(shutil.copytree(run, tmp_path / "run"))


def test_a_run_evaluated_again_gives_its_own_bits(run):
    found = verify(run)
    assert (found.members, found.planned) == (2, 2)
    assert found.predictions == found.figures == 0.0


@pytest.mark.compiles
def test_the_same_run_again_writes_the_same_bytes_but_for_its_seconds(made, run):
    both = [run, made("again")]
    first, second = (json.loads((run / "metrics.json").read_text()) for run in both)
    assert first.pop("seconds") != second.pop("seconds")
    assert json.dumps(first) == json.dumps(second)
    assert (both[0] / "history.csv").read_bytes() == (both[1] / "history.csv").read_bytes()


def test_the_command_writes_nothing_and_says_equal(copy, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in copy.rglob("*")}
    code, out, err = called("verify=run", cwd=tmp_path, script="report.py")
    assert code == 0, err
    assert "2 of 2 members evaluated again" in out
    assert out.strip().endswith("equal")
    assert {path: path.stat().st_mtime_ns for path in copy.rglob("*")} == before


def test_figures_that_were_changed_end_with_3(copy, tmp_path):
    metrics = json.loads((copy / "metrics.json").read_text())
    metrics["members"][1]["by_n_init"]["0" if "0" in metrics["members"][1]["by_n_init"] else "1"]["rmse"][0] *= 0.9
    (copy / "metrics.json").write_text(json.dumps(metrics))
    code, out, _ = called("verify=run", cwd=tmp_path, script="report.py")
    assert code == 3
    assert "not equal" in out
    assert verify(copy).figures == pytest.approx(1 / 0.9 - 1, rel=1e-6)


def test_predictions_that_were_changed_are_seen(copy):
    with np.load(copy / "predictions.npz") as stored:
        arrays = dict(stored)
    arrays["y_hat"] = arrays["y_hat"] + np.float32(0.5) * arrays["y"].std().astype(np.float32)
    np.savez(copy / "predictions.npz", **arrays)
    assert verify(copy).predictions == pytest.approx(0.5, rel=1e-3)
    assert not verify(copy).equal


def test_a_folder_without_predictions_is_refused(copy, tmp_path):
    (copy / "predictions.npz").unlink()
    code, _, err = called("verify=run", cwd=tmp_path, script="report.py")
    assert code == 2
    assert "predictions.npz: expected the array 'y'" in err
