"""A process of the commands: exit codes, error lines, signals, and the sentences for a full disk and missing memory.

Standard library alone.
"""

import errno
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

BAD_INPUT = 2
INTERRUPTED = 130
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
_NO_ENTRY = (errno.EACCES, errno.EPERM)
_MEMORY_ENDED = "expected enough memory to go on, found none left; complete files stay"
_IN_ONE_PIECE = threading.RLock()  # of what goes to stderr: threads of libraries write tracebacks in many pieces
_NO_MEMORY = ("RESOURCE_EXHAUSTED", "Out of memory", "bad_alloc", "can't start new thread", os.strerror(errno.ENOMEM))


class Interrupted(Exception):
    """The user stopped a run; its text says how to continue."""


@contextmanager
def stop_signal() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C or SIGTERM sets; a second one raises `KeyboardInterrupt` as usual.

    A raised interrupt can be lost inside a callback of JAX; a flag cannot. Main thread only, else never set.
    """
    event = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()

    with _handled_by(handle):
        yield event


@contextmanager
def ended_at_once(stop: threading.Event, sentence: str) -> Iterator[None]:
    """Inside, the first Ctrl-C or SIGTERM raises `Interrupted(sentence)`: for work that keeps nothing when it is
    stopped, and whose steps take longer than a user waits. It sets `stop` as well, in case the raised one is lost."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop.set()
        raise KeyboardInterrupt

    try:
        with _handled_by(handle):
            if stop.is_set():
                raise KeyboardInterrupt
            yield
    except (KeyboardInterrupt, Exception) as problem:  # a library may turn the interrupt into an error of its own
        if stop.is_set():
            raise Interrupted(sentence) from problem
        raise


@contextmanager
def _handled_by(handle: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM, in the main thread; in others nothing changes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous: dict[signal.Signals, Any] = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def ended_without_memory() -> Iterator[None]:
    """Inside, a thread that cannot begin for want of memory ends the process with `BAD_INPUT`.

    CPython would wait for that thread for ever (python/cpython#140746). In the thread itself no Python function can be
    called any more, so its error is put into a queue, by a function in C, and another thread, begun in time, ends the
    process.
    """
    errors: queue.SimpleQueue[sys.UnraisableHookArgs | None] = queue.SimpleQueue()
    sentence = f"error: {_MEMORY_ENDED}\n".encode()
    previous = sys.unraisablehook

    def watch() -> None:
        while (error := errors.get()) is not None:
            if error.exc_type is MemoryError:
                os.write(2, sentence)
                os._exit(BAD_INPUT)
            with _IN_ONE_PIECE:
                previous(error)

    threading.Thread(target=watch, daemon=True).start()
    sys.unraisablehook = errors.put
    try:
        yield
    finally:
        sys.unraisablehook = previous
        errors.put(None)


def say(sentence: str) -> int:
    write_line(f"error: {sentence}")
    return BAD_INPUT


def write_line(line: str) -> None:
    with _IN_ONE_PIECE:
        sys.stderr.write(f"{line}\n")


def refusal(problem: BaseException, folder: Path) -> str | None:
    """One sentence where a computation ended because the machine gave it no room in `folder`, or no memory; None for
    every other problem. Looks behind the exceptions that libraries raise instead."""
    chain: list[BaseException] = []
    following: BaseException | None = problem
    while following is not None and following not in chain:
        chain.append(following)
        following = following.__cause__ or following.__context__
    for each in chain:
        if reason := _unwritten(each, folder):
            return f"{folder}: expected a folder that can be written, found: {reason}; complete files stay"
    if any(isinstance(each, MemoryError) or any(words in str(each) for words in _NO_MEMORY) for each in chain):
        return f"{folder}: {_MEMORY_ENDED}"
    return None


def _unwritten(problem: BaseException, folder: Path) -> str | None:
    if isinstance(problem, OSError):
        named = problem.filename is not None
        if named and not Path(os.fsdecode(problem.filename)).absolute().is_relative_to(folder.absolute()):
            return None  # a file of the user's own
        known = problem.errno in _NO_ROOM or (named and (problem.errno in _NO_ENTRY or not folder.is_dir()))
        return problem.strerror if known else None
    codes = _NO_ROOM + (_NO_ENTRY if "os_error_code" in str(problem) else ())  # TensorStore's, for checkpoints
    return next((os.strerror(code) for code in codes if os.strerror(code) in str(problem)), None)
