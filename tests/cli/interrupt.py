"""Commands to interrupt, the kinds of interruption, and checks of the run folder afterwards."""

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
import yaml
from commands import start, write_benchmark
from test_discovery_command import LINEAR, SHORT, files

from pgrssnn_jax.paper.collect import read_run
from pgrssnn_jax.paper.published import read_paper
from pgrssnn_jax.results.saved import load
from pgrssnn_jax.training.run_folder import RunFolder

TANKS = [
    "+experiment=cascaded_tank", "data.path=tanks.csv", "data.n_validation=40", "model.hidden=3",
    "fit.patience=1000", "fit.validate_every=1", "fit.chunk_epochs=2", "fit.checkpoint_seconds=0.2",
]  # fmt: skip
PAIR = ["data=csv", "data.train=a.csv", "data.test=b.csv"]


class Task(NamedTuple):
    """A command, typed in a folder that holds its data; folder: what it writes."""

    script: str
    arguments: list[str]
    folder: str


TASKS = {
    "train": Task("train.py", [*TANKS, "n_seeds=2", "fit.epochs=600", "hydra.run.dir=run"], "run"),
    "sweep": Task("train.py", ["-m", "seed=0,1,2", *TANKS, "n_seeds=1", "fit.epochs=100", "hydra.sweep.dir=jobs"],
                  "jobs"),
    "discover": Task("discover.py", [*[a for a in LINEAR if a != "data=csv"], *PAIR, *SHORT, "hydra.run.dir=found"],
                     "found"),
    "report": Task("report.py", ["runs=jobs", "out=out"], "out"),
}  # fmt: skip


class Ended(NamedTuple):
    code: int
    out: str
    err: str
    seconds: float  # of processor time, from the first moment at which the command held its folder to the last one


def prepare(work: Path, name: str, finished: Path | None) -> None:
    """The data of a command; finished: a sweep, of which the report tells."""
    work.mkdir(exist_ok=True)
    if name == "report":
        assert finished is not None
        shutil.copytree(finished, work / "jobs")
    write_benchmark(work / "tanks.csv", samples=160)
    files(work)


def run(
    task: Task, work: Path, cache: Path, disturb: Callable[[subprocess.Popen], object] | None = None,
    delay: float = 0.0, again: list[str] | None = None,
) -> Ended:  # fmt: skip
    """The command, disturbed so many seconds after it has taken its folder, of processor time, so that other work of
    the machine does not shift the moment. It stands still in the meantime. again: other arguments."""
    process = start(
        *(again or task.arguments), cwd=work, script=task.script,
        JAX_COMPILATION_CACHE_DIR=str(cache), JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0",
    )  # fmt: skip
    try:
        while process.poll() is None and not held(work):
            time.sleep(0.002)
        begun, used, last = spent(process), 0.0, 0.0
        while process.poll() is None and (disturb is None or used < delay):
            used = max(used, spent(process) - begun)
            last = used if held(work) else last  # a process closes down for a while after its files are whole
            time.sleep(0.002)
        if process.poll() is None and disturb is not None:
            process.send_signal(signal.SIGSTOP)
            disturb(process)
            process.send_signal(signal.SIGCONT)
        out, err = process.communicate(timeout=300)
        return Ended(process.returncode, out, err, last)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def held(work: Path) -> bool:
    """Has a command its folder, or one of its jobs? A killed one leaves its lock behind, which says by whom it was."""
    return any(_holds(lock) for pattern in (".*.lock", "jobs/.*.lock") for lock in work.glob(pattern))


def _holds(lock: Path) -> bool:
    with contextlib.suppress(OSError):
        said = re.match(r"process (\d+) ", lock.read_text())
        return said is None or Path(f"/proc/{said[1]}").exists()
    return False


def spent(process: subprocess.Popen) -> float:
    """Seconds of processor time, or of the clock where nothing tells them."""
    try:
        fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return time.perf_counter()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def sent(number: signal.Signals) -> Callable[[subprocess.Popen, Path], Callable[[], object]]:
    def disturb(process: subprocess.Popen, work: Path) -> Callable[[], object]:
        process.send_signal(number)
        return lambda: None

    return disturb


def fill_disk(process: subprocess.Popen, work: Path) -> Callable[[], object]:
    """Fills the small file system of `small_disk`; elsewhere no file of the process can grow any more."""
    if not os.path.ismount(work):
        resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (0, 0))
        return lambda: None
    filler = work / "filler"
    with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(1 << 16))
    with filler.open("ab", buffering=0) as file, contextlib.suppress(OSError):  # the last pages
        while True:
            file.write(bytes(1 << 12))
    return filler.unlink


