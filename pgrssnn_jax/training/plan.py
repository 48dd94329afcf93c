"""From a physics, its records and the settings to everything that training needs. All bad input is found here, before
a byte is written: every function raises `ValueError` with one sentence."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from pgrssnn_jax.acceleration.native import missing_kernels
from pgrssnn_jax.acceleration.room import make_room
from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.model import build_model
from pgrssnn_jax.models.rollout import Route
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Physics, Signal, measured_rate
from pgrssnn_jax.records.matching import matched
from pgrssnn_jax.records.record import Array, Record, cast, take
from pgrssnn_jax.records.scaling import Units, in_units, measured_units, standard_units
from pgrssnn_jax.records.splits import by_dataset, cut_windows, estimation_parts, kfold_masks
from pgrssnn_jax.training.members import Member, MemberMapping, choose_mapping, map_members
from pgrssnn_jax.training.objective import MemberData, Objective, build_objective
from pgrssnn_jax.training.optimise import Fit
from pgrssnn_jax.training.settings import TrainingSettings

_LARGEST = 1e18  # whose square is still a float32
# Samples x GRU layers x hidden units of an epoch that devices share: of 31 sequences, 127 000 were as fast by two
# devices as by one, 508 000 faster by 1.56; the measured arm (7 million) by 1.8.
_WORTH_SHARING = 250_000


class Plan(NamedTuple):
    """A training run before its first epoch.

    train: as measured, `[dataset, seq, time, channel]`; validation: as measured, per member; data: per member, in the
    units that the model works in; units: per member, from these to the measured ones.
    """

    settings: TrainingSettings
    fit: Fit
    mapping: MemberMapping
    members: list[Member]
    train: Record
    validation: Record
    data: MemberData
    units: Units

    @property
    def physics(self) -> Physics:
        return self.fit.objective.model.physics


class MemberTests(NamedTuple):
    """The test record of every member: as measured, and in the units that the model works in; n_inits: samples left out
    at its start, the first of them in the main figures."""

    measured: Record
    record: Record
    n_inits: list[int]


def plan_training(
    physics: Physics, train: Record, settings: TrainingSettings, *, validation: Record | None = None
) -> Plan:
    """train: `[seq, time, channel]`, or with a leading axis of datasets; validation: None takes the part that came with
    the data, or the tail of train."""
    make_room()
    train = matched(train, physics.inputs, physics.outputs, physics.dt, where="data: train")
    if validation is not None:
        validation = matched(validation, physics.inputs, physics.outputs, physics.dt, where="data: validation")
    one_record = validation is None and train.validation is None
    fitted, aside = estimation_parts(train, validation)
    if settings.data.window is not None:
        fitted = cut_windows(fitted, settings.data.window)
    fit = plan_fit(physics, settings, shared=train.info.start == "shared")
    model, initial = fit.objective.model, fit.objective.initial
    _check_varies(fitted)
    for name, record in (("train", fitted), ("validation", aside)):
        check_record(name, record, initial, physics, searched=name != "train" and not settings.data.folds)
    # Published scaling concerns the networks alone where some state is the rate of an output, and puts rates into the
    # units of their outputs (the arm); elsewhere the physics itself acts on standardised signals (LGSSM).
    has_rates = any(measured_rate(physics, state) for state in physics.states)
    rates_like_outputs = settings.data.published_scaling and has_rates
    standardised = settings.data.published_scaling and not has_rates
    units = (standard_units if standardised else measured_units)(fitted)
    own, other = ((in_units(r, units) if standardised else r) for r in (fitted, aside))
    differ = model.graph is not None or (settings.data.folds > 0 and fit.objective.train_physics)
    members = _members(settings, len(fitted.u), seeds_differ=differ)
    datasets = np.array([member.dataset for member in members])
    scalings = [model_scaling(model, take(own, i), rates_like_outputs=rates_like_outputs) for i in range(len(fitted.u))]
    scaling = jax.tree.map(lambda *a: np.stack(a)[datasets].astype(np.float32), *scalings)
    own, other = (cast(record, np.float32) for record in _per_member(own, other, members, settings, one_record))
    data = MemberData(own, other, scaling, np.full(len(members), settings.fit.epochs, np.int32))
    native = fit.objective.route == "native"
    mapping = member_mapping(settings, len(members), data.train.u.shape[1], native=native)
    if native and len(members) == 1 and settings.members.devices == "auto":
        devices = sharing_devices(settings.model, *data.train.u.shape[1:3])
        fit = fit._replace(objective=fit.objective._replace(devices=devices))
    _, measured = _per_member(fitted, aside, members, settings, one_record)
    own_units = jax.tree.map(lambda a: a[datasets], units)
    return Plan(settings, fit, mapping, members, fitted, measured, data, own_units)


def plan_fit(physics: Physics, settings: TrainingSettings, *, shared: bool) -> Fit:
    """Model and objective, without data; shared: the test record starts where the training record does."""
    initial = InitialState(settings.run.initial_state, settings.run.n_init, shared)
    train_physics = settings.fit.physics_parameters == "trained"
    if not physics.differentiable and (train_physics or initial.trained):
        what = "fit.physics_parameters=trained" if train_physics else f"initial_state={initial.kind}"
        raise ValueError(
            f"physics.physics_gradient: expected full with {what}, which needs the gradient, found stopped"
        )
    model = build_model(settings.model, physics)
    route = chosen_route(settings)
    return Fit(build_objective(model, initial, train_physics=train_physics, route=route), settings.fit)


def chosen_route(settings: TrainingSettings) -> Route | None:
    """The route of training for `members.recurrence`; None: the fastest in XLA, by which every run is evaluated.

    Raises `ValueError` for `native` where the kernel cannot be had; `auto` does without it.
    """
    spec, asked = settings.model, settings.members.recurrence
    if asked == "xla":
        return None
    if not settings.run.accelerate:
        missing = "accelerate=false switches the C++ kernels off"
    elif spec.feedback or not (spec.networks and spec.recurrent):
        missing = "the C++ kernels are for models with a GRU and without state feedback"
    else:
        missing = missing_kernels()
    if missing and asked == "native":
        raise ValueError(f"members.recurrence: expected xla or auto here, found native: {missing}")
    return None if missing else "native"


def member_tests(
    objective: Objective, members: Sequence[Member], units: Units, wanted: Sequence[int], test: Record
) -> MemberTests:
    """A test record `[seq, time, channel]` for all members, or one per dataset; wanted: `RunSettings.report_n_init`."""
    physics, initial = objective.model.physics, objective.initial
    datasets = np.array([member.dataset for member in members])
    test = by_dataset(matched(test, physics.inputs, physics.outputs, physics.dt, where="data: test"))
    count = datasets.max() + 1
    if len(test.u) == 1 and count > 1:
        test = take(test, np.zeros(count, int))
    if len(test.u) != count:
        raise ValueError(f"data: test: expected one record, or {count}, one per dataset, found {len(test.u)}")
    check_record("test", test, initial, physics)
    measured = take(test, datasets)
    identity = all(np.all(a.scale == 1.0) and np.all(a.offset == 0.0) for a in units)
    own = measured if identity else in_units(measured, units)
    return MemberTests(measured, cast(own, np.float32), _windows_to_report(initial, wanted, test))


def sharing_devices(spec: ModelSpec, sequences: int, samples: int) -> int:
    """How many devices share the training sequences of a single member."""
    work = sequences * samples * spec.gru_layers * spec.hidden
    return min(jax.device_count(), sequences) if work >= _WORTH_SHARING else 1


def member_mapping(
    settings: TrainingSettings, n_members: int, n_sequences: int, *, native: bool = False
) -> MemberMapping:
    """`auto` is resolved by what the benchmark found: see `members.choose_mapping`. With `accelerate=false` one device
    and no options of the compiler."""
    chosen = settings.members
    best = choose_mapping(n_members, n_sequences, jax.device_count(), native=native)
    how = best.how if chosen.how == "auto" else chosen.how
    devices = best.devices if chosen.devices == "auto" else chosen.devices
    mapping = MemberMapping(how, chosen.sub_batch, devices, chosen.optimisation)
    if not settings.run.accelerate:
        mapping = MemberMapping(how, chosen.sub_batch)
    map_members(lambda: None, mapping)  # raises for what this machine does not have
    return mapping


def check_record(name: str, record: Record, initial: InitialState, physics: Physics, *, searched: bool = True) -> None:
    """Raises `ValueError` for values that no float32 holds or no unit explains, and for too few samples; searched: is
    its start found from its first samples, where starts are estimated?"""
    time = record.u.shape[2]
    mask = np.asarray(record.mask)
    if not mask.any():
        raise ValueError(f"data.{name}: expected at least one measured output, found none in {record.info.origin}")
    for k, signal in enumerate(physics.outputs):
        check_range(f"data: {name}", signal, np.asarray(record.y)[..., k][mask[..., k]])
    for values in (record.u, np.where(mask, record.y, 0.0)):
        check_size(f"data: {name}", values)
    if searched and initial.trained and time <= initial.n_init:
        raise ValueError(f"n_init: expected fewer than the {time} samples of the {name} record, found {initial.n_init}")


def _check_varies(train: Record) -> None:
    """Raises `ValueError` for a record none of whose outputs varies: there is nothing to learn."""
    y = np.where(train.mask, train.y, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output that was never measured
        spread = np.nanmax(y, (0, 1, 2)) - np.nanmin(y, (0, 1, 2))
    if not (spread > 0).any() and np.isfinite(y).any():
        value = f"{y[np.isfinite(y)][0]:.3g}"
        raise ValueError(
            f"data: train: expected an output that varies, found {value} everywhere in {train.info.origin}"
        )


def check_size(where: str, values: Array) -> None:
    """Raises `ValueError` for values whose squares no float32 holds."""
    if (largest := np.abs(values).max()) > _LARGEST:
        raise ValueError(f"{where}: expected values up to {_LARGEST:g}, found {largest:g}")


def check_range(where: str, signal: Signal, values: np.ndarray) -> None:
    """Raises `ValueError` when values cannot be in the unit of their signal."""
    low, high = signal.range
    if values.size and not (low <= values.min() and values.max() <= high):
        raise ValueError(
            f"{where}: {signal.name}: expected {low:.3g} to {high:.3g} {signal.unit}, found values from "
            f"{values.min():.3g} to {values.max():.3g}: are they in {signal.unit}?"
        )


def _members(settings: TrainingSettings, n_datasets: int, *, seeds_differ: bool) -> list[Member]:
    """Every dataset with every seed; one seed where members of several would be the same."""
    count = settings.run.n_seeds if seeds_differ else 1
    return [Member(settings.run.seed + i, dataset) for dataset in range(n_datasets) for i in range(count)]


def _per_member(
    train: Record, validation: Record, members: list[Member], settings: TrainingSettings, one_record: bool
) -> tuple[Record, Record]:
    datasets = np.array([member.dataset for member in members])
    train, validation = take(train, datasets), take(validation, datasets)
    if not settings.data.folds:
        return train, validation
    seeds = [member.seed for member in members]
    shared = settings.data
    return kfold_masks(train, validation, seeds, shared.folds, shared.block, lead=shared.lead, one_record=one_record)


def _windows_to_report(initial: InitialState, wanted: Sequence[int], test: Record) -> list[int]:
    """Test samples from which the initial state was found never count in the main figure."""
    time = test.u.shape[2]
    used = 0 if initial.shared else initial.n_init if initial.trained else int(initial.kind == "first_output")
    windows = list(dict.fromkeys(max(n, used) for n in wanted if max(n, used) < time))
    if not windows:
        raise ValueError(
            f"report_n_init: expected a count below the {time} samples of the test record"
            f"{f' and of at least {used}' if used else ''}, found {list(wanted)}"
        )
    return windows
