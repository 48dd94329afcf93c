"""What a sweep is made of: names by content, what a job's folder says of it, and how the jobs ended.

    runs/<sweep>/<content>      sweep: the experiment, content: the other overrides, in the order of the alphabet

A name says what was asked for, never a number in a list, so that the same command finds its runs again.
"""

import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from omegaconf import OmegaConf
from rich import box
from rich.table import Table
from rich.text import Text

from pgrssnn_jax.cli.resume import first_difference
from pgrssnn_jax.training.run_folder import RunFolder, read_config, short_path

_LONGEST = 120  # characters of a folder's name; most file systems end at 255 bytes, some at 143
_DIGITS = 12  # hexadecimal, of the hash of a name that cannot be written as it is
_SAFE = re.compile(r"[a-z0-9+._=-]+")  # no capitals: some file systems do not tell them apart
_UNSAFE = re.compile(r"[^A-Za-z0-9+._=-]")


def content_name(overrides: Sequence[str]) -> str:
    """`["data.n_train=128", "model=rssnn"] -> "model=rssnn,data.n_train=128"`, whatever their order.

    Groups come first, values deep inside last, because a long name loses its end. Overrides that make no safe file
    name, or too long a one, are written as far as possible and told apart by a hash behind a `~`, which no other name
    contains.
    """
    items = [re.sub("=(True|False)$", lambda found: found[0].lower(), text) for text in overrides]
    items.sort(key=lambda text: (text.split("=")[0].count("."), text))
    name = ",".join(_UNSAFE.sub("-", item) for item in items) or "defaults"
    if len(name) <= _LONGEST and all(_SAFE.fullmatch(item) for item in items):
        return name
    digest = hashlib.sha256(json.dumps(items).encode()).hexdigest()[:_DIGITS]
    return f"{name[: _LONGEST - _DIGITS - 1]}~{digest}"


class JobResult(NamedTuple):
    """How a job of a sweep ended. reason: one sentence for a failed one; seconds: of wall clock."""

    folder: Path
    status: Literal["finished", "skipped", "failed"]
    reason: str = ""
    seconds: float = 0.0


def job_status(run: RunFolder, settings: Mapping[str, Any]) -> Literal["new", "begun", "finished"]:
    """How far the run in a folder has come: to nothing, to a checkpoint, to its end. settings: what it is to be made
    with. Raises `ValueError` when the folder holds a run of other settings."""
    found = "finished" if run.finished else "begun" if run.has_checkpoint else "new"
    if found != "new":
        as_written: Any = OmegaConf.to_container(OmegaConf.create(OmegaConf.to_yaml({**settings, "resume": None})))
        if difference := first_difference(read_config(run.path), as_written):
            key, before, now = difference
            raise ValueError(
                f"{short_path(run.path)}: {key}: expected {now!r} as this job has it, found a run with {before!r}: "
                f"give the sweep another name (sweep=NAME) or remove the folder"
            )
    return found


def result_table(outcomes: Sequence[JobResult], folder: Path) -> Table:
    """One row per job; folder: the sweep's. Where the terminal is narrow, names and reasons are broken, not cut."""
    counts = Counter(outcome.status for outcome in outcomes)
    parts = ", ".join(f"{counts[status]} {status}" for status in ("finished", "skipped", "failed"))
    caption = Text(f"{len(outcomes)} jobs: {parts}")
    table = Table(title=Text(f"sweep {short_path(folder)}", "bold"), caption=caption, box=box.SIMPLE_HEAD)
    table.title_justify = table.caption_justify = "left"
    for name in ("status", "seconds", f"in {short_path(folder)}", "reason"):
        table.add_column(Text(name), justify="right" if name == "seconds" else "left", overflow="fold")
    for outcome in outcomes:
        seconds = "" if outcome.status == "skipped" else f"{outcome.seconds:.0f}"
        style = "red" if outcome.status == "failed" else ""
        table.add_row(outcome.status, seconds, Text(outcome.folder.name), Text(outcome.reason), style=style)
    return table
