"""Running the code of a page as a reader would: its blocks in their order, in one folder, on small budgets.

Discoveries of arms take minutes on any budget: they are set up and checked. `tests/discovery/inverse` runs such ones.
"""

import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
from commands import ROOT, called, composed
from omegaconf import OmegaConf

import pgrssnn_jax as pg
from pgrssnn_jax.api import check_setup
from pgrssnn_jax.cli.discover import checked
from pgrssnn_jax.data.benchmarks import LOADERS
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import set_up
from pgrssnn_jax.effects.systems import system_of
from pgrssnn_jax.records.record import Record, crop
from pgrssnn_jax.training.settings import training_settings

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", flags=re.M | re.S)
SCRIPTS = ("train.py", "discover.py", "report.py")
_CAPS = OmegaConf.to_container(OmegaConf.load(ROOT / "conf/budget/smoke.yaml"))["data"]
_CHEAP = {"network_epochs": 0, "folds": 2, "draws": 99, "starts": 1, "most": 1, "block": 20}
#: experiments that sweep: the tables and figures of the paper
EXPERIMENTS = sorted(path.stem for path in (ROOT / "conf/experiment").glob("*.yaml") if "sweeper" in path.read_text())


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each block."""
    return BLOCK.findall(page.read_text())


def shell_lines(text: str) -> list[str]:
    """The commands of a block without comments, each on one line."""
    lines = (line.split(" #")[0].strip() for line in text.replace("\\\n", " ").splitlines())
    return [" ".join(line.split()) for line in lines if line]


def saved_block(page: Path, name: str) -> str:
    """The block of a page that the reader saves under a name."""
    (found,) = (text for language, text in blocks(page) if language == "python" and text.startswith(f"# {name}\n"))
    return found


def run_page(page: Path, folder: Path, monkeypatch: Any, known: Collection[str] = ()) -> dict[str, Any]:
    """The names that the Python blocks define. A block whose first line is the name of a file is saved first; known:
    commands that another page has run."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    for name in ("my_physics", "my_effects"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name, small in (("load_benchmark", _small_data), ("fit", _small_fit), ("discover", _small_discovery),
                        ("filter_form", _short_search)):  # fmt: skip
        monkeypatch.setattr(pg, name, small(getattr(pg, name)))
    said: dict[str, Any] = {}
    for language, text in blocks(page):
        if language == "python":
            if named := re.match(r"# (\w+\.py)\n", text):
                Path(named[1]).write_text(text)
            exec(compile(_filled(text), str(page), "exec"), said)
        elif language == "bash":
            for line in shell_lines(text):
                if line not in known:
                    run_line(_filled(line), folder)
    plt.close("all")
    return said


def _filled(text: str) -> str:
    """The names that stand for a run folder, replaced by folders of the workplace."""
    text = text.replace("runs/FOLDER/discovery.json", "runs/found/discovery.json")
    own = {True: "runs/pendulum", False: "runs/tanks"}
    return "\n".join(re.sub(r"runs/FOLDER|\bRUN\b", own["pendulum" in line], line) for line in text.split("\n"))


def run_line(line: str, folder: Path) -> None:
    words = shlex.split(line)
    if words[0] in ("make", "source", "pip", "git", "cd"):  # the installation
        return
    assert words[0] == "python", line
    script, *given = words[1:]
    if script.startswith("benchmarks/"):  # minutes; their own tests run them
        process = subprocess.run([sys.executable, ROOT / script, "--help"], capture_output=True, text=True, check=False)
        assert process.returncode == 0, process.stderr
    elif script == "discover.py" and any(word == "physics=arm" or "robot" in word for word in given):
        checked(composed(*given, *budget(script, given), name="discover"), print)  # and no more, as in Python
    elif script in SCRIPTS:
        if not _is_table(given):
            code, out, err = called(*given, *budget(script, given), cwd=folder, script=script)
            assert code == 0, f"{line}\n{out}\n{err}"
    else:
        runpy.run_path(str(folder / script), run_name="__main__")


def _is_table(given: list[str]) -> bool:
    """Those of the paper, which `tests/cli/test_smoke_tables.py` runs whole."""
    return any(word.removeprefix("+experiment=") in EXPERIMENTS for word in given)


def budget(script: str, given: list[str]) -> list[str]:
    """Overrides that make a command a matter of seconds, on generated data."""
    if script == "report.py" or any(word.startswith("resume=") for word in given):
        return []
    data = next((name for name in LOADERS if any(word == f"+experiment={name}" for word in given)), None)
    data = "robot_real" if "+experiment=robot_real_filter" in given else data
    generated = ["data.generated=true"] if data else []
    if script == "train.py":
        return [*generated, *([] if "budget=smoke" in given else ["budget=smoke"])]
    caps = _CAPS.get(data, {}).get("data", {})
    caps = {f"data.{name}": value for name, value in caps.items() if name != "realisations"}
    cheap = {f"discovery.{name}": value for name, value in _CHEAP.items()}
    return [*generated, *(f"{name}={value}" for name, value in {**caps, **cheap}.items())]


def _small_data(load: Callable[..., Any]) -> Callable[..., Any]:
    def generated(name: str) -> tuple[Record, Record]:
        train, test = load(name, generated=True, **_CAPS.get(name, {}).get("data", {"n_train": 384}))
        return train, crop(test, 0, 256) if name == "cascaded_tank" else test

    return generated


def _small_fit(fit: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *given: fit(*given, seeds=1, epochs=2, hidden=3, folds=0, quiet=True)


def _small_discovery(discover: Callable[..., Any]) -> Callable[..., Any]:
    def small(physics: pg.Physics, train: Record, test: Record, **named: Any) -> Any:
        if system_of(physics) == "arm":
            setup = set_up(physics, train, test, DiscoverySettings(), training_settings("pg_rssnn"), notify=print)
            check_setup(setup, print)
            return SimpleNamespace(physics=physics)
        return discover(physics, train, test, **{**named, **_CHEAP}, quiet=True)

    return small


def _short_search(filter_form: Callable[..., Any]) -> Callable[..., Any]:
    return lambda physics, train, tune: filter_form(physics, train, tune=2)
