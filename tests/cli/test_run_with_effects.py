"""A run on the physics of a discovery keeps that physics: the file it came from may change or go."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from commands import QUICK, called, composed, trained, without_pictures, write_benchmark

from pgrssnn_jax import api as pg
from pgrssnn_jax.cli.sweeps import job_status
from pgrssnn_jax.effects.base import effects_of
from pgrssnn_jax.effects.stored import physics_to_json
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.training.run_folder import RunFolder

LONGER = "fit.epochs=4"


def write_found(path: Path, voltage: float, **numbers: float) -> None:
    """A pump that saturates."""
    found = pg.add(cascaded_tanks(**numbers), "pump_saturation", voltage=voltage)
    path.write_text(json.dumps({**physics_to_json(found), "discovered": True}))


def arguments(folder: Path) -> list[str]:
    return [
        "+experiment=cascaded_tank", f"data.path={folder / 'tanks.csv'}", "data.n_validation=20", *QUICK,
        f"physics.effects={folder / 'found.json'}", "data.folds=0", "initial_state=first_output",
        "model=physics_only", "fit.physics_parameters=trained",
    ]  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def no_pictures() -> Iterator[None]:
    with without_pictures():
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A run of two epochs, and another one of four that nobody touches, both on one file of effects."""
    folder = tmp_path_factory.mktemp("effects")
    write_benchmark(folder / "tanks.csv", samples=80)
    write_found(folder / "found.json", voltage=3.0, k1=0.05)
    trained(folder / "run", *arguments(folder))
    trained(folder / "whole", *arguments(folder), LONGER)
    return folder


def other(file: Path) -> None:
    write_found(file, voltage=1.0, k1=0.2)


def broken(file: Path) -> None:
    file.write_text("{")


def deleted(file: Path) -> None:
    file.unlink()


@pytest.mark.parametrize("change", [other, *(pytest.param(one, marks=pytest.mark.slow) for one in (broken, deleted))])
def test_what_happens_to_the_file_of_effects_changes_nothing_in_the_run(made, tmp_path, change):
    run, file = tmp_path / "run", made / "found.json"
    shutil.copytree(made / "run", run)
    kept = file.read_bytes()
    change(file)
    try:
        loaded = pg.load(run)
        code, _, err = called("resume=run", LONGER, cwd=tmp_path)
    finally:
        file.write_bytes(kept)
    with np.load(made / "run/predictions.npz") as arrays:
        np.testing.assert_allclose(loaded.simulate(arrays["u"], arrays["x0"][0, 0]), arrays["y_hat"], atol=1e-4)  # V
    assert effects_of(loaded.physics.params)["pump_saturation"]["voltage"] == pytest.approx(3.0)
    assert code == 0, err
    for name in ("history.csv", "physics.json"):
        assert (run / name).read_text() == (made / "whole" / name).read_text()
    resumed, whole = (json.loads((f / "metrics.json").read_text()) for f in (run, made / "whole"))
    assert resumed["summary"] == whole["summary"]
    again = json.loads((run / "physics.json").read_text())
    assert again["numbers"]["effects"] == {"pump_saturation": {"voltage": pytest.approx(3.0)}}
    assert again["numbers"]["parameters"]["k1"] == pytest.approx(0.05)
    assert job_status(RunFolder(run), composed(*arguments(made), LONGER)) == "finished"


@pytest.mark.slow
def test_a_run_that_was_made_longer_remembers_the_file_it_was_made_of(made, tmp_path):
    """`resume=` must not point the configuration at the folder itself, which may be moved."""
    shutil.copytree(made / "run", tmp_path / "run")
    code, _, err = called("resume=run", LONGER, cwd=tmp_path)
    assert code == 0, err
    (tmp_path / "run").rename(tmp_path / "moved")
    loaded = pg.load(tmp_path / "moved")
    assert effects_of(loaded.physics.params)["pump_saturation"]["voltage"] == pytest.approx(3.0)
    code, _, err = called("resume=moved", "fit.epochs=5", cwd=tmp_path)
    assert code == 0, err


@pytest.mark.slow
def test_a_job_of_a_sweep_that_was_gone_on_with_is_still_that_job(made, tmp_path):
    """Else the next start of the sweep takes its finished run for another one."""
    shutil.copytree(made / "run", tmp_path / "run")
    code, _, err = called("resume=run", cwd=tmp_path)
    assert code == 0, err
    assert job_status(RunFolder(tmp_path / "run"), composed(*arguments(made))) == "finished"
