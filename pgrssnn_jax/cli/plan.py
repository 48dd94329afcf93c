"""From the composed configuration to everything a training run needs. All bad input is found here, before a byte is
written: every function raises `ValueError` with one sentence."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from omegaconf import DictConfig, OmegaConf

from pgrssnn_jax.cli import after_discovery
from pgrssnn_jax.cli.budget import capped
from pgrssnn_jax.data.csv_files import load_csv
from pgrssnn_jax.data.lgssm import load_lgssm
from pgrssnn_jax.data.robot import load_robot_real, load_robot_simulated
from pgrssnn_jax.data.tanks import load_cascaded_tank
from pgrssnn_jax.effects.discovered import discovered_physics
from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.model import build_model, model_scaling
from pgrssnn_jax.models.networks import ModelSpec
from pgrssnn_jax.physics.base import Physics, Signal, check_physics
from pgrssnn_jax.records.record import Record, Splits, cast, take
from pgrssnn_jax.records.scaling import Scaling, Units, measured_units, standardise
from pgrssnn_jax.records.splits import KFold, kfold_masks
from pgrssnn_jax.training import members
from pgrssnn_jax.training.objective import MemberData, build_objective
from pgrssnn_jax.training.optimise import Fit, FitSettings
from pgrssnn_jax.training.settings import call_with

LOADERS: dict[str, Callable[..., Splits]] = {
    "cascaded_tank": load_cascaded_tank,
    "lgssm": load_lgssm,
    "robot_real": load_robot_real,
    "robot_simulated": load_robot_simulated,
    "csv": load_csv,
}
_KEYS = {
    "physics", "data", "model", "fit", "members",
    "seed", "n_seeds", "initial_state", "n_init", "report_n_init", "resume",
}  # fmt: skip
_LARGEST = 1e18  # whose square is still a float32
_NOT_OF_THE_LOADER = ("name", "published_scaling", "shared_initial_state", "folds", "block")

after_discovery.register()  # for jobs of a sweep and callers of this module, who have no entry script


@dataclass(frozen=True)
class DataConventions:
    """What a configuration says of its data beside the loader's arguments."""

    name: str
    published_scaling: bool = False
    shared_initial_state: bool = False
    folds: int = 0
    block: int = 32


@dataclass(frozen=True)
class Seeds:
    """Members take seed, seed + 1, ..., n_seeds of them per dataset."""

    seed: int
    n_seeds: int

    def __post_init__(self) -> None:
        for name, least, most in (("seed", 0, 2**31 - 1), ("n_seeds", 1, 10**6)):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name}: expected {least} to {most}, found {getattr(self, name)}")


class Plan(NamedTuple):
    """A training run before its first epoch.

    splits: as measured, `[dataset, seq, time, channel]`; measured: the same per member, where members may validate on
    different samples; data and test: per member, in the units the model works on; units: per member, brings predictions
    back to the measured units.
    """

    config: dict[str, Any]
    fit: Fit
    mapping: members.MemberMapping
    members: list[members.Member]
    splits: Splits
    measured: Splits
    data: MemberData
    test: Record
    units: Units
    report_n_init: list[int]


def plan_training(config: Mapping[str, Any], notify: Callable[[str], None]) -> Plan:
    """config: the resolved configuration as plain data; notify: shows one line to the user."""
    unknown = sorted(config.keys() - _KEYS)
    if unknown:
        raise ValueError(f"configuration: expected the keys {sorted(_KEYS)}, found {unknown[0]!r}")
    fit = plan_fit(config)
    model, initial = fit.objective.model, fit.objective.initial
    if model.physics.remark:
        notify(model.physics.remark)
    splits = load_splits(config["data"], model.physics, notify)
    _check_records(splits, initial, model.physics)
    said = conventions(config["data"])
    published, folds = said.published_scaling, KFold(said.folds, said.block)
    rates_like_outputs = published and _has_rates(model.physics)
    standardised = published and not rates_like_outputs
    worked_on, units = standardise(splits) if standardised else (splits, measured_units(splits))
    chosen = _members(config, len(splits.train.u), seeds_differ=model.graph is not None)
    datasets = np.array([member.dataset for member in chosen])
    scalings = [
        model_scaling(model, take(worked_on.train, i), rates_like_outputs=rates_like_outputs)
        for i in range(len(splits.train.u))
    ]
    measured = _per_member(splits, chosen, folds)
    own = _per_member(worked_on, chosen, folds) if standardised else measured
    data, test = _member_data(scalings, own, datasets, fit.settings.epochs)
    return Plan(
        config=dict(config),
        fit=fit,
        mapping=load_mapping(config["members"], len(chosen), data.train.u.shape[1]),
        members=chosen,
        splits=splits,
        measured=measured,
        data=data,
        test=test,
        units=jax.tree.map(lambda a: a[datasets], units),
        report_n_init=_report_n_init(config["report_n_init"], initial, splits.test),
    )


