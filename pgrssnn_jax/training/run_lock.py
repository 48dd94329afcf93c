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
def locked(
    folder: Path, stop: threading.Event | None = None, notify: Callable[[str], object] = print
) -> Iterator[None]:
    """Holds `folder` for this process.

    Where another process has it: raises `ValueError` that names the holder, or, with `stop`, waits until it is free or
    `stop` is set, because a killed sweep may leave workers behind that still train. The lock is a file beside the
    folder, gone when nobody holds it; raises `ValueError` too where none can be. File systems that know no locks have
    none.
    """
    lock = folder.absolute().parent / f".{folder.absolute().name}.lock"
    file, told = -1, False
    while fcntl is not None and (file := _taken(lock)) < 0:
        if stop is None:
            holder = "another process"
            with suppress(OSError):  # it may have ended in the meantime
                holder = lock.read_text(encoding="utf-8").strip() or holder
            raise ValueError(f"{folder}: expected a run folder in which nobody writes, found {holder} at work there")
        if stop.is_set():
            break
        if not told:
            notify(f"waiting for another process that works in {folder.name}")
        told = True
        stop.wait(_LOOK_AGAIN)
    try:
        yield
    finally:
        if file >= 0:
            with suppress(OSError):  # in a folder that has become read-only it stays behind, and holds nobody up
                lock.unlink()
            os.close(file)


def _taken(path: Path) -> int:
    """The open file of the lock, or -1 when another process has it."""
    assert fcntl is not None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT)
    except OSError as problem:
        expected = "expected a folder that can be written"
        raise ValueError(f"{path.parent}: {expected}, found: {problem.strerror}") from None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        return -1
    except OSError:
        return file
    with suppress(FileNotFoundError):  # the last holder removes the file: a lock on what is gone is none
        if os.fstat(file).st_ino == path.stat().st_ino:
            with suppress(OSError):  # on a full disk the lock is held, but says not by whom
                os.ftruncate(file, 0)
                os.write(file, f"process {os.getpid()} on {socket.gethostname()}".encode())
            return file
    os.close(file)
    return -1
