"""What every entry script does around its work: check the packages, set up JAX, turn bad input into one sentence.

Imports the standard library alone, so that a missing package can be named instead of ending in a traceback.
"""

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import metadata, util
from pathlib import Path
from types import FrameType
from typing import Any

BAD_INPUT = 2
INTERRUPTED = 130

_MODULES = {
    "jax": "jax", "flax": "flax", "optax": "optax", "orbax-checkpoint": "orbax", "hydra-core": "hydra",
    "numpy": "numpy", "scipy": "scipy", "pandas": "pandas", "matplotlib": "matplotlib", "rich": "rich",
    "jaxtyping": "jaxtyping", "nonlinear-benchmarks": "nonlinear_benchmarks", "pin": "pinocchio",
}  # fmt: skip
_LAUNCHERS = {"joblib": "hydra-joblib-launcher", "submitit": "hydra-submitit-launcher"}


class Interrupted(Exception):
    """The user stopped a run; its text says how to continue."""


def check_packages() -> None:
    """Ends with exit code 2 and one sentence when a package is missing, or when the wrong `pinocchio` is there."""
    if problem := package_problem() or launcher_problem(sys.argv[1:]):
        sys.exit(say(problem))


def launcher_problem(arguments: Sequence[str]) -> str | None:
    """What is missing of the launcher that the command line asks for; Hydra itself would only list those it has."""
    for argument in arguments:
        name = argument.removeprefix("hydra/launcher=") if argument.startswith("hydra/launcher=") else ""
        package = _LAUNCHERS.get(name.split("_")[0])
        if package and not _installed(package):
            return (
                f"hydra/launcher={name}: expected the package {package}, found none installed: "
                f"run `pip install 'pgrssnn_jax[sweep]'` (in a checkout `pip install -e '.[sweep]'`)."
            )
    return None


def package_problem() -> str | None:
    if not _installed("pin") and _installed("pinocchio"):
        return (
            "packages: expected Pinocchio from the package 'pin', found the unrelated package 'pinocchio': "
            "run `pip uninstall pinocchio` and then `make install`."
        )
    missing = [name for name, module in _MODULES.items() if util.find_spec(module) is None]
    if missing:
        return f"packages: expected {', '.join(missing)}, found none installed: run `make install` and use `.venv`."
    return None


def _installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True


def set_up_jax() -> None:
    """One CPU device per core, so that members can be sharded, and compiled programs kept between commands.

    Must run before the first JAX computation. JAX's own environment variables win.
    """
    import jax

    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", usable_cores())
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pgrssnn_jax" / "compiled"
        jax.config.update("jax_compilation_cache_dir", str(cache))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def usable_cores() -> int:
    if hasattr(os, "sched_getaffinity"):  # Linux: the cores this process may use, not those the machine has
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def stop_signal() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C or SIGTERM sets; a second one raises `KeyboardInterrupt` as usual.

    A raised interrupt can be lost inside a callback of JAX; a flag cannot. Main thread only, else never set.
    """
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()

    previous: dict[signal.Signals, Any] = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield event
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def run(prepare: Callable[[Any], Callable[[threading.Event], None]], config: Any) -> Any:
    """`prepare(config)(stop)`: bad input raises `ValueError` while preparing, before anything is written.

    Exit code 2 for bad input, 130 for an interrupted run; any other exception is a bug and keeps its traceback. A job
    of a sweep returns how it ended instead, and only an interruption exits.
    """
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # a user's own physics lives where the command is typed
    set_up_jax()
    logging.getLogger().setLevel(logging.WARNING)  # JAX and orbax report every step through Hydra's handler
    try:
        with stop_signal() as stop:
            if in_a_sweep():
                from pgrssnn_jax.cli.sweep_jobs import run_job

                return run_job(prepare, config, stop)
            try:
                work = prepare(config)
            except ValueError as problem:
                sys.exit(say(str(problem)))
            if stop.is_set():
                raise Interrupted("stopped before training; nothing was written")
            work(stop)
    except (Interrupted, KeyboardInterrupt) as stopped:
        sys.stderr.write(f"{stopped or 'stopped; a run folder that was begun can be resumed'}\n")
        sys.exit(INTERRUPTED)


def in_a_sweep() -> bool:
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode

    return HydraConfig.get().mode is RunMode.MULTIRUN


def call(main: Callable[[], None]) -> None:
    """Calls a Hydra main; a configuration that does not compose is bad input too and ends with exit code 2.

    Hydra itself ends with 1 both for that and for an exception in the job; the job has begun when JAX is loaded.
    """
    from pgrssnn_jax.cli import after_discovery

    after_discovery.register()  # `--cfg job --resolve` ends before a job begins
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except SystemExit as ended:
        composed = "jax" in sys.modules
        sys.exit(BAD_INPUT if ended.code == 1 and not composed else ended.code)


def say(sentence: str) -> int:
    sys.stderr.write(f"error: {sentence}\n")
    return BAD_INPUT
