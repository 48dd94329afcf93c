"""What `train.py` does around `pg.fit`: configuration -> plan -> run folder with checkpoints -> figures and page."""

import json
import shlex
import threading
import time
from collections.abc import Collection, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from pgrssnn_jax.api import finished
from pgrssnn_jax.cli.entry import Work
from pgrssnn_jax.cli.plan import Experiment, incomplete_config, load_experiment, plain_config
from pgrssnn_jax.cli.process import Interrupted
from pgrssnn_jax.cli.resume import key_of, override, resume_config, resumed_physics
from pgrssnn_jax.effects.stored import physics_to_json
from pgrssnn_jax.models.spec import VARIANTS
from pgrssnn_jax.physics.check import of_library
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.records.splits import by_dataset
from pgrssnn_jax.reports.tables import member_table, output_table, summary_table
from pgrssnn_jax.reports.write import yaml_text
from pgrssnn_jax.training.checkpoints import Checkpoint, CheckpointFolder
from pgrssnn_jax.training.choose import choose_settings, settled
from pgrssnn_jax.training.loop import Losses, losses_table, no_losses
from pgrssnn_jax.training.members import keys_of, map_members
from pgrssnn_jax.training.optimise import MemberState
from pgrssnn_jax.training.plan import Plan, member_tests, plan_training
from pgrssnn_jax.training.recipes import CHOSEN, DEFAULT, recipe_for
from pgrssnn_jax.training.run_folder import RunFolder, discard_if_empty, read_training_config, short_path
from pgrssnn_jax.training.settings import (
    changed,
    config_key,
    differing,
    settings_from_config,
    settings_to_config,
    training_settings,
)
from pgrssnn_jax.training.train import first_checkpoint, train_members


def prepare_training(config: DictConfig) -> Work:
    """Reads and checks everything; what it returns trains. Raises `ValueError` for bad input, and leaves nothing."""
    console = Console(stderr=False, highlight=False)
    started = time.perf_counter()
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    try:
        if config.resume:
            folder = Path(str(config.resume))
            asked = incomplete_config(config)
            settings = resume_config(asked, read_training_config(folder), hydra.overrides.task, folder)
            built = resumed_physics(settings, asked, folder)
        else:
            built = settings = plain_config(config)
        experiment, plan = plan_command(built, notify=console.print)
        run = RunFolder(folder)
        first = resumed(plan, run, experiment.test) if settings["resume"] else None
    finally:
        discard_if_empty(Path(hydra.runtime.output_dir))
    command = shlex.join(["python", f"{hydra.job.name}.py", *hydra.overrides.task])
    labels = {group: hydra.runtime.choices.get(group) for group in ("physics", "experiment", "budget")}
    seconds = {"load": time.perf_counter() - started}
    do = partial(
        train_run, settings, plan, experiment, first, run, console, command=command, labels=labels, seconds=seconds,
        typed=[*map(key_of, hydra.overrides.task)],
    )  # fmt: skip
    return Work(folder, do)


def plan_command(config: Mapping[str, Any], notify: Any) -> tuple[Experiment, Plan]:
    """The plan that `pg.fit` makes of the same physics, records and settings, with the test record checked too."""
    experiment = load_experiment(config, notify)
    plan = plan_training(experiment.physics, experiment.train, settings_from_config(config))
    member_tests(plan.fit.objective, plan.members, plan.units, plan.settings.run.report_n_init, experiment.test)
    return experiment, plan


def choose(
    config: Mapping[str, Any], experiment: Experiment, typed: Collection[str], stop: threading.Event, notify: Any
) -> tuple[dict[str, Any], Plan, float]:
    """The configuration and the plan with the settings that `recipe=auto` chooses, and the seconds that this took.
    typed: keys of the command line, which stay as they are. Raises `Interrupted` when stopped."""
    given = settings_from_config(config)
    discovered = experiment.physics.discovered
    own = recipe_for(experiment.train.info.benchmark)
    usual = training_settings(
        given.name if given.name in VARIANTS else given.model, DEFAULT.settings(discovered=discovered)
    )
    kept = own.split(discovered=discovered)[0]
    names = {*CHOSEN, *kept}
    held = {*differing(given, names, usual), *(name for name in names if config_key(name) in typed)}
    changes = {name: value for name, value in kept.items() if name not in held}
    chosen = choose_settings(
        experiment.physics, experiment.train, changed(given, changes), held, stop=stop, notify=notify
    )
    if chosen is None:
        raise Interrupted("stopped while the settings were chosen; nothing was written")
    said = settings_to_config(chosen.settings)
    config = {**config, **said, "data": {**config["data"], **said["data"]}, "recipe": chosen.report()}
    return config, plan_training(experiment.physics, experiment.train, chosen.settings), chosen.seconds


