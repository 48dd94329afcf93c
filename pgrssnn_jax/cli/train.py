"""What the commands do.

train   configuration -> plan (all bad input) -> members trained -> predictions -> metrics -> run folder -> report
"""

import shlex
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from pgrssnn_jax.cli.entry import Interrupted
from pgrssnn_jax.cli.plan import Plan, loose, plain, plan_training
from pgrssnn_jax.cli.resume import override, resume_config
from pgrssnn_jax.reports.prediction import compared
from pgrssnn_jax.reports.tables import member_table, output_table, summary_table
from pgrssnn_jax.reports.write import write_report
from pgrssnn_jax.training import evaluation as evaluate
from pgrssnn_jax.training.checkpoints import Checkpoint, CheckpointFolder
from pgrssnn_jax.training.loop import Losses, Training, losses_table, no_losses, progress, train
from pgrssnn_jax.training.members import jit_members, keys_of, map_members
from pgrssnn_jax.training.optimise import MemberState
from pgrssnn_jax.training.progress import training_bar
from pgrssnn_jax.training.run_folder import RunFolder, discard_if_empty, read_config, short_path


def prepare_training(config: DictConfig) -> Callable[[threading.Event], None]:
    """Reads and checks everything; what it returns trains. Raises `ValueError` for bad input, and leaves nothing."""
    console = Console(stderr=False, highlight=False)
    started = time.perf_counter()
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    try:
        if config.resume:
            folder = Path(str(config.resume))
            settings = resume_config(loose(config), read_config(folder), hydra.overrides.task, folder)
        else:
            settings = plain(config)
        plan = plan_training(settings, notify=console.print)
        first = resumed(plan, RunFolder(folder)) if plan.config["resume"] else None
    finally:
        discard_if_empty(Path(hydra.runtime.output_dir))
    command = shlex.join(["python", f"{hydra.job.name}.py", *hydra.overrides.task])
    choices = {group: hydra.runtime.choices.get(group) for group in ("physics", "experiment", "budget")}
    seconds = {"load": time.perf_counter() - started}
    return partial(
        train_run, plan, first, RunFolder(folder), console, command=command, choices=choices, seconds=seconds
    )


def resumed(plan: Plan, run: RunFolder) -> Checkpoint:
    """Where the run in a folder stopped. Raises `ValueError` when it is not a run of this plan on this data."""
    like = jax.eval_shape(map_members(plan.fit.begin, plan.mapping), keys_of(plan.members), plan.data)
    checkpoints = CheckpointFolder(run.checkpoint, create=False)
    try:
        found = checkpoints.restore(Checkpoint(like, plan.data.scaling, plan.units, no_losses(len(plan.members))))
    finally:
        checkpoints.close()
    run.check_data(_origins(plan))
    now, before = jax.tree.leaves((plan.data.scaling, plan.units)), jax.tree.leaves((found.scaling, found.units))
    if not all(np.allclose(a, b, rtol=1e-4) for a, b in zip(now, before, strict=True)):
        raise ValueError("resume: data: expected the scaling that the run began with, found that of other data")
    if found.losses.epochs > plan.fit.settings.epochs:
        raise ValueError(
            f"resume: fit.epochs: expected at least the {found.losses.epochs} already trained, "
            f"found {plan.fit.settings.epochs}"
        )
    return found


def _origins(plan: Plan) -> dict[str, str]:
    records = zip(plan.splits._fields, plan.splits, strict=True)
    return {name: f"{record.info.source}: {record.info.origin}" for name, record in records}


