"""What the machine refuses to a command becomes one sentence; bugs keep their traceback."""

import errno
import os
import signal
import socket
import subprocess
import sys

import pytest
from commands import environment

from pgrssnn_jax.cli.process import refusal
from pgrssnn_jax.training.run_lock import locked


def raised(problem: BaseException, cause: BaseException | None = None) -> BaseException:
    problem.__cause__ = cause
    return problem


def test_a_folder_that_cannot_be_written_is_named_with_its_reason(tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    run = tmp_path / "run"
    run.mkdir()
    for problem in (
        full,
        raised(ValueError("a checkpoint failed"), full),
        OSError(errno.EPERM, os.strerror(errno.EPERM), str(run / "DONE")),
        ValueError("RESOURCE_EXHAUSTED: Error writing: No space left on device [os_error_code='28']"),
        ValueError("PERMISSION_DENIED: Failed to open: Operation not permitted [os_error_code='1']"),
    ):
        sentence = refusal(problem, run)
        assert sentence is not None
        assert sentence.startswith(f"{run}: expected a folder that can be written, found: ")
        assert sentence.count("\n") == 0


@pytest.mark.parametrize("problem", [MemoryError(), RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8")])
def test_memory_that_ends_is_named(tmp_path, problem):
    assert "expected enough memory to go on, found none left" in str(refusal(problem, tmp_path))


@pytest.mark.parametrize(
    "problem",
    [
        ValueError("k1: expected less"),
        FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), "history.csv"),
        PermissionError(errno.EACCES, os.strerror(errno.EACCES), "/elsewhere/measured.csv"),
    ],
)
def test_a_bug_and_a_file_elsewhere_are_no_refusals(tmp_path, problem):
    assert refusal(problem, tmp_path) is None


def test_a_lock_where_no_file_can_be_is_bad_input(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(ValueError, match="file: expected a folder that can be written, found: [^\\n]*$"),
        locked(tmp_path / "file" / "run"),
    ):
        pass


def test_a_folder_that_is_held_names_its_holder_until_it_is_free(tmp_path):
    run, holder = tmp_path / "run", f"process {os.getpid()} on {socket.gethostname()}"
    with (
        locked(run),
        pytest.raises(ValueError, match=f"run: expected a run folder in which nobody writes, found {holder} at work"),
        locked(run),
    ):
        pass
    with locked(run):
        assert [path.name for path in tmp_path.iterdir()] == [".run.lock"]
    assert not list(tmp_path.iterdir())


def test_sigterm_between_the_jobs_of_a_sweep_ends_with_the_code_of_an_interruption(tmp_path):
    script = "import os, signal\nfrom pgrssnn_jax.cli import entry\n"
    script += f"entry.call(lambda: os.kill(os.getpid(), {int(signal.SIGTERM)}))\n"
    done = subprocess.run([sys.executable, "-c", script], env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "")