def make_read_only(process: subprocess.Popen, work: Path) -> Callable[[], object]:
    """By permissions; for root, whom they do not stop, by the flag of the file system, or by a read-only mount of the
    folder onto itself where the file system has no such flag."""
    folder, root = str(work), os.geteuid() == 0
    ways = [
        ([["chattr", "-R", "-f", "+i", folder]], [["chattr", "-R", "-f", "-i", folder]]),
        ([["mount", "--bind", folder, folder], ["mount", "-o", "remount,bind,ro", folder]], [["umount", "-l", folder]]),
    ]
    for begin, end in (
        ways if root else [([["chmod", "-R", "-f", "a-w", folder]], [["chmod", "-R", "-f", "u+w", folder]])]
    ):
        _run(begin)
        if not _writable(work):
            return partial(_run, end)
        _run(end)
    raise AssertionError(f"{work}: expected that permissions, chattr or mount make it read-only, found it writable")


def _run(commands: Sequence[Sequence[str]]) -> None:
    for command in commands:
        subprocess.run(command, check=False, capture_output=True)  # files may vanish while it walks


def _writable(folder: Path) -> bool:
    try:
        (folder / "probe").touch()
    except OSError:
        return False
    (folder / "probe").unlink()
    return True


def take_memory(process: subprocess.Popen, work: Path) -> Callable[[], object]:
    """From here on the process gets no more memory than it has."""
    resource.prlimit(process.pid, resource.RLIMIT_AS, (1 << 20, 1 << 20))
    return lambda: None


KINDS: dict[str, Callable[[subprocess.Popen, Path], Callable[[], object]]] = {
    "SIGKILL": sent(signal.SIGKILL),
    "SIGTERM": sent(signal.SIGTERM),
    "SIGINT": sent(signal.SIGINT),
    "full disk": fill_disk,
    "read-only": make_read_only,
    "no memory": take_memory,
}


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """A file system of its own under `folder`, where this process may mount one."""
    folder.mkdir()
    try:
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=32m", "tmpfs", str(folder)], capture_output=True)
        mounted = done.returncode == 0
    except OSError:
        mounted = False
    try:
        yield
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)  # whatever still reads there


def results(folder: Path) -> dict[str, object]:
    """Everything that must be the same bit for bit; wall-clock times and their pictures are not."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.name in ("metrics.json", "discovery.json"):
            found[name] = {k: v for k, v in json.loads(path.read_text()).items() if k != "seconds"}
        elif path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                found[name] = {k: (arrays[k].dtype.str, arrays[k].shape, arrays[k].tobytes()) for k in arrays.files}
        elif path.suffix in (".csv", ".tex", ".md") or (path.suffix == ".png" and path.name != "training.png"):
            found[name] = path.read_bytes()
        elif path.name in ("DONE", "FAILED", "training.png", "report.html", "config.yaml", "physics.json"):
            found[name] = None
    return found


def check_no_half_file(folder: Path) -> None:
    """Every file that has its final name is whole. Checkpoints are the matter of `load`."""
    for path in (path for path in folder.rglob("*") if "checkpoint" not in path.parts and path.is_file()):
        if path.name.startswith("."):
            continue
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                assert [arrays[key] for key in arrays.files], path
        elif path.suffix == ".csv":
            assert path.read_text().endswith("\n"), path
            pd.read_csv(path)
        elif path.suffix == ".yaml":
            assert isinstance(yaml.safe_load(path.read_text()), dict), path
        elif path.suffix == ".png":
            assert path.read_bytes()[-8:-4] == b"IEND", path
        elif path.suffix == ".html":
            assert path.read_text().rstrip().endswith("</html>"), path


def check_refused_or_whole(folder: Path, epochs: int) -> str:
    """`load` reads a run that has finished, and nothing else unless told to; what it then reads is whole."""
    run = RunFolder(folder)
    told = read_run(folder, folder.name, read_paper()) if run.path.exists() and any(run.path.iterdir()) else None
    if run.finished:
        assert load(folder).losses.epochs == epochs
        assert told is not None
        assert told.state == "finished"
        return "finished"
    with pytest.raises(ValueError, match="^[^\n]*$"):  # one sentence
        load(folder)
    if told is not None and (folder / "config.yaml").exists():
        assert told.state in ("failed", "unfinished"), told
        assert told.reason
    if run.has_checkpoint:
        return f"begun, epoch {load(folder, partial=True).losses.epochs}"
    with pytest.raises(ValueError, match="^[^\n]*$"):
        load(folder, partial=True)
    return "no checkpoint"
