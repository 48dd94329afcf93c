"""Programs compiled on a second thread while the first one fits: on two cores compiling, which takes one of them, then
costs no time of its own."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def ahead(tasks: Mapping[str, Callable[[], None]]) -> Iterator[Callable[[str], None]]:
    """Does the tasks one after another on a second thread; what it yields waits for the one of a name, if there is one.
    Those not yet begun are dropped when the block is left."""
    thread = ThreadPoolExecutor(1)
    try:
        begun = {name: thread.submit(task) for name, task in tasks.items()}
        yield lambda name: begun[name].result() if name in begun else None
    finally:
        thread.shutdown(cancel_futures=True)
