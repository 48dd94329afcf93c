"""Running the jobs of a sweep: what the process that was started does, and what each job does, wherever it runs.

    overrides -> names -> what is finished or cannot be is left out -> launcher -> jobs -> table

A job never raises, whatever goes wrong in it: it returns an `JobResult`, which every launcher carries home.
"""

import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.core.utils import JobReturn, JobStatus, env_override
from hydra.errors import HydraException
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from pgrssnn_jax.acceleration.devices import usable_cores
from pgrssnn_jax.cli.plan import plain_config
from pgrssnn_jax.cli.process import BAD_INPUT, Interrupted, refusal, say
from pgrssnn_jax.cli.resume import key_of, override
from pgrssnn_jax.cli.sweeps import JobResult, content_name, job_status, result_table
from pgrssnn_jax.training.run_folder import RunFolder, short_path
from pgrssnn_jax.training.run_lock import locked


def run_sweep(sweeper: Any, parsed: Sequence[Override], combinations: Sequence[list[str]]) -> list[JobReturn]:
    """Runs the jobs that are not finished, shows how all ended, and exits with code 2 when one failed.

    parsed: the overrides of the whole sweep; combinations: those of each job.
    """
    config, context, launcher = sweeper.config, sweeper.hydra_context, sweeper.launcher
    assert config is not None
    assert context is not None
    assert launcher is not None
    console = Console(highlight=False)
    try:
        spelled = name_sweep(parsed, config)
    except ValueError as problem:
        sys.exit(say(str(problem)))
    folder = Path(config.hydra.sweep.dir).absolute()
    jobs = dict(_job(overrides, spelled, folder) for overrides in combinations)
    known = {path: _beforehand(path, overrides, config, context) for path, overrides in jobs.items()}
    outcomes = {path: outcome for path, outcome in known.items() if outcome is not None}
    for outcome in outcomes.values():
        console.print(f"{outcome.status}: {short_path(outcome.folder)} {outcome.reason}".rstrip(), soft_wrap=True)
    waiting = [path for path in jobs if path not in outcomes]
    returns: list[JobReturn] = []
    size = sweeper.max_batch_size or max(1, len(waiting))
    for start in range(0, len(waiting), size):
        batch = waiting[start : start + size]
        with launcher_env(config, len(batch)):
            returned, problem = _launched(launcher, [jobs[path] for path in batch], start)
        returns += returned
        for path, back in zip(batch, returned or [None] * len(batch), strict=True):
            outcomes[path] = _outcome(RunFolder(path), back, problem)
    console.print(result_table([outcomes[path] for path in jobs], folder))
    if any(outcome.status == "failed" for outcome in outcomes.values()):
        sys.exit(BAD_INPUT)
    return returns


def name_sweep(parsed: Sequence[Override], config: DictConfig) -> set[str]:
    """Names the sweep in `config` where nobody has, by its experiment and its budget; returns the keys that the name
    of its folder spells, which the names of the jobs need not repeat. Raises `ValueError` for what no sweep can have.
    """
    swept = {override.key_or_group for override in parsed if override.is_sweep_override()}
    if "resume" in swept or config.get("resume"):
        raise ValueError("resume: expected none in a sweep, which goes on when its command is given again")
    if "sweep" in swept:
        raise ValueError("sweep: expected one name, found several")
    if config.sweep:
        return set()
    choices = config.hydra.runtime.choices
    named = {"experiment", "budget"} - swept
    name = (choices.get("experiment") if "experiment" in named else None) or "sweep"
    if "budget" in named and config.get("budget"):
        name = f"{name}_{choices['budget']}"
    config.sweep = content_name([name])
    return named if str(config.hydra.sweep.dir).endswith(config.sweep) else set()


def _job(overrides: Sequence[str], spelled: set[str], folder: Path) -> tuple[Path, list[str]]:
    """Where a job leaves its run, and what Hydra composes it from."""
    name = content_name([text for text in overrides if key_of(text) not in {*spelled, "sweep"}])
    there = [override("hydra.sweep.dir", str(folder)), override("hydra.sweep.subdir", name)]
    return folder / name, [*overrides, *there]


def _beforehand(path: Path, overrides: list[str], master: DictConfig, context: HydraContext) -> JobResult | None:
    """How a job ends that need not be launched: it is finished, or its configuration does not do."""
    run = RunFolder(path)
    try:
        config = context.config_loader.load_sweep_config(master, list(overrides))
        own = {key_of(name) for name in config.hydra.sweeper.params or {}} - {key_of(text) for text in overrides}
        if own:
            raise ValueError(
                f"experiment={config.hydra.runtime.choices.get('experiment')}: expected alone, because it is a sweep "
                f"over {', '.join(sorted(own))} itself, found among others"
            )
        with open_dict(config):
            del config["hydra"]
        finished = job_status(run, plain_config(config)) == "finished"
    except (ValueError, HydraException, OmegaConfBaseException) as problem:
        return _failed(run, _sentence(problem))
    return JobResult(run.path, "skipped") if finished else None