def resumed(plan: Plan, run: RunFolder, test: Record) -> Checkpoint:
    """Where the run in a folder stopped. Raises `ValueError` when it is not a run of this plan on this data."""
    like = jax.eval_shape(map_members(plan.fit.begin, plan.mapping), keys_of(plan.members), plan.data)
    with closing(CheckpointFolder(run.checkpoint, create=False)) as checkpoints:
        found = checkpoints.restore(Checkpoint(like, plan.data.scaling, plan.units, no_losses(len(plan.members))))
    run.check_data(_origins(plan, test))
    now, before = jax.tree.leaves((plan.data.scaling, plan.units)), jax.tree.leaves((found.scaling, found.units))
    if not all(np.allclose(a, b, rtol=1e-4) for a, b in zip(now, before, strict=True)):
        raise ValueError("resume: data: expected the scaling that the run began with, found that of other data")
    if found.losses.epochs > plan.fit.settings.epochs:
        raise ValueError(
            f"resume: fit.epochs: expected at least the {found.losses.epochs} already trained, "
            f"found {plan.fit.settings.epochs}"
        )
    return found


def _origins(plan: Plan, test: Record) -> dict[str, str]:
    records = {"train": plan.train, "validation": plan.validation, "test": by_dataset(test)}
    return {name: f"{record.info.source}: {record.info.origin}" for name, record in records.items()}


def train_run(
    config: Mapping[str, Any],
    plan: Plan,
    experiment: Experiment,
    first: Checkpoint | None,
    run: RunFolder,
    console: Console,
    stop: threading.Event,
    *,
    command: str,
    seconds: dict[str, float],
    typed: Collection[str],
    labels: Mapping[str, str | None] | None = None,
) -> None:
    """Chooses settings where the recipe is `auto`, trains from `first`, or from fresh members; evaluates, reports.
    stop: ends training after the current chunk.

    labels: names of the configuration's files; typed: keys of the command line. Raises `Interrupted` when stopped,
    after a checkpoint has been written.
    """
    test = experiment.test
    if config["recipe"] == "auto":
        config, plan, seconds["choose"] = choose(
            config, experiment, typed, stop, partial(console.print, soft_wrap=True)
        )
    console.print(_headline(config, plan), soft_wrap=True)
    if first is None and run.finished:
        console.print(f"replacing the earlier run in {short_path(run.path)}", soft_wrap=True)
    begun = first is None
    run.begin(
        yaml_text({**config, "resume": None}),
        command=command if begun else None,
        data=_origins(plan, test),
        choices=labels,
        physics=physics_to_json(plan.physics) if begun else None,
    )
    checkpoints = CheckpointFolder(run.checkpoint)
    if first is None:
        first = first_checkpoint(plan)
        checkpoints.save(first)  # from here on the run can be resumed, whatever ends it
    saved = time.perf_counter()

    def on_chunk(state: MemberState, losses: Losses, _: object) -> None:
        nonlocal saved
        if time.perf_counter() - saved > plan.fit.settings.checkpoint_seconds:
            checkpoints.save(first._replace(state=state, losses=losses))
            saved = time.perf_counter()

    plan = plan._replace(data=plan.data._replace(scaling=first.scaling))
    trained = train_members(plan, first, console, stop, on_chunk)
    state, recipe = trained.state, None
    if not trained.interrupted and isinstance(config["recipe"], Mapping):
        state, recipe = settled(plan, trained.state, config["recipe"])
    checkpoints.save(first._replace(state=state, losses=trained.losses))
    checkpoints.close()
    if trained.interrupted:
        run.write_csv("history.csv", losses_table(trained.losses, plan.members))
        own = [override("physics._target_", str(config["physics"]["_target_"]))] if not of_library(plan.physics) else []
        again = shlex.join(["python", "train.py", override("resume", short_path(run.path)), *own])
        raise Interrupted(
            f"stopped after epoch {trained.losses.epochs} of {plan.fit.settings.epochs}; continue with: {again}"
        )
    started = time.perf_counter()
    named = {**run.choices(), "data": config["data"]["name"]}
    ensemble = finished(plan, state, trained.losses, {**seconds, **trained.seconds}, labels=named, recipe=recipe)
    found = ensemble.evaluate(test)
    found.metrics["seconds"] |= {"evaluate": time.perf_counter() - started}
    found.metrics["seconds"]["total"] += found.metrics["seconds"]["evaluate"]
    ensemble.finish(run, found)
    metrics = json.loads((run.path / "metrics.json").read_text(encoding="utf-8"))
    console.print(member_table(metrics))
    if len(metrics["outputs"]) > 1:
        console.print(output_table(metrics))
    console.print(summary_table(metrics))
    console.print(f"run folder: {short_path(run.path)}   page: {short_path(run.path / 'report.html')}", soft_wrap=True)


def _headline(config: Mapping[str, Any], plan: Plan) -> str:
    info, mapping = plan.train.info, plan.mapping
    return (
        f"{plan.settings.name} on {config['data']['name']} ({info.source}: {info.origin}); "
        f"{len(plan.members)} members, {mapping.how} on {mapping.devices} {jax.default_backend()} device(s)"
    )
