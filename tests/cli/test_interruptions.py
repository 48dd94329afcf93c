"""Nothing is lost: commands that are disturbed at random moments end as if nobody had disturbed them.

Fifty moments in all, drawn evenly over the processor time that an undisturbed command takes while it holds its folder.
Each test prints what it did, so that a failure can be repeated:
`pytest -m slow -s tests/cli/test_interruptions.py -k 12-train`.
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
MOMENTS = {"train": 3, "sweep": 1, "discover": 2, "report": 2}  # of each kind
EPOCHS = {"train": 600, "sweep": 100}
CASES = [(name, kind) for name, count in MOMENTS.items() for kind in KINDS for _ in range(count)]
CASES += [("sweep", "SIGKILL"), ("sweep", "full disk")]


class Whole(NamedTuple):
    """An undisturbed command: where it left its folder, and how long it held it, s of processor time."""

    folder: Path
    seconds: float


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
@pytest.mark.parametrize(("number", "name", "kind"), [(i, *case) for i, case in enumerate(CASES)])
def test_a_disturbed_command_ends_as_if_nobody_had_disturbed_it(number, name, kind, tmp_path, shared):
    task, whole = TASKS[name], undisturbed(name, shared)
    delay = float(np.random.default_rng([SEED, number]).uniform(0, whole.seconds))
    work, undo = tmp_path / "work", []
    with small_disk(work):
        prepare(work, name, undisturbed("sweep", shared).folder if name == "report" else None)
        try:
            disturb = KINDS[kind]
            ended = run(task, work, shared / "cache", lambda process: undo.append(disturb(process, work)), delay)
        finally:
            for step in undo:
                step()
        said = (ended.err.strip().splitlines() or [""])[-1]
        tell(f"{number}: {kind} {delay:.2f} s into {name} ({whole.seconds:.2f} s): exit code {ended.code}; {said}")
        finished = results(work / task.folder) == results(whole.folder)
        check_ending(ended, kind if undo else "none", finished=finished)
        check_no_half_file(work / task.folder)
        tell(f"{number}: {recovered(name, work, shared, finished=finished)}")
        assert not list(work.rglob(".*.partial"))
        assert results(work / task.folder) == results(whole.folder)


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
    if finished:  # a signal that comes while the interpreter closes down
        allowed |= {-15, -2}
    assert ended.code in allowed, (ended.code, ended.err)
    if kind != "no memory":
        assert "Error executing job" not in ended.err, ended.err
        assert ended.code != 2 or "\nerror: " in f"\n{ended.err}" or re.search("[1-9] failed", ended.out), (
            ended.out,
            ended.err,
        )


def recovered(name: str, work: Path, shared: Path, *, finished: bool) -> str:
    """Goes on as the documents say; what the folders held before."""
    task, again = TASKS[name], None
    folder, found = work / task.folder, "finished" if finished else "begun again"
    if name == "train":
        found = check_refused_or_whole(folder, EPOCHS[name])
        again = ["resume=run"] if RunFolder(folder).has_checkpoint else None
    elif name == "sweep":
        jobs = [path for path in sorted(folder.glob("*")) if path.is_dir()]
        found = "; ".join(check_refused_or_whole(job, EPOCHS[name]) for job in jobs)
    if finished:
        return found
    ended = run(task, work, shared / "cache", again=again)
    assert ended.code == 0, (found, ended.err)
    return found
