"""Folders made by others: whatever stands in them, pg.load, resume= and report.py read it and execute nothing."""

import json
import os
import pickle
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from pydoc import locate
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from commands import QUICK, called, trained, without_pictures, write_benchmark
from omegaconf import OmegaConf

from pgrssnn_jax.results.ensemble import Ensemble
from pgrssnn_jax.results.saved import load

MARK = "struck"  # the file that whatever is executed leaves in the current folder
SHELL = f"echo struck >> {MARK}"


class Bomb:
    """A pickle that runs a command as soon as it is loaded."""

    def __reduce__(self) -> tuple:
        return os.system, (SHELL,)


class Trap(NamedTuple):
    """set: changes a run folder; spring: executes what is hidden there, as a careless reader would."""

    set: Callable[[Path], object]
    spring: Callable[[Path], object]


def config_of(run: Path) -> dict:
    return yaml.safe_load((run / "config.yaml").read_text())


def with_config(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def set_trap(run: Path) -> None:
        config = config_of(run)
        change(config)
        (run / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))

    return set_trap


def with_json(name: str, change: Callable[[dict], object]) -> Callable[[Path], None]:
    def set_trap(run: Path) -> None:
        found = json.loads((run / name).read_text())
        change(found)
        (run / name).write_text(json.dumps(found))

    return set_trap


def instantiated(group: dict) -> object:
    function: Any = locate(group["_target_"])
    return function(**{name: value for name, value in group.items() if name not in ("_target_", "effects")})


def built_by(*groups: str) -> Callable[[Path], object]:
    def spring(run: Path) -> object:
        node = config_of(run)
        for group in groups:
            node = node[group]
        return instantiated(node)

    return spring


def pickled(name: str) -> Trap:
    return Trap(
        lambda run: (run / name).write_bytes(pickle.dumps(Bomb())),
        lambda run: pickle.loads((run / name).read_bytes()),
    )


def write_bomb_arrays(run: Path) -> None:
    np.savez(run / "predictions.npz", x0_train=np.array([Bomb()], dtype=object), y=np.array([Bomb()], dtype=object))


def set_bombs_in_checkpoint(run: Path) -> None:
    for path in (run / "checkpoint").rglob("*"):
        if path.is_file():
            path.write_bytes(pickle.dumps(Bomb()))


def point_to_a_bomb(run: Path) -> None:
    data = run / "data.csv"
    data.write_bytes(pickle.dumps(Bomb()))
    with_config(lambda c: c["data"].update(path=str(data)))(run)


def effects_of_ones_own(run: Path) -> None:
    with_json("physics.json", lambda p: p["numbers"]["effects"].update({"evil.effect": {}}))(run)
    with_config(lambda c: c.update(discovery={"effects": ["evil.effect"]}))(run)


def physics_by(target: str, **settings: str) -> Callable[[Path], None]:
    """In the configuration and in `physics.json`."""

    def set_trap(run: Path) -> None:
        with_config(lambda c: c.update(physics={"_target_": target, **settings}))(run)
        with_json("physics.json", lambda p: p.update(physics={"_target_": target, **settings}))(run)

    return set_trap


def physics_named_by(run: Path) -> object:
    return instantiated(json.loads((run / "physics.json").read_text())["physics"])


def read_array(run: Path) -> object:
    return np.load(run / "predictions.npz", allow_pickle=True)["y"]


TAGGED = f'physics: !!python/object/apply:os.system ["{SHELL}"]\n'

TRAPS = {
    "os.system as physics": Trap(physics_by("os.system", command=SHELL), built_by("physics")),
    "a module beside the folder": Trap(physics_by("evil.physics"), built_by("physics")),
    "a name that begins like the package's": Trap(
        physics_by("pgrssnn_jax.training.run_folder.os.system", command=SHELL), built_by("physics")
    ),
    "physics.json alone": Trap(
        with_json("physics.json", lambda p: p.update(physics={"_target_": "evil.physics"})), physics_named_by
    ),
    "no physics.json": Trap(
        lambda run: (physics_by("evil.physics")(run), (run / "physics.json").unlink()), built_by("physics")
    ),
    "a model and settings with targets": Trap(
        with_config(
            lambda c: [
                c[group].update(trap={"_target_": "evil.physics"}) for group in ("model", "fit", "members", "data")
            ]
        ),
        built_by("fit", "trap"),
    ),
    "hydra in the configuration": Trap(
        with_config(lambda c: c.update(hydra={"launcher": {"_target_": "evil.physics"}})), built_by("hydra", "launcher")
    ),
    "an interpolation": Trap(
        with_config(lambda c: c["data"].update(path="${strike:}")),
        lambda run: OmegaConf.to_container(OmegaConf.load(run / "config.yaml"), resolve=True),
    ),
    "a tag of YAML": Trap(
        lambda run: (run / "config.yaml").write_text(TAGGED),
        lambda run: yaml.unsafe_load((run / "config.yaml").read_text()),
    ),
    "an effect of another module": Trap(
        effects_of_ones_own, lambda run: locate(config_of(run)["discovery"]["effects"][0])
    ),
    "pickled arrays": Trap(write_bomb_arrays, read_array),
    "a pickled checkpoint": Trap(
        set_bombs_in_checkpoint,
        lambda run: [pickle.loads(p.read_bytes()) for p in (run / "checkpoint").rglob("*") if p.is_file()],
    ),
    "pickled physics": pickled("physics.json"),
    "pickled metrics": pickled("metrics.json"),
    "a pickled environment": pickled("environment.json"),
    "pickled data": Trap(point_to_a_bomb, lambda run: pickle.loads((run / "data.csv").read_bytes())),
}


