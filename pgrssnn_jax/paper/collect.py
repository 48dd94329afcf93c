"""Every run below some folders: what it was, how it ended, and what it found.

Nothing is left out: a folder without `DONE`, with `FAILED`, or with files that cannot be read is a run with a reason.
What a run was stands in its metrics; where it never came to any, its configuration, its command or the name of its
folder say so (`data.n_train=128,model=rssnn`).
"""

import json
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pgrssnn_jax.paper.published import Paper, Variant
from pgrssnn_jax.reports.content import Metrics
from pgrssnn_jax.training.run_folder import RunFolder, read_config

MARKS = {"config.yaml", "metrics.json", "DONE", "FAILED"}
MERITS = ("rmse", "nrmse", "cc")
LONGEST_REASON = 300  # characters
_NAMES = ("experiment", "budget", "model", "physics", "data.n_train", "sweep", "resume")  # have a place of their own


class FoundRun(NamedTuple):
    """One run folder. name: its path below the folder that was asked for; planned: members, None where nothing says so;
    budget: None where nothing was capped; overrides: the rest of what was asked for; metrics: None unless finished."""

    path: Path
    name: str
    state: Literal["finished", "failed", "unfinished", "damaged"]
    reason: str
    experiment: str | None
    budget: str | None
    system: str
    variant: Variant
    planned: int | None
    overrides: Mapping[str, str]
    metrics: Metrics | None
    environment: Mapping[str, Any]


def collect(roots: Sequence[Path], paper: Paper) -> list[FoundRun]:
    """The runs below `roots`, every folder once, in the order of their names.

    Raises `ValueError` when there is none, or none that can be read.
    """
    places = {path.resolve(): (path, root) for root in roots for path in run_folders(root)}
    found = (read_run(path, _below(path, root), paper) for path, root in places.values())
    runs = [run for run in found if run is not None]
    if not runs:
        where = ", ".join(map(str, roots))
        raise ValueError(f"runs: expected a folder with runs of train.py, found none below {where}")
    if all(run.state == "damaged" for run in runs):
        raise ValueError(f"runs: expected a run that can be read, found {runs[0].name}: {runs[0].reason}")
    return runs


def run_folders(root: Path) -> Iterator[Path]:
    """Folders that a run left something in; what stands inside them is theirs."""
    for folder, inside, files in os.walk(root):
        inside[:] = sorted(name for name in inside if not name.startswith("."))
        if MARKS.intersection(files):
            inside.clear()
            yield Path(folder)


def _below(path: Path, root: Path) -> str:
    return str(Path(root.resolve().name) / path.relative_to(root))


def read_run(path: Path, name: str, paper: Paper) -> FoundRun | None:
    """None for a run of discover.py."""
    config = _kept(lambda: read_config(path))
    environment = _kept(lambda: RunFolder(path).read_json("environment.json"))
    if "discovery" in config or (path / "discovery.json").exists():
        return None
    state, reason, metrics = _ending(path)
    found, overrides = metrics or {}, _overrides(path, environment)
    said = {**overrides, **_given(environment.get("choices") or {}), **_given(found)}
    if "experiment" not in found:
        said |= _sweep(path.resolve().parent.name, paper)
    known = paper.experiments.get(said.get("experiment") or "")
    data, model = (_group(config, group) for group in ("data", "model"))
    system = found.get("data") or data.get("name") or (known.system if known else "")
    usual = paper.systems.get(system)
    physics = said.get("physics") or (usual.physics if usual else found.get("system", ""))
    trained_on = _number(overrides.get("data.n_train"))
    if trained_on is None and usual and usual.n_train is not None:
        trained_on = _number(found.get("n_train")) or _number(data.get("n_train")) or usual.n_train
    variant = Variant(found.get("model") or model.get("name") or said.get("model") or "", physics, trained_on)
    return FoundRun(
        path=path,
        name=name,
        state=state,
        reason=reason,
        experiment=said.get("experiment"),
        budget=None if said.get("budget") == "paper" else said.get("budget"),
        system=system,
        variant=variant,
        planned=max(found["summary"]["planned"], len(found["members"])) if found else _planned(config),
        overrides={k: v for k, v in overrides.items() if k not in _NAMES and not k.startswith("hydra.")},
        metrics=metrics,
        environment=environment,
    )


