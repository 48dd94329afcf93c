"""What every entry script does around its work: set up JAX, hold the run folder, turn bad input into one sentence."""

import logging
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode

from pgrssnn_jax.acceleration.devices import keep_compiled, use_all_cores
from pgrssnn_jax.cli.config_store import register
from pgrssnn_jax.cli.process import (
    BAD_INPUT,
    INTERRUPTED,
    Interrupted,
    ended_without_memory,
    refusal,
    say,
    stop_signal,
    write_line,
)
from pgrssnn_jax.training.run_lock import locked


class Work(NamedTuple):
    """What a command has prepared: the folder that it writes, and the work itself, which looks at an event."""

    folder: Path
    do: Callable[[threading.Event], None]


def run(prepare: Callable[[Any], Work], config: Any) -> Any:
    """Bad input raises `ValueError` while preparing, before anything is written.

    Exit code 2 for bad input, for a folder that cannot be written and where memory ends, 130 for an interrupted run;
    any other exception is a bug and keeps its traceback. A job of a sweep returns how it ended instead, and only an
    interruption exits.
    """
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # a user's own physics lives where the command is typed
    use_all_cores()
    keep_compiled()
    logging.getLogger().setLevel(logging.WARNING)  # JAX and orbax report every step through Hydra's handler
    warnings.showwarning = _warned
    try:
        with stop_signal() as stop, ExitStack() as lock:
            if HydraConfig.get().mode is RunMode.MULTIRUN:
                from pgrssnn_jax.cli.sweep_jobs import run_job

                return run_job(prepare, config, stop)
            try:
                work = prepare(config)
                lock.enter_context(locked(work.folder))
            except ValueError as problem:
                sys.exit(say(str(problem)))
            if stop.is_set():
                raise Interrupted("stopped before training; nothing was written")
            try:
                work.do(stop)
            except Exception as problem:
                sentence = refusal(problem, work.folder)
                if sentence is None:
                    raise
                sys.exit(say(sentence))
    except (Interrupted, KeyboardInterrupt) as stopped:
        write_line(str(stopped) or "stopped; a run folder that was begun can be resumed")
        sys.exit(INTERRUPTED)


def call(main: Callable[[], None]) -> None:
    """Calls a Hydra main; a configuration that does not compose is bad input too and ends with exit code 2.

    Hydra itself ends with 1 both for that and for an exception in the job.
    """
    register()
    main_thread = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, signal.default_int_handler) if main_thread else None  # also between jobs
    try:
        with ended_without_memory():
            main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except SystemExit as ended:
        sys.exit(BAD_INPUT if ended.code == 1 and not HydraConfig.initialized() else ended.code)
    finally:
        if main_thread:
            signal.signal(signal.SIGTERM, before)


def _warned(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """One line, as for errors."""
    write_line(f"warning: {message}")
