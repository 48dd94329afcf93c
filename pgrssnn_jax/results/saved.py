"""A run folder read back: the ensemble that it holds, ready to simulate and to be scored, without the training data.

Nothing that came with a folder is executed: its physics is built by the package, or given again by its owner.
"""

import importlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pgrssnn_jax.effects.base import Effect
from pgrssnn_jax.effects.stored import check_keys, has_source, read_stored, stored_physics
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.check import check_physics
from pgrssnn_jax.physics.library import library_builder
from pgrssnn_jax.records.arguments import call_with, check_kind, shown
from pgrssnn_jax.records.record import Channel, RecordInfo, record
from pgrssnn_jax.records.scaling import Scaling, Units, identity
from pgrssnn_jax.results.ensemble import Ensemble
from pgrssnn_jax.training.checkpoints import Checkpoint, CheckpointFolder
from pgrssnn_jax.training.evaluation import Trained
from pgrssnn_jax.training.intervals import N_LEVELS, Intervals
from pgrssnn_jax.training.loop import no_losses
from pgrssnn_jax.training.members import Member
from pgrssnn_jax.training.objective import MemberData
from pgrssnn_jax.training.optimise import Fit
from pgrssnn_jax.training.plan import member_mapping, plan_fit
from pgrssnn_jax.training.run_folder import RunFolder, read_training_config
from pgrssnn_jax.training.settings import changed, settings_from_config


def load(
    folder: str | Path,
    physics: Physics | None = None,
    *,
    trust: Sequence[str] = (),
    effects: Sequence[Effect] = (),
    partial: bool = False,
) -> Ensemble:
    """The trained members of a run folder; needs neither its data nor anything outside it.

    physics: your own physics, built as for training. Its names, units and shapes must equal those in the folder; a
    changed source warns. trust: modules from which the physics may be imported instead. effects: your own effects that
    the discovery added. partial: True reads an unfinished run too. Raises `ValueError` for a folder without a finished
    run, for a missing or different physics, and for damaged files.
    """
    check_kind("run folder", folder, str | Path, "the name of a folder")
    run = RunFolder(Path(folder))
    config = read_training_config(run.path)
    if not (run.finished or partial):
        raise ValueError(f"{folder}: expected a finished run with the file DONE, found none (partial=True reads it)")
    stored = stored_in(run, config)
    chosen = restored_physics(stored, run.path, physics=physics, trust=trust, effects=effects)
    settings = settings_from_config(config, where=str(folder))
    shared = config["data"].get("shared_initial_state", False)
    if not isinstance(shared, bool):
        raise ValueError(f"{folder}: data.shared_initial_state: expected true or false, found {shared!r}")
    fit = plan_fit(chosen, changed(settings, {"recurrence": "xla"}), shared=shared)  # it is evaluated, not trained
    with closing(CheckpointFolder(run.checkpoint, create=False)) as checkpoints:
        found = checkpoints.restore(_structure(fit), any_shape=True)
    metrics = run.read_json("metrics.json")
    arrays = run.read_arrays("predictions.npz")
    count = len(found.state.epoch)
    rows = metrics.get("members") or [{"seed": settings.run.seed + i, "dataset": 0} for i in range(count)]
    if not isinstance(rows, list) or len(rows) != count or not all(map(_is_member, rows)):
        raise ValueError(
            f"{folder}: metrics.json: members: expected seed and dataset of {count} members, found {shown(rows)}"
        )
    members = [Member(row["seed"], row["dataset"]) for row in rows]
    start = arrays.get("x0_train", arrays["x0"][:, 0] if "x0" in arrays and fit.objective.initial.shared else None)
    expected = count, len(chosen.states)
    start = np.full(expected, np.nan) if start is None else start
    if start.shape != expected or start.dtype.kind != "f":
        raise ValueError(f"{folder}: predictions.npz: x0_train: expected numbers {expected}, found {shown(start)}")
    n_sequences = metrics.get("n_sequences", 1)  # decides how members are mapped, and so the last bits
    if type(n_sequences) is not int or n_sequences < 1:
        raise ValueError(f"{folder}: metrics.json: n_sequences: expected 1 or more, found {shown(n_sequences)}")
    mapping = member_mapping(settings, count, n_sequences)
    trained = Trained(fit.objective, mapping, members, found.state, found.scaling, found.units, start)
    inputs, outputs = (tuple(Channel(s.name, s.unit) for s in signals) for signals in (chosen.inputs, chosen.outputs))
    info = RecordInfo(inputs, outputs, chosen.dt, metrics.get("source", "file"), metrics.get("origin", str(folder)))
    spent = metrics.get("seconds", {})
    check_kind(f"{folder}: metrics.json: seconds", spent, Mapping, "seconds by the names of the steps")
    seconds = {name: value for name, value in spent.items() if name != "total"}
    return Ensemble(
        settings,
        trained,
        found.losses,
        info,
        n_train=metrics.get("n_train", 0),
        n_sequences=n_sequences,
        seconds=seconds,
        recipe=_recipe(config),
        intervals=_intervals(run, len(chosen.inputs), len(chosen.outputs)),
    )


