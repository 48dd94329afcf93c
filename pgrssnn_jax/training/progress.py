"""What a person sees while members train: one line that is rewritten, or plain lines where there is no terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from pgrssnn_jax.training.loop import Progress


@contextmanager
def training_bar(console: Console, epochs: int) -> Iterator[Callable[[Progress], None]]:
    """A function to call with the `Progress` after each chunk: epoch, loss, best validation, members, time left."""
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