def plan_fit(config: Mapping[str, Any]) -> Fit:
    """Physics, model and training settings of a configuration; no data."""
    spec = call_with(ModelSpec, _without(config["model"], "name"), "model")
    model = build_model(spec, load_physics(config["physics"]))
    settings = call_with(FitSettings, config["fit"], "fit")
    shared = conventions(config["data"]).shared_initial_state
    start = {"kind": config["initial_state"], "n_init": config["n_init"], "shared": shared}
    initial = call_with(InitialState, start, "initial_state")
    train_physics = settings.physics_parameters == "trained"
    if not model.physics.differentiable and (train_physics or initial.kind == "estimated"):
        what = "fit.physics_parameters=trained" if train_physics else "initial_state=estimated"
        raise ValueError(
            f"physics.physics_gradient: expected full with {what}, which needs the gradient, found stopped"
        )
    return Fit(build_objective(model, initial, train_physics=train_physics), settings)


_HINTS = {
    "physics._target_": "+experiment=cascaded_tank, physics=tanks, or physics._target_=my_module.my_physics",
    "data.train": "data.train=FILE.csv (or another data=...)",
    "data.test": "data.test=FILE.csv",
}


def plain(config: DictConfig) -> dict[str, Any]:
    """The resolved configuration without Hydra's part; a value that must be given and is not is bad input."""
    missing = sorted(OmegaConf.missing_keys(config), key=lambda key: (not key.startswith("physics"), key))
    if missing:
        hint = _HINTS.get(missing[0], "a value on the command line")
        raise ValueError(f"{missing[0]}: expected {hint}, found none")
    return loose(config)


def loose(config: DictConfig) -> dict[str, Any]:
    """The same as `plain`, with `???` where a value is missing.

    What is not part of a run is left out: the name of a sweep, and the budget, which is applied here.
    """
    found = OmegaConf.to_container(config, resolve=True, throw_on_missing=False)
    assert isinstance(found, dict)
    settings = {str(key): value for key, value in found.items() if key not in ("sweep", "budget")}
    return capped(settings, found.get("budget") or {})


def load_physics(group: Mapping[str, Any]) -> Physics:
    """Calls the function named by `physics._target_` with the other keys of the group and checks what it returns.

    effects: a `discovery.json`, whose physics takes the place of the group's settings.
    """
    if group.get("effects") is not None:
        return discovered_physics(group, load_physics)
    group = _without(group, "effects")
    target = str(group["_target_"])
    module, _, name = target.rpartition(".")
    try:
        function = getattr(importlib.import_module(module), name)
    except Exception as problem:  # whatever a user's module does while it is imported
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise ValueError(f"physics._target_: expected an importable function, found {target!r} ({reason})") from problem
    try:
        physics = call_with(function, _without(group, "_target_"), "physics")
    except ValueError:
        raise
    except Exception as problem:
        reason = f"{type(problem).__name__}: {problem}".splitlines()[0]
        raise ValueError(f"physics: expected {target!r} to return a Physics, found {reason}") from problem
    check_physics(physics, target)
    return physics


def load_splits(group: Mapping[str, Any], physics: Physics, notify: Callable[[str], None]) -> Splits:
    name = group["name"]
    if name not in LOADERS:
        raise ValueError(f"data.name: expected one of {sorted(LOADERS)}, found {name!r}")
    loader = LOADERS[name]
    splits = call_with(loader, _without(group, *_NOT_OF_THE_LOADER), "data", physics=physics, notify=notify)
    found, expected = splits.train.info, physics
    for what in ("inputs", "outputs"):
        names = [channel.name for channel in getattr(found, what)]
        wanted = [signal.name for signal in getattr(expected, what)]
        if names != wanted:
            raise ValueError(f"data: {what}: expected those of physics {physics.name!r}, {wanted}, found {names}")
    return splits


