"""What a user waits for: imports, commands, and the first call, each in a fresh process."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .timing import spread

_ROOT = Path(__file__).resolve().parents[2]
_IMPORTS = {
    "Python alone": "pass",
    "import jax": "import jax",
    "import pgrssnn_jax": "import pgrssnn_jax",
    "import with a first physics": "import pgrssnn_jax as pg; pg.physics.cascaded_tanks()",
}
_FIRST_CALL = """
import json, time
begun = time.perf_counter()
shares = {}
def share(name):
    global begun
    shares[name] = time.perf_counter() - begun
    begun = time.perf_counter()
import pgrssnn_jax as pg
import jax
compiled = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **_: compiled.append(seconds) if event.endswith("backend_compile_duration") else None)
tanks = pg.physics.cascaded_tanks(clamp=True)
share("import and physics")
train, test = pg.load_benchmark("cascaded_tank")
share("data")
ensemble = pg.fit("pg_rssnn", tanks, train, epochs=20, quiet=True)
share("fit of 20 epochs")
ensemble.score(test)
share("score")
print(json.dumps({**shares, "compiling": sum(compiled), "programs": len(compiled)}))
"""
_TRAIN = ["train.py", "+experiment=cascaded_tank", "fit.epochs=20"]
_DISCOVER = ["discover.py", "+experiment=cascaded_tank", "discovery.network_epochs=0"]


def startup_part(*, quick: bool) -> dict[str, dict[str, Any]]:
    """Seconds as ms, the median of some fresh processes; what compiles is run once with an empty cache of programs and
    once with a full one. quick: imports and --help alone, once."""
    repeats = 1 if quick else 5
    python = [sys.executable]
    found = {name: _repeated([*python, "-c", code], repeats) for name, code in _IMPORTS.items()}
    for script in ("train.py", "discover.py", "report.py"):
        found[f"{script} --help"] = _repeated([*python, script, "--help"], repeats)
    if quick:
        return found
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for state in ("nothing compiled", "everything compiled"):
            found |= _first_call(state, folder)
            seconds, until_trained = _training(folder)
            found[f"train.py of 20 epochs, {state}"] = _once(seconds)
            order = "first" if state == "nothing compiled" else "second"
            found[f"{order} train.py until its first epochs"] = _once(until_trained)
        for state in ("nothing compiled", "everything compiled"):
            run = f"hydra.run.dir={folder / 'discovery'}"
            found[f"discovery, {state}"] = _once(_seconds([*python, *_DISCOVER, run], folder / "discovery-cache"))
    return found


def clone_part(*, quick: bool) -> dict[str, dict[str, Any]]:
    """`make train` in a clone of the last commit, set-up included; it downloads packages. quick: nothing."""
    if quick:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        return {"make train from a fresh clone": _once(_fresh_clone(Path(folder)))}


def _repeated(command: Sequence[str], repeats: int) -> dict[str, Any]:
    _seconds(command)  # files into the system's cache
    return {"ms": spread([1e3 * _seconds(command) for _ in range(repeats)])}


def _once(seconds: float) -> dict[str, Any]:
    return {"ms": [1e3 * seconds] * 3}


def _seconds(command: Sequence[str], cache: Path | None = None) -> float:
    started = time.perf_counter()
    _output(command, cache)
    return time.perf_counter() - started


def _output(command: Sequence[str], cache: Path | None) -> str:
    done = subprocess.run(
        command,
        cwd=_ROOT,
        env=_environment(cache),
        check=True,
        capture_output=True,
        text=True,
    )
    return done.stdout


def _environment(cache: Path | None) -> dict[str, str]:
    """As a user's: without what the benchmark set for itself."""
    kept = {name: value for name, value in os.environ.items() if name not in ("XLA_FLAGS", "OMP_NUM_THREADS")}
    return {**kept, "XDG_CACHE_HOME": str(cache)} if cache else kept  # of compiled programs and of the C++ kernels


def _first_call(state: str, folder: Path) -> dict[str, dict[str, Any]]:
    """Shares of a first script, and what of it is compiling."""
    shares = json.loads(_output([sys.executable, "-c", _FIRST_CALL], folder / "call-cache").splitlines()[-1])
    programs = shares.pop("programs")
    found = {f"first call, {state}: {name}": _once(seconds) for name, seconds in shares.items()}
    found[f"first call, {state}: compiling"]["compilations"] = programs
    return found


def _training(folder: Path) -> tuple[float, float]:
    """Seconds of a whole run of 20 epochs, and those until they were trained: without evaluation and report."""
    run = folder / "run"
    shutil.rmtree(run, ignore_errors=True)
    whole = _seconds([sys.executable, *_TRAIN, f"hydra.run.dir={run}"], folder / "train-cache")
    after = json.loads((run / "metrics.json").read_text(encoding="utf-8"))["seconds"]
    written = (run / "DONE").stat().st_mtime - (run / "history.csv").stat().st_mtime
    return whole, whole - written - after.get("evaluate", 0.0)


def _fresh_clone(folder: Path) -> float:
    clone = folder / "clone"
    subprocess.run(["git", "clone", "--quiet", str(_ROOT), str(clone)], check=True)
    started = time.perf_counter()
    done = subprocess.run(["make", "train"], cwd=clone, env=_environment(folder / "clone-cache"), capture_output=True)
    if done.returncode:
        raise RuntimeError(re.sub(r"\s+", " ", done.stderr.decode())[-500:])
    return time.perf_counter() - started
