"""`recipe=auto`: settings chosen on what members leave out, then trained with as if they had been given.

    score(settings) = mean over members of log E(m),    E(m): mean squared scaled error of member m on the blocks that
                      it leaves out, at the epoch that is best for the other members

Every member leaves out other blocks of the estimation record, so that together they leave out all of it
(`records/splits.py`); a validation record of its own is left out by all. Here the blocks are as long as the system
remembers, where the record has room for them (`blocks.py`); the members that are trained afterwards leave out short
ones, and lose less of the record. The candidates are trained one after another by one program, in rounds: after a
twentieth of the epochs the best third goes on, and so again, until the best after three tenths is chosen. The physics
alone is always among them, and others replace it only if they beat it in a one-sided t test of the members'
differences. Where the physics remembers more than half of the only record, it is alone, and its parameters are trained
only if that halves the error: in such a record nothing tells how a model does in a free run. Where nothing is known of
the start of records, it is always found by least squares. A physics that discovery has fitted to the record is trained
on with the default settings and networks that start at zero: no part of the record can tell which are better.
Source of the rounds: Jamieson and Talwalkar, Non-stochastic best arm identification, AISTATS 2016.
"""

import math
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import t as student

from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Record, continues
from pgrssnn_jax.records.splits import is_later
from pgrssnn_jax.training.blocks import memory
from pgrssnn_jax.training.candidates import Starts, candidates, choice_of, shared_settings
from pgrssnn_jax.training.left_out import at_epoch_of_others
from pgrssnn_jax.training.members import jit_members, keys_of, repeat
from pgrssnn_jax.training.objective import MemberData
from pgrssnn_jax.training.optimise import MemberState
from pgrssnn_jax.training.plan import Plan, plan_training
from pgrssnn_jax.training.recipes import recipe_for
from pgrssnn_jax.training.settings import TrainingSettings, changed

SCORE = "left-out NRMSE"
_ROUNDS = (0.05, 0.15, 0.3)  # of the epochs
_KEEP = 3  # one candidate of so many goes on to the next round
_GAIN = 0.1  # of log E, 10 % of the squared error: less is not worth what networks may do outside their range
_HALF = math.log(4.0)  # of log E, half the error: what counts where blocks are shorter than the system remembers
_LARGE, _SMALL = 1e9, 1e-12  # squared scaled error of what has left the range, and of what no float32 tells from none
_SURE = 0.75  # level of the test: less certain gains are left to the physics
_FOLDS = (5, 10)  # of the members: least and most
_TRYING_FOLDS = 5  # at most, of the members that try candidates
_TRYING = 5  # members, at most, that try a candidate where all leave out the same record
_BLOCK = 32  # samples
_LEAD = 20  # one part in so many of a record tells all members where it starts
_INIT = 4  # and the start of a test record is found from as many samples as one part in so many of the record
_PATIENCE = 0.5  # of the epochs: corrections may rest on a plateau before they find their way (`_TANKS` in recipes.py)


class Tried(NamedTuple):
    """Settings and the errors of every member on what it left out, mean squared and scaled, before training and after
    every validation: curves `[member, validation]`; epochs: of training."""

    settings: TrainingSettings
    curves: np.ndarray
    epochs: int

    @property
    def left_out(self) -> np.ndarray:
        """log E `[member]`: every member at the epoch that is best for the others, so that what it leaves out has no
        part in the choice of the epoch."""
        return np.log(at_epoch_of_others(self.curves + _SMALL))

    @property
    def score(self) -> float:
        return float(np.mean(self.left_out))

    @property
    def nrmse(self) -> float:
        return math.exp(0.5 * self.score)


class Chosen(NamedTuple):
    """settings: to train with; tried: all candidates, the chosen one first; seconds: that this took."""

    settings: TrainingSettings
    tried: list[Tried]
    seconds: float

    def report(self) -> dict[str, Any]:
        """What `metrics.json` and `config.yaml` say of the choice."""
        tried = [{"settings": describe(t.settings), "left_out_nrmse": t.nrmse, "epochs": t.epochs} for t in self.tried]
        return {"name": "auto", "chosen": describe(self.settings), "score": SCORE, "tried": tried}


