"""Nothing is lost: commands that are disturbed at random moments end as if nobody had disturbed them.

Fifty moments in all, drawn evenly over the processor time that an undisturbed command takes while it holds its folder.
Each test prints what it did, so that a failure can be repeated:
`pytest -m slow -s tests/cli/test_interruptions.py -k 2-train`.
"""

import fcntl
import json
import os
import re
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from interrupt import (
    KINDS,
    TASKS,
    Ended,
    check_no_half_file,
    check_refused_or_whole,
    prepare,
    results,
    run,
    small_disk,
)  # fmt: skip

from pgrssnn_jax.training.run_folder import RunFolder

SEED = 20261124
REPEATS = {"train": 3, "sweep": 1, "discover": 2, "report": 2}
EPOCHS = {"train": 600, "sweep": 100}


def chains() -> list[tuple[str, list[str]]]:
    """A command with the kinds of interruption that meet it one after the other: fifty in all."""
    draw = np.random.default_rng(SEED)
    kinds = list(KINDS)
    drawn = [(name, list(draw.permutation(kinds))) for name, count in REPEATS.items() for _ in range(count)]
    return [(name, [*found, "SIGKILL", "full disk"] if name == "sweep" else found) for name, found in drawn]


CHAINS = chains()


class Whole(NamedTuple):
    """An undisturbed command: where it left its folder, and how long it held it, s of processor time."""

    folder: Path
    seconds: float


class Step(NamedTuple):
    """met: the kind that disturbed the command, "none" where it ended before; finished: its results are whole."""

    ended: Ended
    met: str
    finished: bool


@pytest.fixture(scope="session")
def shared(tmp_path_factory) -> Path:
    """A folder for all workers of a test run: the undisturbed commands and the compiled programs."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "undisturbed"
    folder.mkdir(exist_ok=True)
    return folder


def undisturbed(name: str, shared: Path) -> Whole:
    """Run once by whichever worker needs it first; a second time for the time of a command whose programs are there."""
    work, done = shared / name, shared / f"{name}.json"
    finished = undisturbed("sweep", shared).folder if name == "report" else None
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            for again in ("", "_timed"):
                prepare(shared / f"{name}{again}", name, finished)
                ended = run(TASKS[name], shared / f"{name}{again}", shared / "cache")
                assert ended.code == 0, ended.err
            assert results(work / TASKS[name].folder) == results(shared / f"{name}_timed" / TASKS[name].folder)
            done.write_text(json.dumps(ended.seconds))
        return Whole(work / TASKS[name].folder, json.loads(done.read_text()))


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(CHAINS)), ids=[f"{i}-{name}" for i, (name, _) in enumerate(CHAINS)])
def test_a_command_disturbed_again_and_again_ends_as_if_nobody_had_disturbed_it(number, tmp_path, shared):
    """Each command goes on from where the one before it was stopped; one that has finished gives way to a new one."""
    name, kinds = CHAINS[number]
    whole, draw = undisturbed(name, shared), np.random.default_rng([SEED, number])
    moments = [(kind, float(draw.uniform(0, whole.seconds))) for kind in kinds]
    while moments:
        work = tmp_path / f"{len(moments)}"
        with small_disk(work):
            prepare(work, name, undisturbed("sweep", shared).folder if name == "report" else None)
            finished = False
            while not finished:
                kind, delay = moments.pop(0) if moments else ("none", 0.0)
                ended, met, finished = disturbed(name, work, shared, kind, delay)
                tell(f"{number}: {kind} {delay:.2f} s into {name} ({whole.seconds:.2f} s): {said(ended)}")
                check_ending(ended, met, finished=finished)
                check_no_half_file(work / TASKS[name].folder)
                tell(f"{number}: {left(name, work, finished=finished)}")
                assert finished or met != "none"
            assert not list(work.rglob(".*.partial"))
            assert results(work / TASKS[name].folder) == results(whole.folder)


def disturbed(name: str, work: Path, shared: Path, kind: str, delay: float) -> Step:
    """Runs the command, which resumes what it can, as the documents say."""
    task, undo = TASKS[name], []
    resumes = name == "train" and RunFolder(work / task.folder).has_checkpoint
    disturb = None if kind == "none" else lambda process: undo.append(KINDS[kind](process, work))
    try:
        ended = run(task, work, shared / "cache", disturb, delay, ["resume=run"] if resumes else None)
    finally:
        for step in undo:
            step()
    return Step(
        ended, kind if undo else "none", results(work / task.folder) == results(undisturbed(name, shared).folder)
    )


def said(ended: Ended) -> str:
    return f"exit code {ended.code}; {(ended.err.strip().splitlines() or [''])[-1]}"


def tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")


def check_ending(ended: Ended, kind: str, *, finished: bool) -> None:
    """Exit codes as documented, with a sentence; threads of libraries may have shown tracebacks before it."""
    allowed = {
        "none": {0},
        "SIGKILL": {-9, 0},
        "SIGTERM": {130, 0},
        "SIGINT": {130, 0},
        "full disk": {2, 0},
        "read-only": {2, 0},
        "no memory": {2, 0, 1, -6, -11},  # libraries abort, or say what they like, where they get none
    }[kind]
    if finished and kind != "none":  # a signal that comes while the interpreter closes down
        allowed |= {-15, -2}
    assert ended.code in allowed, (ended.code, ended.err)
    if kind != "no memory":
        assert "Error executing job" not in ended.err, ended.err
        assert ended.code != 2 or "\nerror: " in f"\n{ended.err}" or re.search("[1-9] failed", ended.out), (
            ended.out,
            ended.err,
        )


def left(name: str, work: Path, *, finished: bool) -> str:
    """What the folders hold, which is whole or refused."""
    folder = work / TASKS[name].folder
    if name == "train":
        return check_refused_or_whole(folder, EPOCHS[name])
    if name == "sweep":
        jobs = [path for path in sorted(folder.glob("*")) if path.is_dir()]
        return "; ".join(check_refused_or_whole(job, EPOCHS[name]) for job in jobs)
    return "finished" if finished else "to be begun again"
