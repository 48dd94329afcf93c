"""Candidates that are trained side by side in rounds, and the test that decides between them (`choose.py`)."""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training.candidates import choice_of, is_alone, shared_settings
from pgrssnn_jax.training.left_out import at_epoch_of_others
from pgrssnn_jax.training.members import jit_members, keys_of, repeat
from pgrssnn_jax.training.optimise import MemberState
from pgrssnn_jax.training.plan import Plan, plan_training
from pgrssnn_jax.training.settings import TrainingSettings, changed

_ROUNDS = (0.05, 0.15, 0.3)  # of the epochs
_KEEP = 3  # one candidate of so many goes on to the next round
_LAST = 2  # but so many into the last one: of slow and steady candidates the first rounds say little
_STEADY = 3  # validations, of which the median counts: one that is good between bad ones is luck
_LARGE, _SMALL = 1e9, 1e-12  # squared scaled error of what has left the range, and of what no float32 tells from none
_SURE = 0.75  # level of the test: less certain gains are left to the physics
_TRYING = 5  # members, at most, that try a candidate where all leave out the same record


class Tried(NamedTuple):
    """Settings and the errors of every member on what it left out, mean squared and scaled, before training and after
    every validation: curves `[member, validation]`; epochs: of training."""

    settings: TrainingSettings
    curves: np.ndarray
    epochs: int

    @property
    def left_out(self) -> np.ndarray:
        """log E `[member]`: every member at the epoch that is best for the others, so that what it leaves out has no
        part in the choice of the epoch. E: running median over validations."""
        windows = sliding_window_view(self.curves, min(_STEADY, self.curves.shape[1]), axis=1)
        return np.log(at_epoch_of_others(np.median(windows, -1) + _SMALL))

    @property
    def score(self) -> float:
        return float(np.mean(self.left_out))

    @property
    def nrmse(self) -> float:
        return math.exp(0.5 * self.score)


def race(
    physics: Physics,
    train: Record,
    validation: Record | None,
    settings: TrainingSettings,
    among: Sequence[TrainingSettings],
    stop: threading.Event,
    notify: Callable[[str], None],
) -> list[Tried]:
    """Every candidate with its errors after the last round that it took part in."""
    members = settings.data.folds or settings.run.n_seeds
    every = settings.fit.validate_every
    per_call = every * math.ceil(_ROUNDS[0] * settings.fit.epochs / every)
    shared = changed(
        shared_settings(settings, among),
        {"n_seeds": members, "patience": max(1, settings.fit.epochs), "chunk_epochs": max(every, per_call)},
    )
    plan = _smaller(plan_training(physics, train, shared, validation=validation))
    choices = [plan.data._replace(choice=repeat(choice_of(one, among), len(plan.members))) for one in among]
    begin, keys = jit_members(plan.fit.begin, plan.mapping), keys_of(plan.members)
    states: list[MemberState] = [begin(keys, data) for data in choices]
    curves = [_finite(state.best_loss)[:, None] for state in states]
    advance = jit_members(plan.fit.advance, plan.mapping).lower(states[0], choices[0]).compile()
    trained, going = [0] * len(among), [i for i, one in enumerate(among) if _trains(one)]

    def tried() -> list[Tried]:
        return [Tried(*one) for one in zip(among, curves, trained, strict=True)]

    for share in _ROUNDS:
        epochs = max(1, math.ceil(share * settings.fit.epochs))
        ends = jnp.full(len(plan.members), epochs, jnp.int32)
        for i in going:
            while trained[i] < epochs and not stop.is_set():
                states[i], history = advance(states[i], choices[i]._replace(last_epoch=ends))
                curves[i] = np.concatenate([curves[i], _finite(history.validation)], axis=1)
                trained[i] = min(trained[i] + per_call, epochs)
        notify(f"recipe=auto: {len(going)} of {len(among)} candidates after {epochs} epochs")
        scores = [one.score for one in tried()]
        going = sorted(going, key=scores.__getitem__)[: max(_LAST, math.ceil(len(going) / _KEEP))]
    return tried()


def _finite(losses: Any) -> np.ndarray:
    """Losses in which that of a member that stands still, or has left the range, is too large to be the best."""
    return np.nan_to_num(np.asarray(losses, np.float64), nan=_LARGE, posinf=_LARGE)


def _smaller(plan: Plan) -> Plan:
    """At most as many members as a choice needs."""
    most = max(plan.settings.data.folds, _TRYING)
    if len(plan.members) <= most:
        return plan
    some = np.linspace(0, len(plan.members) - 1, most).round().astype(int)
    members = [plan.members[i] for i in some]
    return plan._replace(
        members=members,
        data=jax.tree.map(lambda a: np.asarray(a)[some], plan.data),
        mapping=replace(plan.mapping, devices=min(plan.mapping.devices, most)),
    )


def clearly_better(tried: Sequence[Tried], least: float) -> Tried:
    """The best candidate of the simplest kind that no other kind clearly beats; least: gain of log E that counts. Of
    networks, those with the smallest corrections that do as well as the best."""
    kinds: list[list[Tried]] = [[], [], []]
    for one in tried:
        kinds[_kind(one.settings)].append(one)
    first, *others = (_gentlest(kind) for kind in kinds if kind)
    chosen = first
    for other in others:
        if _beats(other, chosen, least):
            chosen = other
    return chosen


def _gentlest(kind: Sequence[Tried]) -> Tried:
    best = min(kind, key=lambda one: one.score)
    as_good = [one for one in kind if one.epochs == best.epochs and not _beats(best, one, 0.0)]
    return min(as_good, key=lambda one: (one.settings.model.correction, one.score))


def _beats(other: Tried, simpler: Tried, least: float) -> bool:
    gains, count = simpler.left_out - other.left_out, len(simpler.left_out)
    doubt = scipy.stats.t.ppf(_SURE, count - 1) * np.std(gains, ddof=1) / math.sqrt(count) if count > 1 else 0.0
    return bool(np.mean(gains) > max(doubt, least))


def _kind(settings: TrainingSettings) -> int:
    """0: the physics alone, 1: with its parameters trained, 2: with networks."""
    return 0 if is_alone(settings) else 1 if not settings.model.networks else 2


def _trains(settings: TrainingSettings) -> bool:
    return not is_alone(settings) or settings.run.initial_state == "least_squares"
