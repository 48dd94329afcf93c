"""The Python API: train on a physics and a record, discover missing effects, simulate, save and load.

    train, test = load_benchmark("cascaded_tank")
    ensemble = fit("pg_rssnn", physics.cascaded_tanks(clamp=True), train);     ensemble.score(test)
    found = discover(physics.cascaded_tanks(), train, test);                   found.physics

No function writes a file unless it is asked to. Bad input raises `ValueError` with one sentence that names the input,
its place, the expected value and the value found.
"""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import jax
import numpy as np
from rich.console import Console

from pgrssnn_jax.acceleration.devices import keep_compiled
from pgrssnn_jax.data.arm_log import load_arm_log as _load_arm_log
from pgrssnn_jax.data.benchmarks import as_records, load_benchmark
from pgrssnn_jax.data.sources import channels
from pgrssnn_jax.discovery.checks import check_effects_of_motion, check_physics
from pgrssnn_jax.discovery.discover import discover as discover_from
from pgrssnn_jax.discovery.inverse.discover import discover_by_torques, motion_evidence
from pgrssnn_jax.discovery.inverse.filter_form import filter_form
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.inverse.serialise import torques_arrays, torques_json
from pgrssnn_jax.discovery.network import network_shares, plan_network
from pgrssnn_jax.discovery.serialise import discovery_arrays, discovery_json
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup, set_up
from pgrssnn_jax.effects.base import Effect
from pgrssnn_jax.effects.stored import OF_TRAINING, read_stored, settings_to_json, stored_physics
from pgrssnn_jax.effects.systems import add_effect as add
from pgrssnn_jax.models.rollout import Trajectory, first_not_finite, rollout
from pgrssnn_jax.models.spec import ModelSpec, changes_of
from pgrssnn_jax.physics.base import Parameter, Physics, Signal, continuous, discrete
from pgrssnn_jax.physics.check import check_given, checked_inputs, checked_start
from pgrssnn_jax.physics.simulate import free_run
from pgrssnn_jax.records.arguments import call_with, check_kind, shown
from pgrssnn_jax.records.build import record_from as record
from pgrssnn_jax.records.csv import read_csv as _read_csv
from pgrssnn_jax.records.matching import A_RECORD
from pgrssnn_jax.records.record import Array, Record, Start
from pgrssnn_jax.results.discovered import Discovered
from pgrssnn_jax.results.ensemble import Ensemble
from pgrssnn_jax.results.saved import load, restored_physics
from pgrssnn_jax.training.choose import choose_settings, settled
from pgrssnn_jax.training.evaluation import trained_members
from pgrssnn_jax.training.loop import Progress
from pgrssnn_jax.training.plan import Plan, plan_training
from pgrssnn_jax.training.recipes import PROOF, named_recipe
from pgrssnn_jax.training.settings import TrainingSettings, training_settings
from pgrssnn_jax.training.train import first_checkpoint, train_members

__all__ = [
    "Discovered", "Effect", "Ensemble", "ModelSpec", "Parameter", "Physics", "Record", "Signal", "add", "continuous",
    "discover", "discrete", "filter_form", "fit", "load", "load_arm_log", "load_benchmark", "read_csv", "read_physics",
    "record", "rollout", "simulate",
]  # fmt: skip

Callback = Callable[[Progress], bool | None]


def fit(
    model: str | ModelSpec,
    physics: Physics,
    train: Record,
    *,
    recipe: str | None = None,
    seeds: int | None = None,
    seed: int = 0,
    validation: Record | None = None,
    callback: Callback | None = None,
    quiet: bool = False,
    **settings: Any,
) -> Ensemble:
    """Trains all seeds of a model on a record, in one compiled program.

        L(θ) = Σ_t ((y_t - ŷ_t(θ)) / s_y)²,   ŷ a free run;   best parameters by validation error

    model: a variant (`pg_rssnn`, `rssnn`, `physics_only`, ...) or a `ModelSpec`. recipe: `experiment`, the settings of
    the benchmark's experiment; `default`; `auto`, the settings that predict left-out blocks of the record best, with
    the physics alone among the candidates (`training/choose.py`; given settings stay); None: `experiment` for a record
    of a benchmark, else `auto`. After a discovery the settings are those of the commands. seeds: how many, None: the
    recipe's own; seed: the first. validation: None takes the part that came with the data, or the tail of train.
    callback: called after every chunk of epochs; training stops when it returns True. settings: any of
    `training/settings.py` by name (epochs=200, learning_rate=1e-3, initial_state="estimated", ...).

    Members that leave the floating-point range do not raise: they count as failed and are named. Raises `ValueError`
    for records that do not fit the physics and for settings out of their range.
    """
    check_given(physics)
    _check_record("train", train)
    if callback is not None and not callable(callback):
        raise ValueError(f"callback: expected a function of a Progress, found {shown(callback)}")
    keep_compiled()
    given = {"seed": seed, "n_seeds": seeds, **settings}
    recipe = recipe or (None if train.info.benchmark else "auto")
    chosen = _training(model, physics, train, recipe, given)
    stop, console, choice = threading.Event(), Console(quiet=quiet, highlight=False), None
    if recipe == "auto":
        held = {*given, *(() if isinstance(model, str) else changes_of(model))}
        choice = choose_settings(
            physics, train, chosen, held,
            validation=validation, stop=stop, notify=lambda line: console.print(line, soft_wrap=True),
        )  # fmt: skip
    plan = plan_training(physics, train, choice.settings if choice else chosen, validation=validation)

    def on_chunk(_: Any, __: Any, now: Progress) -> None:
        if callback is not None and callback(now):
            stop.set()

    first = first_checkpoint(plan)
    done = train_members(plan, first, console, stop, on_chunk)
    seconds = {**({"choose": choice.seconds} if choice else {}), **done.seconds}
    state, report = settled(plan, done.state, choice and choice.report())
    return finished(plan, state, done.losses, seconds, recipe=report)


