"""The README and the pages of docs are true: their commands compose, their paths exist, their Python runs."""

import importlib
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from blocks import BLOCK, SCRIPTS, blocks, run_page, saved_block, shell_lines
from commands import ROOT, called, command, composed
from hydra import compose, initialize_config_dir
from workplace import furnish, pendulum, pendulum_csv

from pgrssnn_jax.cli.config_store import register
from pgrssnn_jax.discovery.verdict import Verdict

README, DOCS = ROOT / "README.md", ROOT / "docs"
PAGES = [README, *sorted(DOCS.glob("*.md")), ROOT / "runs/README.md"]


def lines_of(page: Path) -> list[str]:
    return [line for language, text in blocks(page) if language == "bash" for line in shell_lines(text)]


SHELL = {line for page in PAGES for line in lines_of(page)}
COMMANDS = sorted(line for line in SHELL if line.startswith(tuple(f"python {script}" for script in SCRIPTS)))
EXAMPLE = saved_block(README, "my_physics.py")
#: blocks of these languages are output, files and trees, which nobody runs
NO_CODE = {"text", "json", "yaml", "xml"}


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
    r"[A-Z]\.csv|my_\w+\.\w+|measure\.py|site/.*|(config\.yaml|environment\.json|physics\.json|history\.csv|metrics\.json"
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_block_says_what_it_is(page):
    """A block without a language would be neither run nor seen to be output."""
    assert len(re.findall(r"^ *```", page.read_text(), flags=re.M)) == 2 * len(blocks(page))
    assert {language for language, _ in blocks(page)} <= {"python", "bash", *NO_CODE}


def test_the_tutorial_and_the_readme_show_the_same_physics():
    assert saved_block(DOCS / "tutorial.md", "my_physics.py") == EXAMPLE


CODE = [page for page in PAGES if {"python", "bash"} & {language for language, _ in blocks(page)}]
QUICK_PAGES = ("catalogue",)


@pytest.mark.parametrize(
    "page", [page if page.stem in QUICK_PAGES else pytest.param(page, marks=pytest.mark.compiles) for page in CODE],
    ids=lambda page: f"{page.parent.name}_{page.stem}",
)  # fmt: skip
def test_every_block_runs_as_printed(page, tmp_path, monkeypatch):
    furnish(tmp_path, page)
    before = PAGES[: PAGES.index(page)]
    said = run_page(page, tmp_path, monkeypatch, {line for other in before for line in lines_of(other)})
    if page == README:
        assert said["found"].verdict in set(Verdict)
        assert said["y"].shape == (1, 1, 256, 1)
        assert np.isfinite(said["y"]).all()
        table = said["ensemble"].score(said["test"])
        assert isinstance(table, pd.DataFrame)
        assert len(table) == 1
        assert said["better"].physics.discovered


@pytest.mark.compiles
def test_the_own_physics_example_trains_on_own_data(tmp_path):
    (tmp_path / "my_physics.py").write_text(EXAMPLE)
    physics = pendulum()
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
