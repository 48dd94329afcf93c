"""The README and the pages of docs are true: their commands compose, their paths exist, their Python runs."""

import importlib
import json
import re
import shlex
from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from commands import ROOT, called, command, composed
from hydra import compose, initialize_config_dir

import pgrssnn_jax as pg
from pgrssnn_jax.cli.config_store import register
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.records.arguments import call_with
from pgrssnn_jax.records.record import Record, crop

README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md")), ROOT / "runs/README.md"]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", flags=re.M | re.S)
SCRIPTS = ("python train.py", "python discover.py", "python report.py")
COMMANDS = sorted(
    {
        line.split(" #")[0].strip()
        for page in PAGES
        for line in page.read_text().replace("\\\n", "").splitlines()
        if line.startswith(SCRIPTS)
    }
)
BLOCKS = [block for language, block in BLOCK.findall(README.read_text()) if language == "python"]
FIRST, EXAMPLE = BLOCKS[0], next(block for block in BLOCKS if "# my_physics.py" in block)


def prose(page: Path) -> str:
    return BLOCK.sub("", page.read_text())


def test_the_readme_is_short():
    assert len(README.read_text().splitlines()) <= 150


def test_the_own_physics_example_is_short():
    assert len(EXAMPLE.strip().splitlines()) <= 30


def test_all_three_commands_are_shown():
    assert {line.split()[1] for line in COMMANDS} == {"train.py", "discover.py", "report.py"}


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_composes(line):
    words = [word for word in shlex.split(line)[2:] if word != "-m" and not word.startswith("hydra.")]
    words = [word.split(",")[0] if "=" in word and "[" not in word else word for word in words]
    name = line.split()[1].removesuffix(".py")
    if any(word.startswith("resume=") for word in words):  # the rest stands in the folder
        register()
        with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
            assert compose(name, overrides=words).resume == "runs/FOLDER"
        return
    config = composed(*words, name=name)
    assert config["runs"] or config["verify"] if name == "report" else config["physics"]["_target_"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_link_leads_somewhere(page):
    for link in re.findall(r"\]\(([^)]+)\)", page.read_text()):
        if re.match(r"\w+:", link):
            continue
        path, _, heading = link.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), link
        if heading:
            titles = re.findall(r"^#+ (.*)$", there.read_text(), flags=re.M)
            assert heading in {re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in titles}, link


#: written by a run, or the reader's own
_NOT_HERE = re.compile(
    r"[A-Z]\.csv|my_\w+\.\w+|(config\.yaml|environment\.json|physics\.json|history\.csv|metrics\.json"
    r"|(predictions|intervals)\.npz|report\.html|discovery\.(json|npz)|corrected\.(json|urdf)|traceback\.txt|tables\.\w+)"
    r"|(checkpoint|figures)/.*|table1_tank/.*|runs/.+/.+"
)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_path_in_the_text_is_there(page):
    """Beside the page, from the root, or in the package."""
    for path in re.findall(r"`([\w.-]+(?:/[\w.=-]*)*)`", prose(page)):
        named = "/" in path or re.search(r"\.(py|md|yaml|toml|json|npz|csv|html|txt|png|lock)$", path)
        if named and not _NOT_HERE.fullmatch(path):
            places = (page.parent, ROOT, ROOT / "pgrssnn_jax")
            assert any((place / path).exists() for place in places), path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_line_in_the_text_names_a_script(page):
    for path in re.findall(r"`python ([\w/.-]+\.py)", page.read_text()):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize(
    "target", sorted({t for page in PAGES for t in re.findall(r"(?:^|`)make ([\w-]+)", page.read_text(), flags=re.M)})
)
def test_every_make_target_is_there(target):
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), flags=re.M)


def test_every_module_in_the_text_can_be_imported():
    for page in PAGES:
        for name in re.findall(r"`(pgrssnn_jax(?:\.\w+)+)`", page.read_text()):
            module, _, last = name.rpartition(".")
            try:
                importlib.import_module(name)
            except ModuleNotFoundError:
                assert hasattr(importlib.import_module(module), last), f"{page.name}: {name}"


CHEAP = {"network_epochs": 0, "folds": 2, "draws": 99, "starts": 1, "most": 1, "block": 20}


@pytest.mark.slow
def test_the_first_python_block_runs_as_written(monkeypatch):
    """Generated records, one seed, two epochs, a cheap discovery."""
    load, fit, discover = pg.load_benchmark, pg.fit, pg.discover

    def generated(name: str) -> tuple[Record, Record]:
        train, test = load(name, generated=True, n_train=384)
        return train, crop(test, 0, 256)

    monkeypatch.setattr(pg, "load_benchmark", generated)
    monkeypatch.setattr(pg, "fit", lambda *given: fit(*given, seeds=1, epochs=2, hidden=3, folds=0, quiet=True))
    monkeypatch.setattr(pg, "discover", lambda *given: discover(*given, **CHEAP, quiet=True))
    said: dict = {}
    exec(compile(FIRST, "README.md", "exec"), said)
    assert said["found"].verdict in set(Verdict)
    assert said["y"].shape == (1, 1, 256, 1)
    assert np.isfinite(said["y"]).all()
    table = said["ensemble"].score(said["test"])
    assert isinstance(table, pd.DataFrame)
    assert len(table) == 1
    assert said["better"].physics.discovered
    plt.close("all")


def pendulum_csv(path, physics, samples: int, seed: int):
    """A pendulum simulated by its own physics with drag that the model does not know."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-3, 3, (samples // 10, 1)), 10, axis=0)
    x, y = jnp.zeros(2), []
    for u_t in u:
        x = physics.step(physics.params, x, jnp.asarray(u_t, jnp.float32))
        x = x.at[1].add(-0.02 * x[1] * jnp.abs(x[1]))
        y.append(physics.measure(physics.params, x, u_t))
    columns = {"time": np.arange(samples) * physics.dt, "torque": u[:, 0], "angle": np.ravel(y)}
    pd.DataFrame(columns).to_csv(path, index=False)


@pytest.mark.slow
def test_the_own_physics_example_trains_on_own_data(tmp_path):
    (tmp_path / "my_physics.py").write_text(EXAMPLE)
    namespace: dict = {}
    exec(compile(EXAMPLE, "my_physics.py", "exec"), namespace)
    physics = call_with(namespace["pendulum"], {}, "physics")
    pendulum_csv(tmp_path / "A.csv", physics, 200, 0)
    pendulum_csv(tmp_path / "B.csv", physics, 100, 1)
    code, _, err = command(
        "physics._target_=my_physics.pendulum", "data=csv", "data.train=A.csv", "data.test=B.csv",
        "n_seeds=2", "fit.epochs=100", "fit.learning_rate=0.01", "model.hidden=6", "hydra.run.dir=run", cwd=tmp_path,
    )  # fmt: skip
    assert code == 0, err
    metrics = json.loads((tmp_path / "run/metrics.json").read_text())
    assert metrics["system"] == "pendulum"
    assert metrics["outputs"] == [{"name": "angle", "unit": "rad"}]
    assert metrics["summary"]["finished"] == metrics["summary"]["planned"] > 0
    assert metrics["recipe"]["name"] == "auto"
    code, _, err = called(
        "physics._target_=my_physics.pendulum", "+physics.length=0.5", "data=csv", "data.train=A.csv",
        "data.test=C.csv", cwd=tmp_path,
    )  # fmt: skip
    assert code == 2
    assert "C.csv" in err
