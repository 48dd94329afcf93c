"""Every setting of a training run beside its physics and its data, each with its default, unit and source.

The command line groups them (`fit.epochs=20`), the Python API takes them by name (`epochs=20`): names are unique.
Source of the published values: Li, Seth, Kok, IFAC 2026, and the authors' released code.
"""

import math
import warnings
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, NamedTuple

from pgrssnn_jax.models.spec import ModelSpec, variant_changes
from pgrssnn_jax.records.arguments import call_with, check_count

InitialStateKind = Literal["zero", "scaled_zero", "first_output", "estimated", "least_squares"]
Guard = Literal["none", "rollback"]
ROLLBACKS = 5  # the step is then 1/32 of the first: a member that still leaves the range does so whatever the step


@dataclass(frozen=True)
class FitSettings:
    """How one member is optimised; the defaults are those of the released code, but for the guard."""

    epochs: int = 1000  # at most
    optimizer: Literal["adam", "adamw"] = "adamw"
    learning_rate: float = 1e-3  # no unit
    weight_decay: float = 1e-2  # per unit of learning rate; adamw only, networks only
    clip_norm: float | None = 1.0  # norm of the gradient; None: off
    validate_every: int = 5  # epochs
    patience: int = 100  # epochs after the best validation
    chunk_epochs: int = 20  # epochs per compiled call; the progress bar moves once per chunk
    guard: Guard = "rollback"  # "none": a member that leaves the floating-point range has failed, as the paper counts
    physics_parameters: Literal["fixed", "trained"] = "fixed"
    checkpoint_seconds: float = 30.0  # s between checkpoints; one is always written at the end and on Ctrl-C

    def __post_init__(self) -> None:
        for names, expected, holds in (
            (("validate_every", "patience", "chunk_epochs"), "at least 1", lambda value: value >= 1),
            (("epochs", "weight_decay", "checkpoint_seconds"), "0 or more", lambda value: 0 <= value < math.inf),
            (("learning_rate", "clip_norm"), "a positive number", lambda value: value is None or 0 < value < math.inf),
        ):
            for name in names:
                if not holds(value := getattr(self, name)):
                    raise ValueError(f"fit: {name}: expected {expected}, found {value}")

    @property
    def blocks(self) -> int:
        """Validations per compiled chunk."""
        return max(1, self.chunk_epochs // self.validate_every)

    @property
    def rollbacks(self) -> int:
        """How often a member may go back to its best parameters."""
        return ROLLBACKS if self.guard == "rollback" else 0


@dataclass(frozen=True)
class RunSettings:
    """Which members are trained, where records start, what validates, and which figures are reported."""

    seed: int = 0  # first seed; members take seed, seed + 1, ...
    n_seeds: int = 10  # members per dataset: runs per model in the paper
    initial_state: InitialStateKind = "first_output"  # published: zero; see `models/initial_state.py`
    n_init: int = 50  # samples from which initial_state=estimated finds the start of a record
    accelerate: bool = True  # False: without `pgrssnn_jax.acceleration`, slower; equal (C++: to rounding)
    report_n_init: Any = (0, 5, 50)  # samples left out of the test record's start; first: main figure

    def __post_init__(self) -> None:
        for name, least, most in (("seed", 0, 2**31 - 1), ("n_seeds", 1, 10**6)):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name}: expected {least} to {most}, found {getattr(self, name)}")
        windows = self.report_n_init
        object.__setattr__(self, "report_n_init", tuple(windows) if isinstance(windows, list) else windows)
        if not isinstance(windows, list | tuple) or not all(type(n) is int and n >= 0 for n in windows):
            raise ValueError(f"report_n_init: expected a list of sample counts like [0, 5, 50], found {windows!r}")


@dataclass(frozen=True)
class DataSettings:
    """How records are used, beside the arguments of the loader that finds them."""

    published_scaling: bool = False  # True: the physics acts on standardised signals, as in the published code
    folds: int = 0  # k: member by seed, another k-th of the record validates, blocks taking turns; 0: its own split
    block: int = 32  # samples of such a block
    lead: int = 0  # first samples of a record that all members train on, so that each knows where it starts
    window: int | None = None  # samples per training sequence; None: sequences stay whole

    def __post_init__(self) -> None:
        for name, least in (("block", 1), ("lead", 0)):
            check_count(f"data.{name}", getattr(self, name), least, 10**9, "samples")