@pytest.fixture(autouse=True, scope="module")
def no_pictures() -> Iterator[None]:
    with without_pictures():
        yield


@pytest.fixture(scope="module")
def harmless(tmp_path_factory) -> Path:
    """A finished run that nobody has changed."""
    folder = tmp_path_factory.mktemp("harmless")
    tanks = write_benchmark(folder / "tanks.csv", samples=80)
    base = ["+experiment=cascaded_tank", f"data.path={tanks}", "data.n_validation=20", "model=physics_only"]
    return trained(folder / "run", *base, *QUICK).path


@pytest.fixture
def folder(tmp_path, monkeypatch, harmless) -> Iterator[Path]:
    """A copy of the run below the current folder, beside a module that strikes when it is imported or called."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "evil.py").write_text(
        f"def strike(*_, **__):\n    with open({str(tmp_path / MARK)!r}, 'a') as file:\n"
        "        file.write('struck\\n')\n\nstrike()\nphysics = effect = strike\n"
    )
    OmegaConf.register_new_resolver("strike", lambda: os.system(SHELL), replace=True)
    shutil.copytree(harmless, tmp_path / "runs/hostile")
    yield tmp_path / "runs/hostile"
    OmegaConf.clear_resolver("strike")
    sys.modules.pop("evil", None)


@pytest.mark.parametrize("name", TRAPS)
def test_every_trap_springs_for_a_careless_reader(folder, name):
    """So that the next test says something."""
    TRAPS[name].set(folder)
    assert not Path(MARK).exists()
    TRAPS[name].spring(folder)
    assert Path(MARK).read_text().startswith("struck")


LIKE_OTHERS = {
    "a module beside the folder", "a model and settings with targets", "pickled physics", "pickled metrics",
    "a pickled environment", "no physics.json", "a tag of YAML",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LIKE_OTHERS else []) for name in TRAPS]
)
def test_nothing_that_came_with_a_folder_is_executed(folder, name):
    TRAPS[name].set(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for partial in (False, True):
        try:
            assert isinstance(load(folder, partial=partial), Ensemble)
        except ValueError as problem:
            assert "\n" not in str(problem)  # noqa: PT017 - reading it without an error is as good
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    said = [
        called("runs=runs", "out=evidence", cwd=Path.cwd(), script="report.py"),
        called(f"resume={folder}", cwd=Path.cwd()),
    ]
    assert not Path(MARK).exists()
    assert "evil" not in sys.modules
    for code, _, err in said:
        assert code in (0, 2)
        assert "Traceback" not in err
        assert (err.count("\n") >= 1) == (code == 2)


def test_a_variable_of_this_machine_is_not_read_for_a_folder(folder, monkeypatch, capsys):
    monkeypatch.setenv("SECRET", "swordfish")
    with_config(lambda c: c["data"].update(path="${oc.env:SECRET}"))(folder)
    load(folder)
    said = [called(f"resume={folder}", cwd=Path.cwd()), called("runs=runs", cwd=Path.cwd(), script="report.py")]
    written = [path.read_bytes() for path in Path("runs").rglob("*") if path.is_file()]
    assert not any("swordfish" in text for _, out, err in said for text in (out, err))
    assert not any(b"swordfish" in content for content in written)
    assert "swordfish" not in "".join(capsys.readouterr())


def test_the_names_in_a_folder_are_text_on_the_page(folder):
    script = "<script>strike()</script>"
    with_json("metrics.json", lambda m: m.update(model=script, system=script, origin=script, experiment=script))(folder)
    (folder / "FAILED").write_text(script)
    code, _, err = called("runs=runs", "out=evidence", cwd=Path.cwd(), script="report.py")
    assert code == 0, err
    assert script not in Path("evidence/report.html").read_text()


def test_a_module_is_imported_only_when_its_owner_trusts_it(folder):
    physics_by("evil.physics")(folder)
    with pytest.raises(ValueError, match=r"expected the physics of one's own .* found 'evil.physics' in the folder"):
        load(folder, trust=["evil_too", "evil.physics"])
    assert not Path(MARK).exists()
    code, _, err = called(f"resume={folder}", "physics._target_=evil.other", cwd=Path.cwd())
    assert code == 2
    assert "resume: physics._target_: expected" in err
    assert not Path(MARK).exists()
    with pytest.raises(ValueError, match="evil"):
        load(folder, trust=["evil"])
    assert Path(MARK).exists()


DAMAGES = {
    "broken YAML": lambda run: (run / "config.yaml").write_text("a: [1"),
    "an empty configuration": lambda run: (run / "config.yaml").write_text(""),
    "a configuration without data": with_config(lambda c: c.pop("data")),
    "a configuration without settings": with_config(lambda c: c.pop("fit")),
    "a text in place of settings": with_config(lambda c: c.update(fit="fast")),
    "a configuration that is no text": lambda run: (run / "config.yaml").write_bytes(b"\xff\xfe\x00"),
    "members that are none": with_json("metrics.json", lambda m: m.update(members=[1])),
    "half a physics": lambda run: (run / "physics.json").write_text("{}"),
    "no checkpoint": lambda run: shutil.rmtree(run / "checkpoint"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_folder_is_one_sentence_that_names_it(folder, name):
    DAMAGES[name](folder)
    with pytest.raises(ValueError, match=r"runs/hostile") as problem:
        load(folder)
    assert "\n" not in str(problem.value)
