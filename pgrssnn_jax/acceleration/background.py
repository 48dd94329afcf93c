"""Programs compiled on a second thread while the first one fits: on two cores compiling, which takes one of them, then
costs no time of its own."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import jax

from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate, fit_all
from pgrssnn_jax.discovery.null import what_is_added
from pgrssnn_jax.discovery.problem import Problem, Signals


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


def compile_look(problem: Problem, signals: Signals, settings: Settings) -> None:
    """The programs of one look at a catalogue (`look.look_at`), by fits that take no step."""
    with jax.enable_x64(True):  # holds for one thread
        guess = Guess((), problem.theta, signals.start)
        fit_all(problem, signals, [guess] * settings.lanes, settings, steps=0)
        what_is_added(problem, signals, evaluate(problem, signals, guess), [guess], settings)