def choose_settings(
    physics: Physics,
    train: Record,
    settings: TrainingSettings,
    held: Collection[str],
    *,
    validation: Record | None = None,
    stop: threading.Event,
    notify: Callable[[str], None],
) -> Chosen | None:
    """settings: the defaults with those that were given; held: the names of the latter, which stay as they are. None
    when stopped. Raises `ValueError` as `plan_training`."""
    started = time.perf_counter()
    usual = recipe_for(train.info.benchmark).split(discovered=physics.discovered)[1]
    follows = _of_record(train, validation, settings, usual)
    settings = changed(settings, {name: value for name, value in follows.items() if name not in held})
    if physics.discovered and settings.data.folds:
        start = "estimated" if physics.differentiable else settings.run.initial_state
        after = {"start_from_physics": True, "initial_state": start}
        settings = changed(settings, {name: value for name, value in after.items() if name not in held})
        notify("recipe=auto: training starts at the physics, because discovery has seen what members would leave out")
        return Chosen(settings, [], time.perf_counter() - started)
    race, short = settings, False
    if not {"folds", "block"} & set(held):
        race, short = _with_long_blocks(settings, physics, train, validation)
    if short:
        notify("recipe=auto: the physics alone, because it remembers more than half of the only record")
    starts: Starts = "never"
    if settings.data.folds and physics.differentiable:
        starts = "always" if train.info.start == "unknown" else "perhaps"
    among = candidates(settings, physics, held, usual, starts=starts, networks=not short)
    tried = [] if stop.is_set() else _race(physics, train, validation, race, among, stop, notify)
    if stop.is_set():
        return None
    best = _clearly_better(tried, _HALF if short else _GAIN)
    tried = sorted(tried, key=lambda one: (one is not best, one.score))
    nominal = min((one for one in tried if is_alone(one.settings)), key=lambda one: one.score, default=best)
    beside = "" if nominal is best else f" (physics alone {nominal.nrmse:.3g})"
    notify(f"recipe=auto: {describe(best.settings)}; {SCORE} {best.nrmse:.3g}{beside}")
    return Chosen(best.settings, tried, time.perf_counter() - started)


