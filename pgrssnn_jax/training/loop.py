"""The host's side of training: compile once, run chunk after chunk, watch, save, stop when asked.

    state, history = advance(state, data)        until every member has stopped or the last epoch is reached

A stop that is asked for (`entry.stop_signal`) ends the loop after the current chunk, so that the state is always a
whole one.
"""

import threading
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
import pandas as pd

from pgrssnn_jax.training.members import Member, MemberMapping, jit_members
from pgrssnn_jax.training.objective import MemberData
from pgrssnn_jax.training.optimise import Fit, FitSettings, History, MemberState, MemberStatus


class Losses(NamedTuple):
    """Mean squared scaled error per member and epoch, `[member, epoch]`; NaN where there is none."""

    train: np.ndarray
    validation: np.ndarray

    @property
    def epochs(self) -> int:
        return self.train.shape[1]


class Progress(NamedTuple):
    """What a person watching wants to know after a chunk."""

    epoch: int
    epochs: int
    train_loss: float
    best_validation: float
    training: int
    failed: int
    planned: int


class Training(NamedTuple):
    state: MemberState
    losses: Losses
    seconds: dict[str, float]
    interrupted: bool


def no_losses(members: int) -> Losses:
    return Losses(np.zeros((members, 0), np.float32), np.zeros((members, 0), np.float32))


def train(
    fit: Fit,
    mapping: MemberMapping,
    state: MemberState,
    data: MemberData,
    losses: Losses,
    *,
    on_chunk: Callable[[MemberState, Losses, Progress], None],
    stop: threading.Event,
) -> Training:
    """Trains all members from `state`, which a checkpoint may have given, and appends to `losses`.

    on_chunk is called after every chunk with the state on the device; what it does (a progress bar, a checkpoint) is
    the caller's matter; stop: looked at between chunks. One program is compiled, whatever the number of chunks; none
    where nothing is left to train.
    """
    settings = fit.settings
    seconds = {"compile": 0.0, "train": 0.0}
    if not jax.tree.leaves(state.theta) or done(state, losses, settings):
        return Training(state, losses, seconds, False)
    started = time.perf_counter()
    advance = jit_members(fit.advance, mapping, donated=0).lower(state, data).compile()
    seconds["compile"] = time.perf_counter() - started
    started = time.perf_counter()
    while not (finished := done(state, losses, settings)) and not stop.is_set():
        state, history = advance(state, data)
        losses = _append(losses, jax.device_get(history), settings)
        on_chunk(state, losses, progress(state, losses, settings))
    seconds["train"] = time.perf_counter() - started
    return Training(state, losses, seconds, not finished)


def done(state: MemberState, losses: Losses, settings: FitSettings) -> bool:
    return losses.epochs >= settings.epochs or not np.any(np.asarray(state.outcome) == MemberStatus.TRAINING)


def progress(state: MemberState, losses: Losses, settings: FitSettings) -> Progress:
    outcome, best = np.asarray(state.outcome), np.asarray(state.best_loss)
    finite = np.array([row[np.isfinite(row)][-1] for row in losses.train if np.isfinite(row).any()])
    return Progress(
        epoch=losses.epochs,
        epochs=settings.epochs,
        train_loss=float(np.median(finite)) if len(finite) else float("nan"),
        best_validation=float(np.min(best)),
        training=int(np.sum(outcome == MemberStatus.TRAINING)),
        failed=int(np.sum(outcome >= MemberStatus.STATE_NOT_FINITE)),
        planned=len(outcome),
    )


def _append(losses: Losses, history: History, settings: FitSettings) -> Losses:
    """Adds a chunk; epochs beyond the last one, which the fixed chunk length may hold, are cut off."""
    train = np.asarray(history.train).reshape(len(history.train), -1)
    validation = np.full_like(train, np.nan)
    validation[:, settings.validate_every - 1 :: settings.validate_every] = history.validation
    room = settings.epochs - losses.epochs
    if 0 < room < train.shape[1]:  # the last block may be cut short: its validation belongs to the last epoch
        cut = np.asarray(history.validation)[:, (room - 1) // settings.validate_every]
        train, validation = train[:, :room], validation[:, :room]
        validation[:, -1] = cut
    return Losses(np.concatenate([losses.train, train], 1), np.concatenate([losses.validation, validation], 1))


def losses_table(losses: Losses, members: Sequence[Member]) -> pd.DataFrame:
    """Rows epoch, seed, dataset, train_loss, validation_loss, one per member and epoch in which it trained.

    Members stand below each other.
    """
    n_members, epochs = losses.train.shape
    table = pd.DataFrame(
        {
            "epoch": np.tile(np.arange(1, epochs + 1), n_members),
            "seed": np.repeat([member.seed for member in members], epochs),
            "dataset": np.repeat([member.dataset for member in members], epochs),
            "train_loss": losses.train.ravel(),
            "validation_loss": losses.validation.ravel(),
        }
    )
    return table.dropna(subset=["train_loss", "validation_loss"], how="all").reset_index(drop=True)