def _given(named: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in named.items() if value}


def _sweep(folder: str, paper: Paper) -> dict[str, str | None]:
    """Experiment and budget from the name that a sweep's folder has unless the user gave it another."""
    for name in paper.experiments:
        if folder == name or folder.startswith(f"{name}_"):
            return {"experiment": name, "budget": folder[len(name) + 1 :] or None}
    return {}


def _ending(path: Path) -> tuple[Literal["finished", "failed", "unfinished", "damaged"], str, Metrics | None]:
    """How the run ended, why, and its metrics where it finished."""
    if (path / "DONE").exists():
        try:
            return "finished", "", read_metrics(path / "metrics.json")
        except ValueError as problem:
            return "damaged", str(problem), None
    if (path / "FAILED").exists():
        lines = (path / "FAILED").read_text(encoding="utf-8", errors="replace").split("\n")
        return "failed", lines[0].strip()[:LONGEST_REASON] or "no reason given", None
    return "unfinished", "stopped or still running, there is no DONE", None


def read_metrics(path: Path) -> Metrics:
    """`metrics.json`, checked as far as the tables need it. Raises `ValueError`."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path.name}: expected one beside DONE, found none") from None
    except (UnicodeDecodeError, json.JSONDecodeError) as problem:
        raise ValueError(f"{path.name}: expected JSON, found {problem}") from problem
    try:
        if found["schema"] != 1:
            raise ValueError(f"{path.name}: schema: expected 1, found {found['schema']!r}")
        texts = [found[name] for name in ("system", "model", "data", "source")]
        counts = [found["n_init"], found["summary"]["planned"]]
        counts += [member[name] for member in found["members"] for name in ("seed", "dataset")]
        tests = [member["test"] for member in found["members"] if member["status"] == "ok"]
        figures = [value for test in tests for name in MERITS for value in test[name]]
        complete = [len(test[name]) == len(found["outputs"]) > 0 for test in tests for name in MERITS]
        figures.append(found["seconds"].get("total"))
        good = all(isinstance(text, str) for text in texts) and all(type(count) is int for count in counts)
        good &= all(value is None or type(value) in (int, float) for value in figures) and all(complete)
    except (KeyError, TypeError, AttributeError) as problem:
        raise ValueError(f"{path.name}: expected the form of a run's metrics, found no {problem}") from problem
    if not good:
        raise ValueError(f"{path.name}: expected the form of a run's metrics, found values of another kind")
    return found


def _kept(read: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What a file holds; nothing where it is missing or damaged."""
    try:
        return read()
    except ValueError:
        return {}


def _overrides(path: Path, environment: Mapping[str, Any]) -> dict[str, str]:
    """What was asked for: from the command, or from the folder's name, of which a long one ends in a hash behind ~."""
    command = environment.get("command")
    try:
        words = shlex.split(command)[2:] if command else path.name.partition("~")[0].split(",")
    except ValueError:
        words = []
    return dict(word.lstrip("+").split("=", 1) for word in words if "=" in word)


def _group(config: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    return group if isinstance(group := config.get(name), Mapping) else {}


def _planned(config: Mapping[str, Any]) -> int | None:
    """Members that a configuration asks for: every dataset with every seed, and one seed where no network is drawn."""
    seeds, datasets = _number(config.get("n_seeds")), _number(_group(config, "data").get("realisations", 1))
    if seeds is None or datasets is None:
        return None
    return datasets * (seeds if _group(config, "model").get("networks", True) else 1)


def _number(value: Any) -> int | None:
    try:
        return int(value)
    except (TypeError, ValueError):
        return None