def train_run(
    plan: Plan,
    first: Checkpoint | None,
    run: RunFolder,
    console: Console,
    stop: threading.Event,
    *,
    command: str,
    seconds: dict[str, float],
    choices: Mapping[str, str | None] | None = None,
) -> None:
    """Trains from `first`, or from fresh members; evaluates, reports. stop: ends training after the current chunk.

    choices: names of the configuration's files. Raises `Interrupted` when stopped, after a checkpoint has been written.
    """
    console.print(_headline(plan), soft_wrap=True)
    if first is None and run.finished:
        console.print(f"replacing the earlier run in {short_path(run.path)}", soft_wrap=True)
    config_text = OmegaConf.to_yaml(OmegaConf.create({**plan.config, "resume": None}))
    run.begin(config_text, command=command if first is None else None, data=_origins(plan), choices=choices)
    checkpoints = CheckpointFolder(run.checkpoint)
    if first is None:
        begun = jit_members(plan.fit.begin, plan.mapping)(keys_of(plan.members), plan.data)
        first = Checkpoint(begun, plan.data.scaling, plan.units, no_losses(len(plan.members)))
        checkpoints.clear()
        checkpoints.save(first)  # from here on the run can be resumed, whatever ends it
    plan = plan._replace(data=plan.data._replace(scaling=first.scaling))
    trained = _train(plan, first, checkpoints, console, stop)
    checkpoints.save(first._replace(state=trained.state, losses=trained.losses))
    checkpoints.close()
    history = losses_table(trained.losses, pd.DataFrame(plan.members))
    run.write_csv("history.csv", history)
    if trained.interrupted:
        raise Interrupted(
            f"stopped after epoch {trained.losses.epochs} of {plan.fit.settings.epochs}; "
            f"continue with: python train.py {shlex.quote(override('resume', short_path(run.path)))}"
        )
    metrics, arrays = _evaluated(plan, trained.state, run.choices(), {**seconds, **trained.seconds})
    run.write_arrays("predictions.npz", arrays)
    run.write_json("metrics.json", metrics)
    write_report(run)
    run.finish()
    console.print(member_table(metrics))
    if len(metrics["outputs"]) > 1:
        console.print(output_table(metrics))
    console.print(summary_table(metrics))
    console.print(f"run folder: {short_path(run.path)}   page: {short_path(run.path / 'report.html')}", soft_wrap=True)


def _headline(plan: Plan) -> str:
    info, mapping = plan.splits.train.info, plan.mapping
    return (
        f"{plan.config['model']['name']} on {plan.config['data']['name']} ({info.source}: {info.origin}); "
        f"{len(plan.members)} members, {mapping.how} on {mapping.devices} {jax.default_backend()} device(s)"
    )


def _train(
    plan: Plan, first: Checkpoint, checkpoints: CheckpointFolder, console: Console, stop: threading.Event
) -> Training:
    """Training with a progress bar, and a checkpoint every `fit.checkpoint_seconds`."""
    saved = time.perf_counter()

    with training_bar(console, plan.fit.settings.epochs) as show:
        if first.losses.epochs:
            show(progress(first.state, first.losses, plan.fit.settings))

        def on_chunk(state: MemberState, losses: Losses, now: Any) -> None:
            nonlocal saved
            show(now)
            if time.perf_counter() - saved > plan.fit.settings.checkpoint_seconds:
                checkpoints.save(first._replace(state=state, losses=losses))
                saved = time.perf_counter()

        return train(plan.fit, plan.mapping, first.state, plan.data, first.losses, on_chunk=on_chunk, stop=stop)


def _evaluated(
    plan: Plan, state: MemberState, choices: Mapping[str, str | None], seconds: dict[str, float]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """`metrics.json` and the arrays of `predictions.npz`, both in measured units."""
    started = time.perf_counter()
    predictions = evaluate.predict(plan.fit.objective, state, plan.data, plan.test, plan.mapping)
    predictions = evaluate.in_physical_units(predictions, plan.units)
    datasets = np.array([member.dataset for member in plan.members])
    test, validation = plan.measured.test, plan.measured.validation
    rows = evaluate.member_rows(
        plan.members, state, predictions, validation=validation, test=test, n_inits=plan.report_n_init
    )
    mean, deviation = evaluate.ensemble(rows, test, predictions)
    info, physics = test.info, plan.fit.objective.model.physics
    seconds = {**seconds, "evaluate": time.perf_counter() - started}
    metrics = {
        "schema": 1,
        "system": physics.name,
        "physics": choices.get("physics") or physics.name,
        "experiment": choices.get("experiment"),
        "budget": choices.get("budget"),
        "model": plan.config["model"]["name"],
        "data": plan.config["data"]["name"],
        "source": info.source,
        "origin": info.origin,
        "n_init": plan.report_n_init[0],
        "n_train": plan.measured.train.u.shape[2],
        "dt": physics.dt,
        "outputs": [channel._asdict() for channel in info.outputs],
        "members": rows,
        "summary": evaluate.summary(rows, test, mean, plan.report_n_init),
        "seconds": {**seconds, "total": sum(seconds.values())},
    }
    arrays = {
        "y": test.y[0],
        "u": test.u[0],
        "mask": test.mask[0],
        "y_hat": predictions.test.astype(np.float32),
        "ensemble_mean": mean,
        "ensemble_std": deviation,
        "seed": np.array([member.seed for member in plan.members]),
        "dataset": datasets,
        "x0": predictions.x0,
    }
    if physics.skeleton is not None:
        poses = {
            "measured": np.where(test.mask[0], test.y[0], np.nan),
            "predicted": compared(arrays, metrics).mean,
        }
        arrays |= {f"skeleton_{name}": physics.skeleton(y).astype(np.float32) for name, y in poses.items()}
    return metrics, arrays
