"""Training of a plan from its first epoch, or from a checkpoint, to its members: what the API and the command share."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from pgrssnn_jax.training.checkpoints import Checkpoint
from pgrssnn_jax.training.loop import Losses, Progress, Training, no_losses, progress, train
from pgrssnn_jax.training.members import jit_members, keys_of
from pgrssnn_jax.training.optimise import MemberState
from pgrssnn_jax.training.plan import Plan


def first_checkpoint(plan: Plan) -> Checkpoint:
    """Fresh members before their first epoch."""
    begun = jit_members(plan.fit.begin, plan.mapping)(keys_of(plan.members), plan.data)
    return Checkpoint(begun, plan.data.scaling, plan.units, no_losses(len(plan.members)))


def train_members(
    plan: Plan,
    first: Checkpoint,
    console: Console,
    stop: threading.Event,
    on_chunk: Callable[[MemberState, Losses, Progress], Any],
) -> Training:
    """Trains with a progress bar until the last epoch, or until `stop` is set; on_chunk: called after every chunk."""
    with _training_bar(console, plan.fit.settings.epochs) as show:
        if first.losses.epochs:
            show(progress(first.state, first.losses, plan.fit.settings))

        def after_chunk(state: MemberState, losses: Losses, now: Progress) -> None:
            show(now)
            on_chunk(state, losses, now)

        return train(plan.fit, plan.mapping, first.state, plan.data, first.losses, on_chunk=after_chunk, stop=stop)


@contextmanager
def _training_bar(console: Console, epochs: int) -> Iterator[Callable[[Progress], None]]:
    """A function to call with the `Progress` after each chunk: rewrites one line, or adds lines without a terminal."""
    columns = (
        TextColumn("epoch {task.completed:.0f}/{task.total:.0f}"),
        BarColumn(bar_width=24),
        TaskProgressColumn(),
        TextColumn("loss {task.fields[loss]:.4f}  best validation {task.fields[best]:.4f}"),
        TextColumn("members {task.fields[alive]}/{task.fields[planned]} training, {task.fields[failed]} failed"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=epochs, loss=float("nan"), best=float("nan"),
                            alive="-", planned="-", failed=0)  # fmt: skip
        printed = -1

        def show(now: Progress) -> None:
            nonlocal printed
            bar.update(
                task, completed=now.epoch, loss=now.train_loss, best=now.best_validation,
                alive=now.training, planned=now.planned, failed=now.failed,
            )  # fmt: skip
            tenth = 10 * now.epoch // max(1, now.epochs)
            if not console.is_terminal and tenth > printed:
                printed = tenth
                console.print(
                    f"epoch {now.epoch}/{now.epochs}  loss {now.train_loss:.4f}  best validation "
                    f"{now.best_validation:.4f}  members {now.training}/{now.planned} training, {now.failed} failed",
                    soft_wrap=True,
                )

        yield show
