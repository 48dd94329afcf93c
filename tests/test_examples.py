"""The notebooks of examples/ are stored executed, run as they stand, and find what they say they find."""

import importlib.util
import re
from functools import partial
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pinocchio
import pytest
from commands import ROOT

import pgrssnn_jax as pg

EXAMPLES = ROOT / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
LARGEST = 300_000  # bytes
FOREIGN = "/".join(("", "home", "somebody", "data.csv"))  # a path of one machine
each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


@pytest.fixture(scope="module")
def execute():
    """`examples/execute.py`, which is no module of the package."""
    spec = importlib.util.spec_from_file_location("execute", EXAMPLES / "execute.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cells(path, kind="code"):
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == kind]


def outputs(path):
    return [output for cell in cells(path) for output in cell.outputs]


def run(name: str, folder: Path, monkeypatch) -> dict:
    """All that the cells of a notebook define, run one after the other in this process."""
    monkeypatch.chdir(folder)
    said: dict = {}
    (path,) = EXAMPLES.glob(f"{name}*.ipynb")
    for k, cell in enumerate(cells(path)):
        exec(compile(re.sub("^%.*$", "", cell.source, flags=re.M), f"{path.name}, cell {k}", "exec"), said)
    plt.close("all")
    return said


def holds(found: pg.Discovered, number: str, truth: float) -> bool:
    """Is the true value in the 95 % interval?"""
    low, high = found.details["parameters"][number]["interval"]
    return low <= truth <= high


def test_there_are_five():
    assert [path.stem[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05"]


@each
def test_a_notebook_is_stored_as_it_ran_from_top_to_bottom(path, execute):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert [cell.execution_count for cell in cells(path)] == list(range(1, len(cells(path)) + 1))
    assert {output.output_type for output in outputs(path)} <= {"stream", "execute_result", "display_data"}
    assert not [output for output in outputs(path) if output.get("name") == "stderr"]
    assert any("image/png" in output.get("data", {}) for output in outputs(path))
    assert notebook.metadata == execute.METADATA
    assert all(not cell.metadata for cell in notebook.cells)
    text = path.read_text()
    assert not execute.PRIVATE.search(text)
    assert len(text.encode()) <= LARGEST


@each
def test_a_notebook_is_short_and_says_what_comes(path):
    kinds = [cell.cell_type for cell in nbformat.read(path, as_version=4).cells]
    assert 8 <= len(kinds) <= 20
    assert kinds[0] == kinds[-1] == "markdown"
    assert all(before == "markdown" for before, kind in pairwise(kinds) if kind == "code")
    for cell in cells(path, "markdown"):
        assert 1 <= len(re.findall(r"[.!?:;](?:\s|$)", cell.source)) <= 6, cell.source
    assert (
        "pg.read_csv" in cells(path, "markdown")[-1].source or "pg.load_arm_log" in cells(path, "markdown")[-1].source
    )


@pytest.mark.slow
def test_executing_stores_what_a_reader_sees_alone(tmp_path, execute):
    cell = "import matplotlib.pyplot as plt\n_ = plt.figure(figsize=(20, 2)).subplots().plot([1, 3])\nprint('drawn')"
    path = tmp_path / "small.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell)]), path)
    execute.execute(path)
    first = path.read_bytes()
    printed, picture = outputs(path)
    assert printed.text == "drawn\n"
    assert list(picture.data) == ["image/png"]
    assert not cells(path)[0].metadata
    execute.execute(path)
    assert path.read_bytes() == first


@pytest.mark.parametrize("line", [f"print('{FOREIGN}')", "import warnings; warnings.warn('old')"])
def test_what_belongs_to_one_machine_is_not_stored(line, execute):
    kind = "stderr" if "warn" in line else "stdout"
    output = nbformat.v4.new_output("stream", name=kind, text=line)
    cell = nbformat.v4.new_code_cell(line, outputs=[output])
    with pytest.raises(ValueError, match="cell 1: expected neither warnings nor folders"):
        execute.tidy(nbformat.v4.new_notebook(cells=[cell]))


def test_the_first_fit_runs_on_generated_data(tmp_path, monkeypatch):
    fit, few = pg.fit, {"seeds": 2, "epochs": 2, "hidden": 3, "folds": 2}
    monkeypatch.setattr(pg, "load_benchmark", partial(pg.load_benchmark, generated=True, n_train=128))
    monkeypatch.setattr(pg, "fit", lambda *given, **settings: fit(*given, **{**settings, **few}))
    said = run("01", tmp_path, monkeypatch)
    assert len(said["scores"]) == 3
    assert np.isfinite(said["scores"].rmse).all()
    assert said["inside"].shape == said["test"].y.shape


@pytest.mark.slow
@pytest.mark.data
def test_the_first_fit_is_better_than_the_physics(tmp_path, monkeypatch):
    said = run("01", tmp_path, monkeypatch)
    rmse = said["scores"].rmse
    assert rmse["physics and network"].mean() < 0.6 * rmse["physics alone"].iloc[0]
    assert 0.75 <= said["inside"].mean() <= 1.0


@pytest.mark.slow
def test_the_own_system_is_predicted_better_than_by_its_physics(tmp_path, monkeypatch):
    said = run("02", tmp_path, monkeypatch)
    assert said["scores"]["physics and network"] < 0.5 * said["scores"]["engineer's model"]
    assert 0.7 <= said["inside"].mean() <= 1.0
    assert said["tried"].left_out_nrmse.iloc[0] == said["tried"].left_out_nrmse.min()


@pytest.mark.slow
def test_the_hidden_effect_is_found(tmp_path, monkeypatch):
    said = run("03", tmp_path, monkeypatch)
    assert said["found"].verdict == "effect_found"
    (effect,) = said["found"].effects
    assert effect.name == "quadratic_drag"
    assert holds(said["found"], "quadratic_drag.c[1]", said["DRAG"])
    assert holds(said["found"], "l", said["LENGTH"])
    errors = said["errors"]
    assert errors["physics with the effect"] < 0.2 * errors["physics, its numbers refitted"]
    assert errors["physics with the effect, and networks"] < 1.2 * errors["physics with the effect"]


@pytest.mark.slow
@pytest.mark.data
def test_the_arm_is_corrected(tmp_path, monkeypatch):
    said = run("04", tmp_path, monkeypatch)
    found = said["found"]
    assert said["train"].info.source == "file"
    assert found.verdict == "effect_found"
    assert found.gap["after"]["test"] < 0.6 * found.gap["before"]["test"]
    names = {effect.name for effect in found.effects}
    assert {"gravity_direction", "home_offset", "payload"} <= names
    robot = said["robot"]
    assert robot.nq == len(said["table"]) == 6
    pose = np.zeros(6)
    assert np.isfinite(pinocchio.rnea(robot, robot.createData(), pose, pose, pose)).all()


@pytest.mark.slow
def test_what_has_changed_is_told_from_what_was_known(tmp_path, monkeypatch):
    said = run("05", tmp_path, monkeypatch)
    assert [effect.name for effect in said["calibrated"].effects] == ["coulomb_friction"]
    assert said["changed"].verdict == "effect_found"
    (effect,) = said["changed"].effects
    assert effect.name == "input_saturation"
    assert holds(said["changed"], "input_saturation.high[1]", 90.0)
    assert holds(said["changed"], "input_saturation.low[1]", -90.0)
    assert holds(said["changed"], "m", 92.0)
    assert not said["same"].effects
