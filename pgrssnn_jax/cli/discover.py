"""What `discover.py` does around `pg.discover`: configuration -> discovery -> run folder -> page."""

import shlex
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from pgrssnn_jax.api import check_setup, discovered
from pgrssnn_jax.cli.entry import Work
from pgrssnn_jax.cli.plan import load_experiment, own_effects, plain_config
from pgrssnn_jax.cli.process import Interrupted, ended_at_once
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup, set_up
from pgrssnn_jax.records.arguments import call_with
from pgrssnn_jax.reports.discovery_tables import discovery_summary
from pgrssnn_jax.reports.write import yaml_text
from pgrssnn_jax.training.run_folder import RunFolder, discard_if_empty, short_path
from pgrssnn_jax.training.settings import settings_from_config

_STOPPED = "stopped; discovery cannot be resumed, start it again"


def prepare_discovery(config: DictConfig) -> Work:
    """Reads and checks everything; what it returns discovers. Raises `ValueError` for bad input, and leaves nothing."""
    console = Console(highlight=False)
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    started = time.perf_counter()
    try:
        settings = plain_config(config)
        setup, motion = checked(settings, console.print)
    finally:
        discard_if_empty(folder)
    command = shlex.join(["python", f"{hydra.job.name}.py", *hydra.overrides.task])
    seconds = time.perf_counter() - started
    return Work(folder, partial(discovery_run, settings, setup, motion, RunFolder(folder), console, command, seconds))


def checked(config: Mapping[str, Any], notify: Callable[[str], None]) -> tuple[Setup, Motion | None]:
    """What `discovered` needs. Everything that could turn out to be bad input later is tried. Raises `ValueError`."""
    settings = call_with(DiscoverySettings, config["discovery"], "discovery")
    settings = replace(settings, accelerate=settings.accelerate and config["accelerate"])
    if config["resume"] is not None:
        raise ValueError(f"resume: expected null, because a discovery cannot be resumed, found {config['resume']!r}")
    of_training = {key: value for key, value in config.items() if key != "realisation"}
    physics, train, test = load_experiment(of_training, lambda line: None)
    setup = set_up(
        physics, train, test, settings, settings_from_config(config),
        effects=own_effects(settings.effects, physics), realisation=config["realisation"], notify=notify,
    )  # fmt: skip
    return setup, check_setup(setup, notify)


def discovery_run(
    config: Mapping[str, Any],
    setup: Setup,
    motion: Motion | None,
    run: RunFolder,
    console: Console,
    command: str,
    seconds: float,
    stop: threading.Event,
) -> None:
    """Discovers, writes the folder, shows the summary. Raises `Interrupted` when asked to stop before it writes."""
    info = setup.estimation.info
    console.print(
        f"discovery on {config['data']['name']} ({info.source}: {info.origin}); "
        f"{setup.estimation.u.shape[0]} sequence(s) of {setup.estimation.u.shape[1]} samples in the estimation record",
        soft_wrap=True,
    )
    with ended_at_once(stop, _STOPPED):
        found = discovered(setup, motion, partial(_progress, console, stop), stop, command=command, seconds=seconds)
    found.write(run, yaml_text(config), command)
    console.print(discovery_summary(found.details))
    console.print(f"run folder: {short_path(run.path)}   page: {short_path(run.path / 'report.html')}", soft_wrap=True)


def _progress(console: Console, stop: threading.Event, line: str) -> None:
    if stop.is_set():
        raise Interrupted(_STOPPED)
    console.print(line, soft_wrap=True)