def _launched(launcher: Launcher, batch: Sequence[list[str]], start: int) -> tuple[list[JobReturn], str]:
    """What came back, or nothing and why: a launcher gives up when one of its processes is killed."""
    try:
        return list(launcher.launch(batch, initial_job_idx=start)), ""
    except Exception as problem:
        return [], f"{type(problem).__name__}: {_sentence(problem)}"


def _outcome(run: RunFolder, back: JobReturn | None, problem: str) -> JobResult:
    if back is not None and back.status is JobStatus.COMPLETED and isinstance(back.return_value, JobResult):
        return back.return_value
    if run.finished:
        return JobResult(run.path, "finished")
    reason = run.failure or f"no result came back ({problem or 'the job ended too early'}); give the command again"
    return JobResult(run.path, "failed", reason)


def run_job(prepare: Callable[[Any], Any], config: Any, stop: threading.Event) -> JobResult:
    """One job of a sweep, in the folder that Hydra names: skipped, gone on with, or begun.

    Raises `Interrupted` when stopped, and nothing else.
    """
    run, started = RunFolder(Path(HydraConfig.get().runtime.output_dir)), time.perf_counter()
    console = Console(highlight=False)

    def show(line: str) -> None:
        console.print(line, soft_wrap=True)

    with ExitStack() as lock:
        try:
            lock.enter_context(locked(run.path, stop, show))
            _unless(stop)
            there = job_status(run, plain_config(config))
        except ValueError as problem:
            return _failed(run, str(problem))
        if there == "finished":
            return JobResult(run.path, "skipped")
        if there == "begun":
            config.resume = str(run.path)
        show(f"{'going on with' if there == 'begun' else 'beginning'} {short_path(run.path)}")
        work = None
        try:
            run.forget_failure()
            work = prepare(config)
            _unless(stop)
            work.do(stop)
            _unless(stop)  # asked for while the last figures were drawn: no further job begins
        except Interrupted:
            raise
        except (Exception, SystemExit) as problem:  # a user's physics may do anything
            refused = refusal(problem, run.path)
            if refused is None and work is None and isinstance(problem, ValueError):
                refused = str(problem)
            reason = refused or f"{type(problem).__name__}: {_sentence(problem)}; see traceback.txt"
            show(f"failed: {short_path(run.path)}: {reason}")
            return _failed(run, reason, None if refused else traceback.format_exc(), time.perf_counter() - started)
        return JobResult(run.path, "finished", seconds=time.perf_counter() - started)


def _unless(stop: threading.Event) -> None:
    if stop.is_set():
        raise Interrupted("stopped; the same command goes on with the sweep")


def _failed(run: RunFolder, reason: str, trace: str | None = None, seconds: float = 0.0) -> JobResult:
    """Leaves the reason in the folder, but for a finished run, which stays what it is."""
    if not run.finished:
        with suppress(OSError):  # where the folder cannot be written the table alone says why
            run.fail(reason, trace)
    return JobResult(run.path, "failed", reason, seconds)


def _sentence(problem: BaseException) -> str:
    for each in (problem, problem.__cause__):
        if each is not None and str(each).strip():
            return str(each).strip().splitlines()[0]
    return type(problem).__name__


def launcher_env(config: DictConfig, jobs: int) -> AbstractContextManager[None]:
    """What the processes of a launcher on this machine inherit: their share of the cores, plain lines instead of
    progress bars, and where Hydra finds this package's sweeper. The user's own settings win."""
    workers = {"basic": 0, "joblib": config.hydra.launcher.get("n_jobs"), "submitit_local": jobs}.get(
        str(config.hydra.runtime.choices.get("hydra/launcher"))
    )
    env: dict[str, str] = {}
    if workers:
        cores = usable_cores()
        at_once = min(jobs, workers if workers > 0 else max(1, cores + 1 + workers))
        share = str(max(1, cores // at_once))
        env = {"JAX_NUM_CPU_DEVICES": share, "NPROC": share, "TTY_COMPATIBLE": "0"}
        env = {name: value for name, value in env.items() if not os.environ.get(name)}
    if workers != 0:
        here = str(Path(__file__).resolve().parents[2])
        env["PYTHONPATH"] = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    return env_override(env)