def finished(
    plan: Plan,
    state: Any,
    losses: Any,
    seconds: Mapping[str, float],
    *,
    labels: Mapping[str, str | None] | None = None,
    recipe: Mapping[str, Any] | None = None,
) -> Ensemble:
    """The result of a training run; labels: names of the configuration's files, where there were any; recipe: how its
    settings were chosen."""
    return Ensemble(
        plan.settings, trained_members(plan, state), losses, plan.train.info,
        n_train=plan.train.u.shape[2], n_sequences=plan.train.u.shape[1],
        seconds=seconds, plan=plan, labels=labels, recipe=recipe,
    )  # fmt: skip


def discover(
    physics: Physics,
    train: Record,
    test: Record,
    *,
    effects: Sequence[Effect] = (),
    without: Sequence[str] = (),
    realisation: int = 0,
    validation: Record | None = None,
    quiet: bool = False,
    **settings: Any,
) -> Discovered:
    """Finds where a physics and a record disagree, names the missing effect, adds it, and measures the gap on the test
    record, which no earlier step has seen.

        gap = RMS error of the recalibrated physics - RMS of the noise

    effects: your own ones, candidates beside those of the catalogue; without: names of effects that are no candidates;
    realisation: which dataset of the records; validation: a further part of the estimation record; settings: any of
    `discovery/settings.py` by name. Raises `ValueError` for bad input, before any work.
    """
    check_given(physics)
    _check_record("train", train)
    keep_compiled()
    console = Console(quiet=quiet, highlight=False)
    names = list(without) if isinstance(without, tuple) else without
    chosen = call_with(DiscoverySettings, {**settings, "without": names}, "discovery")
    training = _training("pg_rssnn", physics, train, None, {}, before=PROOF)

    def say(line: str) -> None:
        console.print(line, soft_wrap=True)

    setup = set_up(
        physics, train, test, chosen, training,
        effects=effects, validation=validation, realisation=realisation, notify=say,
    )  # fmt: skip
    return discovered(setup, check_setup(setup, say), say, threading.Event(), command="pg.discover")


def check_setup(setup: Setup, notify: Callable[[str], None]) -> Motion | None:
    """The motion of an arm whose torques are the evidence, None where free runs are. Raises `ValueError` for what could
    turn out to be bad input during a discovery: a model need not run to be asked for its torques."""
    motion = motion_evidence(setup, notify)
    if motion is None:
        check_physics(setup)
        if setup.settings.network_epochs:
            plan_network(setup, None)
    else:
        check_effects_of_motion(setup, motion)
    return motion


def discovered(
    setup: Setup,
    motion: Motion | None,
    notify: Callable[[str], None],
    stop: threading.Event,
    *,
    command: str,
    seconds: float = 0.0,
) -> Discovered:
    """Runs a discovery that has been set up; motion: from `check_setup`; stop: looked at between epochs of the proof;
    seconds: spent before."""
    if motion is not None:
        by_torques = discover_by_torques(setup, motion, notify)
        details, arrays = torques_json(by_torques, setup, command=command), torques_arrays(by_torques, setup)
    else:
        found = discover_from(setup, notify)
        details, arrays = discovery_json(found, setup, command=command), discovery_arrays(found, setup)
    if motion is None and setup.settings.network_epochs and details["numbers"]["order"]:
        started = time.perf_counter()
        details["network"] = network_shares(setup, details, notify, stop)
        details["seconds"]["network"] = time.perf_counter() - started
    details["seconds"] = {"load": seconds, **details["seconds"]}
    details["seconds"]["total"] = sum(details["seconds"].values())
    origins = {name: f"{r.info.source}: {r.info.origin}" for name, r in (("train", setup.train), ("test", setup.test))}
    physics = stored_physics(setup.nominal, details, where="discovery", extra=setup.effects)
    settings = {"physics": settings_to_json(setup.nominal), "discovery": dict(vars(setup.settings))}
    return Discovered(details, arrays, physics, origins, settings)


