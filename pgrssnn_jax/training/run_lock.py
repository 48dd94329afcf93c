"""One process at a time in a run folder: a lock that ends with its process, however that ends."""

import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: two sweeps at once in one folder are then the user's to avoid
    fcntl = None

_LOOK_AGAIN = 0.2  # s


@contextmanager
def held(folder: Path, stop: threading.Event, notify: Callable[[str], None]) -> Iterator[None]:
    """Waits until no other process holds `folder`, or until `stop` is set.

    A killed sweep may leave workers behind that still train: whoever comes next waits for them. The lock is a file
    beside the folder, gone when nobody holds it. File systems that know no locks have none.
    """
    path, file, said = _lock_of(folder), -1, False
    while fcntl is not None and (file := _taken(path)) < 0 and not stop.is_set():
        if not said:
            notify(f"waiting for another process that works in {folder.name}")
            said = True
        stop.wait(_LOOK_AGAIN)
    try:
        yield
    finally:
        _release(path, file)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Holds `folder` for this process. Raises `ValueError` that names the holder when another process has it."""
    path = _lock_of(folder)
    file = -1 if fcntl is None else _taken(path)
    if fcntl is not None and file < 0:
        holder = "another process"
        with suppress(OSError):  # it may have ended in the meantime
            holder = path.read_text(encoding="utf-8").strip() or holder
        raise ValueError(f"{folder}: expected a run folder in which nobody writes, found {holder} at work there")
    try:
        yield
    finally:
        _release(path, file)


def _lock_of(folder: Path) -> Path:
    folder = folder.absolute()
    return folder.parent / f".{folder.name}.lock"


def _release(path: Path, file: int) -> None:
    if file >= 0:
        path.unlink(missing_ok=True)
        os.close(file)


def _taken(path: Path) -> int:
    """The open file of the lock, or -1 when another process has it."""
    assert fcntl is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    file = os.open(path, os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        return -1
    except OSError:
        return file
    with suppress(FileNotFoundError):  # the last holder removes the file: a lock on what is gone is none
        if os.fstat(file).st_ino == path.stat().st_ino:
            os.ftruncate(file, 0)
            os.write(file, f"process {os.getpid()} on {socket.gethostname()}".encode())
            return file
    os.close(file)
    return -1
