"""The run folder."""

import errno
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pgrssnn_jax.training.run_folder import RunFolder, discard_if_empty, environment, read_config


def test_json_has_null_for_what_is_not_a_number(tmp_path):
    run = RunFolder(tmp_path / "run")
    run.write_json(
        "metrics.json", {"a": float("nan"), "b": [np.float32(1.5), np.inf], "c": {"d": np.int64(3), "e": None}}
    )
    assert json.loads((run.path / "metrics.json").read_text()) == {
        "a": None,
        "b": [1.5, None],
        "c": {"d": 3, "e": None},
    }


def test_csv_and_arrays_come_back_to_the_last_digit(tmp_path):
    run = RunFolder(tmp_path)
    losses = np.float32([0.1, 1 / 3, 2e-30])
    run.write_csv("history.csv", pd.DataFrame({"loss": losses}))
    assert np.array_equal(pd.read_csv(tmp_path / "history.csv")["loss"].to_numpy(np.float32), losses)
    run.write_arrays("predictions.npz", {"y": losses})
    with np.load(tmp_path / "predictions.npz") as found:
        assert np.array_equal(found["y"], losses)


def test_a_failed_write_leaves_the_earlier_file(tmp_path):
    run = RunFolder(tmp_path)
    run.write_json("metrics.json", {"a": 1})
    with pytest.raises(TypeError):
        run.write_json("metrics.json", {"a": object()})
    assert json.loads((tmp_path / "metrics.json").read_text()) == {"a": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.json"]


def test_a_write_that_breaks_off_leaves_nothing_of_its_own(tmp_path):
    run = RunFolder(tmp_path)
    run.write_text("figures/a.txt", "whole")

    def breaks_off(path: Path) -> None:
        path.write_text("ha")
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        run.write("figures/a.txt", breaks_off)
    assert [path.read_text() for path in run.figures.iterdir()] == ["whole"]


def test_a_new_run_never_finds_the_checkpoints_of_the_one_before(tmp_path, monkeypatch):
    """Killed before its own first checkpoint, it would go on from numbers of another configuration."""
    run = RunFolder(tmp_path / "run")
    (run.checkpoint / "20").mkdir(parents=True)
    (run.path / ".metrics.json.partial").write_text("{")
    run.begin("a: 1\n", command=None, data={})
    assert run.has_checkpoint
    monkeypatch.setattr(run, "write_text", None)  # nothing is written any more
    with pytest.raises(TypeError):
        run.begin("a: 2\n", command="python train.py", data={})
    assert read_config(run.path) == {"a": 1}
    assert [path.name for path in run.path.iterdir()] == ["config.yaml"]


def test_done_comes_last_and_goes_first(tmp_path):
    run = RunFolder(tmp_path / "run")
    run.begin("a: 1\n", command="python train.py", data={"train": "file: a"})
    assert not run.finished
    run.finish()
    assert run.finished
    (tmp_path / "run/metrics.json").write_text("{}")
    run.begin("a: 2\n", command=None, data={})
    assert not run.finished
    assert read_config(run.path) == {"a": 2}
    assert json.loads((run.path / "environment.json").read_text())["command"] == "python train.py"
    assert not (run.path / "metrics.json").exists()
    run.check_data({"train": "file: a"})
    with pytest.raises(ValueError, match="resume: data: expected .*file: a.* found .*simulated"):
        run.check_data({"train": "simulated: b"})


def test_the_environment_names_versions_and_devices():
    found = environment()
    assert found["packages"]["jax"]
    assert len(found["devices"]) == 2
    assert json.dumps(found)


def test_a_folder_without_a_run_is_named(tmp_path):
    with pytest.raises(ValueError, match="run folder: expected one with a config.yaml, found none in"):
        read_config(tmp_path)


def test_only_empty_folders_are_discarded(tmp_path):
    empty, full = tmp_path / "empty", tmp_path / "full"
    empty.mkdir()
    full.mkdir()
    (full / "x").touch()
    for folder in (empty, full, tmp_path / "none"):
        discard_if_empty(folder)
    assert not empty.exists()
    assert full.exists()