def load_mapping(group: Mapping[str, Any], n_members: int, n_sequences: int) -> members.MemberMapping:
    """`auto` is resolved by what the benchmark found: see `members.choose_mapping`."""
    chosen = members.choose_mapping(n_members, n_sequences, jax.device_count())
    settings = {
        "how": chosen.how if group["how"] == "auto" else group["how"],
        "sub_batch": group["sub_batch"],
        "devices": chosen.devices if group["devices"] == "auto" else group["devices"],
        "optimisation": group.get("optimisation"),  # runs of before have none
    }
    mapping = call_with(members.MemberMapping, settings, "members")
    members.map_members(lambda: None, mapping)  # raises for what this machine does not have
    return mapping


def _without(group: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {key: value for key, value in group.items() if key not in names}


def _has_rates(physics: Physics) -> bool:
    """Is some state the rate of an output? Published scaling then concerns the networks alone and puts rates into the
    units of their outputs (the arm); elsewhere the physics itself acts on standardised signals (LGSSM)."""
    return any(state.rate_of for state in physics.states)


def conventions(group: Mapping[str, Any]) -> DataConventions:
    """What a `data` group says beside the loader's arguments."""
    return call_with(DataConventions, {key: group[key] for key in _NOT_OF_THE_LOADER if key in group}, "data")


def _members(config: Mapping[str, Any], n_datasets: int, *, seeds_differ: bool) -> list[members.Member]:
    """Every dataset with every seed; one seed without networks, because nothing else is drawn."""
    seeds = call_with(Seeds, {name: config[name] for name in ("seed", "n_seeds")}, "seeds")
    count = seeds.n_seeds if seeds_differ else 1
    return [members.Member(seeds.seed + i, dataset) for dataset in range(n_datasets) for i in range(count)]


def _per_member(splits: Splits, chosen: list[members.Member], folds: KFold) -> Splits:
    """The records of every member."""
    own = Splits(*(take(record, np.array([member.dataset for member in chosen])) for record in splits))
    if not folds.folds:
        return own
    train, validation = kfold_masks(own.train, own.validation, [member.seed for member in chosen], folds)
    return own._replace(train=train, validation=validation)


def _member_data(scalings: list[Scaling], own: Splits, datasets: np.ndarray, epochs: int) -> tuple[MemberData, Record]:
    """Records and scaling of every member, in float32: the precision of the networks."""
    stacked = jax.tree.map(lambda *a: np.stack(a)[datasets].astype(np.float32), *scalings)
    train, validation, test = (cast(record, np.float32) for record in own)
    last_epoch = np.full(len(datasets), epochs, np.int32)
    return MemberData(train, validation, stacked, last_epoch), test


def _check_records(splits: Splits, initial: InitialState, physics: Physics) -> None:
    for name, record in zip(Splits._fields, splits, strict=True):
        time = record.u.shape[2]
        for k, signal in enumerate(physics.outputs):
            check_range(f"data: {name}", signal, np.asarray(record.y)[..., k][np.asarray(record.mask)[..., k]])
        for signal in (record.u, np.where(record.mask, record.y, 0.0)):
            if (largest := np.abs(signal).max()) > _LARGEST:
                raise ValueError(f"data: {name}: expected values up to {_LARGEST:g}, found {largest:g}")
        if initial.kind == "estimated" and time <= initial.n_init:
            raise ValueError(
                f"n_init: expected fewer than the {time} samples of the {name} record, found {initial.n_init}"
            )


def check_range(where: str, signal: Signal, values: np.ndarray) -> None:
    """Raises `ValueError` when values cannot be in the unit of their signal."""
    low, high = signal.range
    if values.size and not (low <= values.min() and values.max() <= high):
        raise ValueError(
            f"{where}: {signal.name}: expected {low:.3g} to {high:.3g} {signal.unit}, found values from "
            f"{values.min():.3g} to {values.max():.3g}: are they in {signal.unit}?"
        )


def _report_n_init(wanted: Any, initial: InitialState, test: Record) -> list[int]:
    """The windows to report; test samples from which the initial state was found never count in the main figure."""
    time = test.u.shape[2]
    if not isinstance(wanted, list) or not all(type(n) is int and n >= 0 for n in wanted):
        raise ValueError(f"report_n_init: expected a list of sample counts like [0, 5, 50], found {wanted!r}")
    used = 0 if initial.shared else {"first_output": 1, "estimated": initial.n_init}.get(initial.kind, 0)
    windows = list(dict.fromkeys(max(n, used) for n in wanted if max(n, used) < time))
    if not windows:
        raise ValueError(
            f"report_n_init: expected a count below the {time} samples of the test record"
            f"{f' and of at least {used}' if used else ''}, found {wanted}"
        )
    return windows
