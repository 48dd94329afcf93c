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
the start of records, it is always found by least squares; where they start at rest it is zero, and a simulation needs
no measured value. A physics that discovery has fitted to the record is trained on with the default settings and
networks that start at zero: no part of the record can tell which are better.
Source of the rounds: Jamieson and Talwalkar, Non-stochastic best arm identification, AISTATS 2016.
"""

import math
import threading
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.simulate import has_forward_mode
from pgrssnn_jax.records.record import Record, Start, continues
from pgrssnn_jax.records.splits import is_later
from pgrssnn_jax.training.blocks import memory
from pgrssnn_jax.training.candidates import Starts, candidates, describe, is_alone
from pgrssnn_jax.training.members import for_one_run, jit_members
from pgrssnn_jax.training.objective import MemberData
from pgrssnn_jax.training.optimise import MemberState
from pgrssnn_jax.training.plan import Plan
from pgrssnn_jax.training.race import Tried, clearly_better, race
from pgrssnn_jax.training.recipes import recipe_for
from pgrssnn_jax.training.settings import TrainingSettings, changed

SCORE = "left-out NRMSE"
_GAIN = 0.1  # of log E, 10 % of the squared error: less is not worth what networks may do outside their range
_HALF = math.log(4.0)  # of log E, half the error: what counts where blocks are shorter than the system remembers
_FOLDS = (5, 10)  # of the members: least and most
_TRYING_FOLDS = 5  # at most, of the members that try candidates
_BLOCK = 32  # samples
_LEAD = 20  # one part in so many of a record tells all members where it starts
_INIT = 4  # and the start of a test record is found from as many samples as one part in so many of the record
_FOUND: dict[Start, Starts] = {"unknown": "always", "shared": "perhaps", "rest": "never"}  # starts, by least squares
_PATIENCE = 0.5  # of the epochs: corrections may rest on a plateau before they find their way (`_TANKS` in recipes.py)


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
        settings = _from_physics(physics, train, settings, held)
        notify("recipe=auto: training starts at the physics, because discovery has seen what members would leave out")
        return Chosen(settings, [], time.perf_counter() - started)
    starts = _starts(physics, train)
    trying, short = settings, False
    if not {"folds", "block"} & set(held):
        trying, short = _with_long_blocks(settings, physics, train, validation)
    if short:
        notify("recipe=auto: the physics alone, because it remembers more than half of the only record")
    if not (settings.data.folds and has_forward_mode(physics)):
        starts = "never"
    among = candidates(settings, physics, held, usual, starts=starts, networks=not short)
    tried = [] if stop.is_set() else race(physics, train, validation, trying, among, stop, notify)
    if stop.is_set():
        return None
    best = clearly_better(tried, _HALF if short else _GAIN)
    tried = sorted(tried, key=lambda one: (one is not best, one.score))
    nominal = min((one for one in tried if is_alone(one.settings)), key=lambda one: one.score, default=best)
    beside = "" if nominal is best else f" (physics alone {nominal.nrmse:.3g})"
    notify(f"recipe=auto: {describe(best.settings)}; {SCORE} {best.nrmse:.3g}{beside}")
    return Chosen(best.settings, tried, time.perf_counter() - started)


def on_fitted(
    physics: Physics, train: Record, validation: Record | None, settings: TrainingSettings, held: Collection[str]
) -> TrainingSettings:
    """Settings for a physics that was fitted to the record, without a choice: training starts at the physics, and
    members take turns in what they leave out, where they can."""
    follows = _of_record(train, validation, settings, {"initial_state": settings.run.initial_state})
    settings = changed(settings, {name: value for name, value in follows.items() if name not in held})
    return _from_physics(physics, train, settings, held)


def _from_physics(
    physics: Physics, train: Record, settings: TrainingSettings, held: Collection[str]
) -> TrainingSettings:
    starts = _starts(physics, train)
    estimated = starts == "always" or (starts == "perhaps" and settings.data.folds)
    start = "estimated" if estimated else settings.run.initial_state
    after = {"start_from_physics": True, "initial_state": start}
    return changed(settings, {name: value for name, value in after.items() if name not in held})


def _starts(physics: Physics, train: Record) -> Starts:
    return _FOUND[train.info.start] if physics.differentiable else "never"


def _of_record(
    train: Record, validation: Record | None, settings: TrainingSettings, usual: Mapping[str, Any]
) -> dict[str, Any]:
    """Settings that follow from the record alone: its folds and blocks, where it starts, how long to wait."""
    n_seq, (samples, shared, _) = train.u.shape[-3], _shared(train, validation)
    usual_start = usual.get("initial_state", "zero" if train.info.start == "rest" else "first_output")
    follows: dict[str, Any] = {
        "patience": max(1, int(_PATIENCE * settings.fit.epochs)),
        "initial_state": "first_output" if usual_start in ("estimated", "least_squares") else usual_start,
    }
    if not shared or settings.data.window is not None:
        return follows
    folds = min(max(settings.run.n_seeds, _FOLDS[0]), _FOLDS[1])
    if n_seq < folds:
        folds = max(2, min(folds, samples // 2))
    block, n_init = max(1, min(_BLOCK, samples // folds)), max(1, min(settings.run.n_init, samples // _INIT))
    lead = min(n_init, samples // _LEAD)
    if train.info.start == "rest":
        lead = 0  # nobody has to find the start, so that some members leave it out as they leave out the rest
    elif n_seq >= folds and train.info.start == "unknown":
        lead = n_init  # the start of a sequence that is left out whole is found as that of a test record is
    return {**follows, "folds": folds, "block": block, "lead": lead, "n_init": n_init}


def _with_long_blocks(
    settings: TrainingSettings, physics: Physics, train: Record, validation: Record | None
) -> tuple[TrainingSettings, bool]:
    """The settings with the folds of the members that try candidates: each leaves out blocks as long as the system
    remembers, where the record has room for them. True where it remembers more than half of the record, so that nothing
    in it tells how networks do in a free run."""
    n_seq, (samples, _, later) = train.u.shape[-3], _shared(train, validation)
    if not settings.data.folds or n_seq >= settings.data.folds or not settings.model.guided:
        return settings, False
    folds, longest = min(_TRYING_FOLDS, samples // 2), memory(physics, _first(train))
    block = min(max(longest, settings.data.block), samples // folds)
    return changed(settings, {"folds": folds, "block": block}), longest > samples // 2 and not later


def _shared(train: Record, validation: Record | None) -> tuple[int, bool, bool]:
    """How many samples of a sequence members can share, whether they can at all, and whether a later part of the same
    measurement validates besides."""
    samples, aside = train.u.shape[-2], train.validation if validation is None else validation
    if aside is None:
        return samples, True, False
    first, second = _first(train), _first(aside)
    if continues(first, second):
        return samples + second.u.shape[-2], True, False
    later = is_later(first, second)
    return samples, later, later


def _first(record: Record) -> Record:
    """The first dataset."""
    return record if record.u.ndim == 3 else jax.tree.map(lambda a: a[0], record._replace(validation=None))


def settled(
    plan: Plan, state: MemberState, recipe: Mapping[str, Any] | None
) -> tuple[MemberState, dict[str, Any] | None]:
    """The members after training, of which those that are no better than the physics alone on what they leave out are
    it from here on, and the report of the choice that names them. recipe: `Chosen.report`; None: settings that were
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
        state, back = jit_members(one, for_one_run(plan.mapping))(state, plan.data)
    fell_back = [m._asdict() for m, b in zip(plan.members, np.asarray(back), strict=True) if b]
    return state, {**recipe, "fell_back": fell_back}