def read_csv(path: str | Path, physics: Physics, *, start: Start = "unknown") -> Record:
    """A record from a CSV file whose columns are named after the inputs and outputs of the physics, in its units.

    start: the known part of the initial state, as in `record`. Raises `ValueError` with file, line and column for a
    file that does not fit."""
    check_given(physics)
    check_kind("path", path, str | Path, "the name of a CSV file")
    if start not in get_args(Start):
        raise ValueError(f"start: expected one of {list(get_args(Start))}, found {start!r}")
    return _read_csv(path, channels(physics.inputs), channels(physics.outputs), physics.dt, start=start)


def read_physics(path: str | Path, physics: Physics | None = None, *, effects: Sequence[Effect] = ()) -> Physics:
    """The physics that a discovery or a training run left in its folder, with its numbers and effects.

    path: the folder, or its `discovery.json` or `physics.json`; physics: your own physics, built as for that run, None
    for a physics of the library; effects: your own effects. The settings of training (derivatives, backend) are the
    builder's defaults. Raises `ValueError` for a folder without a stored physics, and for an own physics of another
    name or with other parameters."""
    check_kind("path", path, str | Path, "the name of a folder")
    if physics is not None:
        check_given(physics)
    given = Path(path)
    names = (given / name for name in ("discovery.json", "physics.json"))
    file = next((file for file in names if file.is_file()), given / "discovery.json") if given.is_dir() else given
    stored = read_stored(file, "path")
    own = {name: value for name, value in stored["physics"].items() if name not in OF_TRAINING}
    return restored_physics({**stored, "physics": own}, file, physics=physics, effects=effects)


def load_arm_log(
    physics: Physics, train: str | Path, test: str | Path | None = None, **settings: Any
) -> tuple[Record, Record]:
    """Training and test record of an arm from its logs, CSV or NPZ, every `physics.dt` s.

    test: None takes the last third of `train`. settings: names, units and sides of the columns, the transmission and
    the filter, as in `data/arm_log.py`. Raises `ValueError` for files without the named columns."""
    check_given(physics)
    given = {"train": train, "test": test, **settings}
    return as_records(call_with(_load_arm_log, given, "load_arm_log", physics=physics))


def simulate(physics: Physics, u: Array, x0: Array) -> Trajectory:
    """Free run of a physics alone in double precision: x_t = step(p, x_{t-1}, u_t), y_t = measure(p, x_t, u_t).

    u `[time, input]` or `[sequence, time, input]`, x0 `[state]` or `[sequence, state]`. A state that leaves the
    floating-point range does not raise: `first_bad` states where. Raises `ValueError` for other shapes, for values that
    are no numbers, and for a physics whose functions return other shapes than its signals state."""
    check_given(physics)
    u, n_x = checked_inputs(u, len(physics.inputs)), len(physics.states)
    sequences = u if u.ndim == 3 else u[None]
    x0 = checked_start(x0, n_x, len(sequences))
    with jax.enable_x64(True):
        start = np.broadcast_to(x0, (len(sequences), n_x))
        y, x = free_run(physics, sequences, start)
        found = Trajectory(*map(np.asarray, (y, x, first_not_finite(x, y))))
    return found if u.ndim == 3 else Trajectory(*(a[0] for a in found))


def _check_record(name: str, given: Any) -> None:
    check_kind(f"data: {name}", given, Record, A_RECORD)


def _training(
    model: str | ModelSpec,
    physics: Physics,
    train: Record,
    recipe: str | None,
    given: Mapping[str, Any],
    before: Mapping[str, Any] | None = None,
) -> TrainingSettings:
    """Defaults, `before`, the recipe's settings and those that were given (None: not), in this order."""
    check_kind("model", model, str | ModelSpec, "the name of a model or a pg.ModelSpec")
    usual = named_recipe(recipe, train.info.benchmark, discovered=physics.discovered)
    named = {name: value for name, value in given.items() if name != "n_seeds" or value is not None}
    return training_settings(model, before or {}, usual, named)