def _of_record(
    train: Record, validation: Record | None, settings: TrainingSettings, usual: Mapping[str, Any]
) -> dict[str, Any]:
    """Settings that follow from the record alone: its folds and blocks, where it starts, how long to wait."""
    aside = train.validation if validation is None else validation
    n_seq, samples = train.u.shape[-3:-1]
    usual_start = usual.get("initial_state", "zero" if train.info.start == "rest" else "first_output")
    follows: dict[str, Any] = {
        "patience": max(1, int(_PATIENCE * settings.fit.epochs)),
        "initial_state": "first_output" if usual_start in ("estimated", "least_squares") else usual_start,
    }
    first, second = (None if r is None else _first(r) for r in (train, aside))
    whole = second is None or (first is not None and (continues(first, second) or is_later(first, second)))
    if not whole or settings.data.window is not None:
        return follows
    if second is not None and first is not None and continues(first, second):
        samples += second.u.shape[-2]
    folds = min(max(settings.run.n_seeds, _FOLDS[0]), _FOLDS[1])
    if n_seq < folds:
        folds = max(2, min(folds, samples // 2))
    block, n_init = max(1, min(_BLOCK, samples // folds)), max(1, min(settings.run.n_init, samples // _INIT))
    # the start of a sequence that is left out whole is found as that of a test record is
    lead = n_init if n_seq >= folds and train.info.start == "unknown" else min(n_init, samples // _LEAD)
    return {**follows, "folds": folds, "block": block, "lead": lead, "n_init": n_init}


def _with_long_blocks(
    settings: TrainingSettings, physics: Physics, train: Record, validation: Record | None
) -> tuple[TrainingSettings, bool]:
    """The settings with the folds of the members that try candidates: each leaves out blocks as long as the system
    remembers, where the record has room for them. True where it remembers more than half of the record, so that nothing
    in it tells how networks do in a free run."""
    n_seq, samples = train.u.shape[-3:-1]
    if not settings.data.folds or n_seq >= settings.data.folds or not settings.model.guided:
        return settings, False
    aside = train.validation if validation is None else validation
    first, second = (None if r is None else _first(r) for r in (train, aside))
    own = second is not None and first is not None and is_later(first, second)
    if first is not None and second is not None and continues(first, second):
        samples += second.u.shape[-2]
    folds, longest = min(_TRYING_FOLDS, samples // 2), memory(physics, _first(train))
    block = min(max(longest, settings.data.block), samples // folds)
    return changed(settings, {"folds": folds, "block": block}), longest > samples // 2 and not own


def _first(record: Record) -> Record:
    """The first dataset."""
    return record if record.u.ndim == 3 else jax.tree.map(lambda a: a[0], record._replace(validation=None))


def _race(
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
    shared = changed(shared_settings(settings, among), {"n_seeds": members, "patience": settings.fit.epochs})
    plan = _smaller(plan_training(physics, train, shared, validation=validation))
    choices = [plan.data._replace(choice=repeat(choice_of(one), len(plan.members))) for one in among]
    begin, keys = jit_members(plan.fit.begin, plan.mapping), keys_of(plan.members)
    states: list[MemberState] = [begin(keys, data) for data in choices]
    curves = [_finite(state.best_loss)[:, None] for state in states]
    advance = jit_members(plan.fit.advance, plan.mapping).lower(states[0], choices[0]).compile()
    per_call = plan.fit.settings.blocks * plan.fit.settings.validate_every
    trained, going = [0] * len(among), list(range(len(among)))

    def tried() -> list[Tried]:
        return [Tried(*one) for one in zip(among, curves, trained, strict=True)]

    for share in _ROUNDS:
        epochs = max(1, math.ceil(share * settings.fit.epochs))
        ends = jnp.full(len(plan.members), epochs, jnp.int32)
        for i in going:
            while trained[i] < epochs and _trains(among[i]) and not stop.is_set():
                states[i], history = advance(states[i], choices[i]._replace(last_epoch=ends))
                curves[i] = np.concatenate([curves[i], _finite(history.validation)], axis=1)
                trained[i] = min(trained[i] + per_call, epochs)
        notify(f"recipe=auto: {len(going)} of {len(among)} candidates after {epochs} epochs")
        scores = [one.score for one in tried()]
        going = sorted(going, key=scores.__getitem__)[: math.ceil(len(going) / _KEEP)]
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


def _clearly_better(tried: Sequence[Tried], least: float) -> Tried:
    """The best candidate of the simplest kind that no other kind clearly beats; least: gain of log E that counts."""
    kinds: list[list[Tried]] = [[], [], []]
    for one in tried:
        kinds[_kind(one.settings)].append(one)
    first, *others = (min(kind, key=lambda one: one.score) for kind in kinds if kind)
    chosen = first
    for other in others:
        if _beats(other, chosen, least):
            chosen = other
    return chosen


def _beats(other: Tried, simpler: Tried, least: float) -> bool:
    gains, count = simpler.left_out - other.left_out, len(simpler.left_out)
    doubt = student.ppf(_SURE, count - 1) * np.std(gains, ddof=1) / math.sqrt(count) if count > 1 else 0.0
    return bool(np.mean(gains) > max(doubt, least))


def _kind(settings: TrainingSettings) -> int:
    """0: the physics alone, 1: with its parameters trained, 2: with networks."""
    return 0 if is_alone(settings) else 1 if not settings.model.networks else 2


def _trains(settings: TrainingSettings) -> bool:
    return not is_alone(settings) or settings.run.initial_state == "least_squares"


def is_alone(settings: TrainingSettings) -> bool:
    """Is nothing trained but, perhaps, the start?"""
    return not settings.model.networks and settings.fit.physics_parameters == "fixed"


def describe(settings: TrainingSettings) -> str:
    """One line for people."""
    fitted = settings.fit.physics_parameters == "trained"
    if not settings.model.networks:
        words = ["the physics alone", *(["its parameters trained"] if fitted else [])]
        return ", ".join([*words, f"initial_state={settings.run.initial_state}"])
    words = [f"correction={settings.model.correction:g}"] if settings.model.guided else []
    words += ["start_from_physics=true"] if settings.model.start_from_physics and settings.model.guided else []
    words += [f"learning_rate={settings.fit.learning_rate:g}"]
    words += ["physics_parameters=trained"] if fitted else []
    return ", ".join([*words, f"initial_state={settings.run.initial_state}"])


def settled(
    plan: Plan, state: MemberState, recipe: Mapping[str, Any] | None
) -> tuple[MemberState, dict[str, Any] | None]:
    """The members after training, of which those that are no better than the physics alone on what they leave out are
    it from here on, and the report of the choice with their seeds. recipe: `Chosen.report`; None: settings that were
    given, with which nothing is changed."""
    if recipe is None:
        return state, None
    objective, back = plan.fit.objective, np.zeros(len(plan.members), bool)

    def one(state: MemberState, data: MemberData) -> tuple[MemberState, jax.Array]:
        alone = objective.alone(state.best, data)
        loss = objective.on_validation(alone, data).mean
        back = ~(state.best_loss < loss) & jnp.isfinite(loss)
        best = jax.tree.map(lambda a, b: jnp.where(back, a, b), alone, state.best)
        return state._replace(best=best, best_loss=jnp.where(back, loss, state.best_loss)), back

    if plan.settings.model.guided and jax.tree.leaves(state.theta):
        state, back = jit_members(one, plan.mapping)(state, plan.data)
    return state, {**recipe, "fell_back": [m.seed for m, b in zip(plan.members, np.asarray(back), strict=True) if b]}
