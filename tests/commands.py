"""Running the commands as a user does, and composing their configuration without running them."""

import contextlib
import importlib
import io
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from rich.console import Console

from pgrssnn_jax.cli import entry
from pgrssnn_jax.cli.config_store import register
from pgrssnn_jax.cli.plan import plain_config
from pgrssnn_jax.cli.resume import key_of
from pgrssnn_jax.cli.train import plan_command, train_run
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.reports import write
from pgrssnn_jax.training.plan import Plan
from pgrssnn_jax.training.run_folder import RunFolder

ROOT = Path(__file__).parent.parent
QUICK = ["n_seeds=2", "fit.epochs=2", "fit.validate_every=1", "fit.chunk_epochs=1", "model.hidden=3"]


class Planned(NamedTuple):
    """A plan of the command, its training record as it was loaded, and its test record."""

    plan: Plan
    train: Record
    test: Record


def composed(*overrides: str, name: str = "train") -> dict:
    register()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return plain_config(compose(name, overrides=list(overrides)))


def config_names(group: str) -> list[str]:
    """What a group of the configuration can be, from files or from the package."""
    register()
    files = {path.stem for path in (ROOT / "conf" / group).glob("*.yaml")}
    store = ConfigStore.instance()
    registered = store.list(group) if group in store.repo else []
    return sorted(files | {name.removesuffix(".yaml") for name in registered})


def planned(*overrides: str, notify=lambda line: None) -> Planned:
    experiment, plan = plan_command(composed(*overrides), notify)
    return Planned(plan, experiment.train, experiment.test)


def trained(folder: Path, *overrides: str) -> RunFolder:
    run = RunFolder(folder)
    with (folder.parent / f"{folder.name}.log").open("w") as log:
        config = composed(*overrides)
        experiment, plan = plan_command(config, lambda line: None)
        train_run(
            config, plan, experiment, None, run, Console(file=log), threading.Event(),
            command="python train.py", seconds={}, typed=[*map(key_of, overrides)],
        )  # fmt: skip
    return run


@contextlib.contextmanager
def without_pictures() -> Iterator[None]:
    """For tests that look at none: drawing them takes as long as all the rest of a small run."""
    importlib.import_module("pgrssnn_jax.cli.report")  # it takes the function by name: what it draws is drawn
    with mock.patch.object(write, "save_figures", return_value={}):
        yield


def environment(**changes: str) -> dict[str, str]:
    """Without measured data and without a screen, whatever the machine has."""
    kept = {name: value for name, value in os.environ.items() if name != "PGRSSNN_DATA"}
    return {**kept, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1", "COLUMNS": "200", **changes}


def start(*arguments: str, cwd: Path, script: str = "train.py", **changes: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, str(ROOT / script), *arguments],
        cwd=cwd, env=environment(**changes), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def command(
    *arguments: str, cwd: Path, script: str = "train.py", seconds: float = 300, **changes: str
) -> tuple[int, str, str]:
    """Exit code, standard output and standard error."""
    process = start(*arguments, cwd=cwd, script=script, **changes)
    out, err = process.communicate(timeout=seconds)
    return process.returncode, out, err


def called(*arguments: str, cwd: Path, script: str = "train.py") -> tuple[int, str, str]:
    """The same without a process of its own, for what a command says once its configuration is composed."""
    module, logger = importlib.import_module(script.removesuffix(".py")), logging.getLogger()
    before, handlers, level = Path.cwd(), logger.handlers[:], logger.level
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", [str(ROOT / script), *arguments]),
        mock.patch.object(sys, "path", sys.path[:]),
        mock.patch.dict(os.environ, environment(HYDRA_MAIN_MODULE="__main__"), clear=True),  # paths from the file
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        os.chdir(cwd)
        try:
            entry.call(module.main)
            code = 0
        except SystemExit as ended:
            code = int(ended.code or 0)
        finally:
            os.chdir(before)
            logger.handlers[:] = handlers
            logger.setLevel(level)
    return code, out.getvalue(), err.getvalue()


def write_benchmark(path: Path, samples: int = 1024, seed: int = 0) -> Path:
    """A file of the cascaded-tanks layout with made-up smooth levels."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(1, 4, (2, samples // 16 + 1)), 16, axis=1)[:, :samples]
    y = np.array([np.convolve(3 * row, np.ones(30) / 30)[:samples] for row in u])
    rows = [f"{u[0, t]},{u[1, t]},{y[0, t]},{y[1, t]},{4 if t == 0 else ''}," for t in range(samples)]
    path.write_text('"uEst","uVal","yEst","yVal","Ts",\n' + "\n".join(rows) + "\n")
    return path
