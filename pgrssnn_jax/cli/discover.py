"""What `discover.py` does: configuration -> discovery -> run folder -> page."""

import json
import shlex
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from pgrssnn_jax.cli.entry import Interrupted
from pgrssnn_jax.cli.plan import plain
from pgrssnn_jax.discovery.card import discovery_arrays, discovery_json
from pgrssnn_jax.discovery.network import network_shares, plan_network
from pgrssnn_jax.discovery.setup import Setup, set_up
from pgrssnn_jax.discovery.workflow import check_free_run, discover
from pgrssnn_jax.reports.discovery_summary import discovery_summary
from pgrssnn_jax.reports.discovery_write import write_discovery_report
from pgrssnn_jax.training.run_folder import RunFolder, discard_if_empty, short_path


def prepare_discovery(config: DictConfig) -> Callable[[threading.Event], None]:
    """Reads and checks everything; what it returns discovers. Raises `ValueError` for bad input, and leaves nothing."""
    console = Console(highlight=False)
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    started = time.perf_counter()
    try:
        setup = checked(plain(config), console.print)
    finally:
        discard_if_empty(folder)
    command = shlex.join(["python", f"{hydra.job.name}.py", *hydra.overrides.task])
    loading = time.perf_counter() - started
    return partial(discovery_run, setup, RunFolder(folder), console, command=command, seconds={"load": loading})


def checked(config: Mapping[str, Any], notify: Callable[[str], None]) -> Setup:
    """Everything that could turn out to be bad input later is tried. Raises `ValueError`."""
    setup = set_up(config, notify)
    check_free_run(setup)
    if setup.settings.network_epochs:
        plan_network(setup, None)
    return setup


def discovery_run(
    setup: Setup,
    run: RunFolder,
    console: Console,
    stop: threading.Event,
    *,
    command: str,
    seconds: dict[str, float],
) -> None:
    """Discovers, writes the folder, shows the summary. Raises `Interrupted` between the steps when asked to stop."""
    info = setup.estimation.info
    console.print(
        f"discovery on {setup.config['data']['name']} ({info.source}: {info.origin}); "
        f"{setup.estimation.u.shape[0]} sequence(s) of {setup.estimation.u.shape[1]} samples to learn from",
        soft_wrap=True,
    )
    found = discover(setup, partial(_progress, console, stop))
    said = discovery_json(found, setup, command=command)
    origins = {
        name: f"{r.info.source}: {r.info.origin}" for name, r in (("train", setup.estimation), ("test", setup.test))
    }
    run.begin(OmegaConf.to_yaml(OmegaConf.create(setup.config)), command=command, data=origins)
    run.write_arrays("discovery.npz", discovery_arrays(found, setup))
    run.write_json("discovery.json", said)
    started = time.perf_counter()
    if setup.settings.network_epochs and found.found.final.estimate.active:
        effects = str(run.path / "discovery.json")
        said["network"] = network_shares(setup, effects, partial(_progress, console, stop), stop)
        said["seconds"]["network"] = time.perf_counter() - started
    said["seconds"] = {**seconds, **said["seconds"]}
    said["seconds"]["total"] = sum(said["seconds"].values())
    run.write_json("discovery.json", said)
    write_discovery_report(run)
    run.finish()
    console.print(discovery_summary(json.loads((run.path / "discovery.json").read_text(encoding="utf-8"))))
    console.print(f"run folder: {short_path(run.path)}   page: {short_path(run.path / 'report.html')}", soft_wrap=True)


def _progress(console: Console, stop: threading.Event, line: str) -> None:
    if stop.is_set():
        raise Interrupted("stopped; discovery cannot be resumed, start it again")
    console.print(line, soft_wrap=True)
