"""A finished run on disk, and what reading it does."""

import json
import shutil
from pathlib import Path

import yaml
from sentences import U, record, tanks

import pgrssnn_jax as pg


def save(folder: Path, **settings: object) -> Path:
    """The tanks alone, which compile fast, without a page; `metrics.json` has the keys that loading reads."""
    usual = {"initial_state": "zero", "recipe": "default", "epochs": 0, "quiet": True}
    pg.fit("physics_only", tanks(), record(), **{**usual, **settings}).save(folder)
    metrics = {"members": [{"seed": 0, "dataset": 0}], "seconds": {"train": 1.0}, "n_train": 120}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    return folder


def copied(run: Path, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    return Path(shutil.copytree(run, folder))


def use(folder: Path) -> None:
    """Reads a run as a user would who has nothing else."""
    repr(pg.load(folder).simulate(U[:5]))


def change_json(path: Path, *place: str | int, value: object) -> None:
    found = json.loads(path.read_text())
    path.write_text(json.dumps(_with(found, place, value)))


def change_yaml(path: Path, *place: str | int, value: object) -> None:
    found = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(_with(found, place, value)))


def _with(found: object, place: tuple, value: object) -> object:
    if not place:
        return value
    inner = found
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return found