def _is_member(row: Any) -> bool:
    return isinstance(row, dict) and all(type(row.get(name)) is int for name in ("seed", "dataset"))


def _intervals(run: RunFolder, n_u: int, n_y: int) -> Intervals | None:
    """None for a run that has none. Raises `ValueError` for arrays of other names or shapes."""
    arrays = run.read_arrays("intervals.npz")
    if not arrays:
        return None
    linear = 3 + n_u
    later = {"mean": (n_y, linear), "covariance": (n_y, linear, linear)}  # earlier runs took the mean error for zero
    arrays = {**{name: np.zeros(shape) for name, shape in later.items()}, **arrays}
    expected = {"weights": (n_y, 4 + n_u), "y": (4, n_y), "u": (4, n_u), "horizon": (), "quantiles": (n_y, N_LEVELS)}
    expected |= later
    found = {name: array.shape for name, array in arrays.items()}
    if found != expected:
        raise ValueError(f"{run.path / 'intervals.npz'}: expected arrays of shapes {expected}, found {found}")
    return Intervals(**arrays)


def _recipe(config: Mapping[str, Any]) -> Mapping[str, Any] | None:
    recipe = config.get("recipe")
    return recipe if isinstance(recipe, Mapping) else None


def stored_in(run: RunFolder, config: Mapping[str, Any]) -> dict[str, Any]:
    """The folder's `physics.json`; for a run of an earlier version, the settings in its configuration."""
    path = run.path / "physics.json"
    if path.is_file():
        found = run.read_json(path.name)
        check_keys(found, str(path))
        return found
    settings = {name: value for name, value in config["physics"].items() if name != "effects"}
    effects = config["physics"].get("effects")
    if effects is not None:
        warnings.warn(
            f"{run.path}: this run of an earlier version kept no copy of {effects}: it is read now", stacklevel=4
        )
        return {**read_stored(Path(effects), "physics.effects"), "discovered": True}
    return {"system": None, "physics": settings, "numbers": None, "initial_state": {}}


def restored_physics(
    stored: Mapping[str, Any],
    folder: Path,
    *,
    physics: Physics | None,
    trust: Sequence[str] = (),
    effects: Sequence[Effect] = (),
) -> Physics:
    """The physics of a run folder, from the package's builders, or from one that is given or trusted."""
    if physics is None:
        target = str(stored["physics"].get("_target_") or "")
        build = library_builder(target) or _trusted(target, trust)
        if build is None:
            raise ValueError(
                f"{folder}: physics: expected the physics of one's own that this run was trained on "
                f"(physics=..., or for pg.load trust=[its module]), found {target or 'none'!r} in the folder"
            )
        settings = {name: value for name, value in stored["physics"].items() if name not in ("_target_", "effects")}
        physics = call_with(build, settings, f"{folder}: physics")
        check_physics(physics, target)
    _check_signals(physics, stored, folder)
    if "source_sha256" in stored and not has_source(physics, stored["source_sha256"]):
        warnings.warn(f"{folder}: the source of physics {physics.name!r} has changed since the run", stacklevel=3)
    return physics if stored["numbers"] is None else stored_physics(physics, stored, where=str(folder), extra=effects)


def _trusted(target: str, trust: Sequence[str]) -> Callable[..., Any] | None:
    module, _, name = target.rpartition(".")
    return getattr(importlib.import_module(module), name, None) if module in trust else None


def _check_signals(physics: Physics, stored: Mapping[str, Any], folder: Path) -> None:
    """An effect with memory has added states; those of the physics itself come first."""
    named, kinds = stored.get("signals") or {}, ("states", "inputs", "outputs")
    check_kind(f"{folder}: physics.json: signals", named, Mapping, f"lists of {', '.join(kinds)}")
    for kind, expected in named.items():
        if kind not in kinds or not isinstance(expected, list):
            found = shown({kind: expected})
            raise ValueError(f"{folder}: physics.json: signals: expected lists of {', '.join(kinds)}, found {found}")
        found = [[s.name, s.unit] for s in getattr(physics, kind)]
        if found != expected[: len(found)] or (kind != "states" and len(found) != len(expected)):
            raise ValueError(f"{folder}: physics: {kind}: expected {expected}, found {found}")


def _structure(fit: Fit) -> Checkpoint:
    """The shape of this fit's checkpoints, found by abstract evaluation on a record of a few zeros."""
    model = fit.objective.model
    n_u, n_y = len(model.physics.inputs), len(model.physics.outputs)
    time = fit.objective.initial.n_init + 2
    info = RecordInfo((Channel(""),) * n_u, (Channel(""),) * n_y, model.physics.dt, "simulated")
    zeros = record(np.zeros((time, n_u)), np.zeros((time, n_y)), info)
    scaling = Scaling(identity(n_u), identity(model.n_x), identity(n_y))
    data = MemberData(zeros, zeros, scaling, np.zeros((), np.int32))
    state = jax.eval_shape(fit.begin, jax.random.key(0), data)
    return Checkpoint(state, scaling, Units(scaling.u, scaling.y), no_losses(1))
