"""Training of a plan from its first epoch, or from a checkpoint, to its members: what the API and the command share."""

import threading
from collections.abc import Callable
from typing import Any

from rich.console import Console

from pgrssnn_jax.training.checkpoints import Checkpoint
from pgrssnn_jax.training.loop import Losses, Progress, Training, no_losses, progress, train
from pgrssnn_jax.training.members import jit_members, keys_of
from pgrssnn_jax.training.optimise import MemberState
from pgrssnn_jax.training.plan import Plan
from pgrssnn_jax.training.progress import training_bar

OnChunk = Callable[[MemberState, Losses, Progress], Any]


def first_checkpoint(plan: Plan) -> Checkpoint:
    """Fresh members before their first epoch."""
    begun = jit_members(plan.fit.begin, plan.mapping)(keys_of(plan.members), plan.data)
    return Checkpoint(begun, plan.data.scaling, plan.units, no_losses(len(plan.members)))


def train_members(
    plan: Plan, first: Checkpoint, console: Console, stop: threading.Event, on_chunk: OnChunk
) -> Training:
    """Trains with a progress bar until the last epoch, or until `stop` is set; on_chunk: called after every chunk."""
    with training_bar(console, plan.fit.settings.epochs) as show:
        if first.losses.epochs:
            show(progress(first.state, first.losses, plan.fit.settings))

        def after_chunk(state: MemberState, losses: Losses, now: Progress) -> None:
            show(now)
            on_chunk(state, losses, now)

        return train(plan.fit, plan.mapping, first.state, plan.data, first.losses, on_chunk=after_chunk, stop=stop)