@dataclass(frozen=True)
class MemberSettings:
    """How members are mapped; `auto` is what `benchmarks/rollout.py` finds fastest."""

    how: Literal["auto", "vmap", "loop"] = "auto"
    sub_batch: int | None = None  # members per vmap; None: all
    devices: int | Literal["auto"] = "auto"  # JAX devices over which members are sharded
    optimisation: int | None = None  # of machine code: 0 (compiles fast, runs slower) to 3; None: compiler's
    recurrence: Literal["xla", "native", "auto"] = "auto"  # of GRU and dense layers; auto: C++ kernels if they compile


class TrainingSettings(NamedTuple):
    """name: of the model, for people and file names."""

    name: str
    model: ModelSpec
    fit: FitSettings
    run: RunSettings
    data: DataSettings
    members: MemberSettings


GROUPS: Mapping[str, type] = {name: kind for name, kind in TrainingSettings.__annotations__.items() if name != "name"}
GROUP_OF = {field.name: group for group, kind in GROUPS.items() for field in fields(kind)}


def training_settings(model: str | ModelSpec, *changes: Mapping[str, Any]) -> TrainingSettings:
    """The defaults with `changes` by name; later ones win over earlier ones, and all over those of the model's name.

    Raises `ValueError` for an unknown model or setting, and for a value that a setting cannot take.
    """
    name = model if isinstance(model, str) else "custom"
    own = variant_changes(model) if isinstance(model, str) else vars(model)
    given: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
    for key, value in {key: value for part in (own, *changes) for key, value in part.items()}.items():
        if key not in GROUP_OF:
            raise ValueError(f"settings: expected some of {sorted(GROUP_OF)}, found {key!r}")
        given[GROUP_OF[key]][key] = value
    return _checked(name, given)


def changed(settings: TrainingSettings, changes: Mapping[str, Any]) -> TrainingSettings:
    """The settings with `changes` by name. Raises `ValueError` as `training_settings`."""
    given = {group: asdict(getattr(settings, group)) for group in GROUPS}
    for key, value in changes.items():
        given[GROUP_OF[key]][key] = value
    return _checked(settings.name, given)


def settings_from_config(config: Mapping[str, Any], where: str = "configuration") -> TrainingSettings:
    """The settings of a configuration, in which those of a run stand at the top level and those of data beside the
    arguments of the loader. Old spellings are taken with a warning. where: the file, for messages. Raises `ValueError`
    as `training_settings`."""
    for group in ("model", "fit", "data", "members"):
        if not isinstance(config.get(group), Mapping):
            raise ValueError(f"{where}: {group}: expected a group of named values, found {config.get(group)!r}")
    given = {
        "model": {key: value for key, value in config["model"].items() if key != "name"},
        "fit": dict(config["fit"]),
        "run": _those_of(RunSettings, config),
        "data": _those_of(DataSettings, config["data"]),
        "members": {"recurrence": "xla", **config["members"]},  # of runs before there were kernels
    }
    if given["fit"].get("guard") == "retreat":
        warnings.warn("fit.guard: 'retreat' is now called 'rollback'", FutureWarning, stacklevel=2)
        given["fit"]["guard"] = "rollback"
    return _checked(str(config["model"].get("name", "custom")), given)


def _those_of(kind: type, group: Mapping[str, Any]) -> dict[str, Any]:
    return {field.name: group[field.name] for field in fields(kind) if field.name in group}


def differing(settings: TrainingSettings, names: Collection[str], usual: TrainingSettings) -> list[str]:
    """Those of `names` whose settings are not the usual ones."""
    found = {name: getattr(getattr(settings, GROUP_OF[name]), name) for name in names}
    return [name for name, value in found.items() if value != getattr(getattr(usual, GROUP_OF[name]), name)]


def config_key(name: str) -> str:
    """Where a setting stands in the configuration: `fit.learning_rate`, `initial_state`."""
    return name if GROUP_OF[name] == "run" else f"{GROUP_OF[name]}.{name}"


def settings_to_config(settings: TrainingSettings) -> dict[str, Any]:
    """The inverse of `settings_from_config`, as plain data."""
    groups = {group: asdict(getattr(settings, group)) for group in GROUPS}
    run = {**groups.pop("run"), "report_n_init": list(settings.run.report_n_init)}
    return {**groups, "model": {"name": settings.name, **groups["model"]}, **run}


def _checked(name: str, given: Mapping[str, Mapping[str, Any]]) -> TrainingSettings:
    groups = {group: call_with(kind, given[group], "" if group == "run" else group) for group, kind in GROUPS.items()}
    return TrainingSettings(name, **groups)
