"""As fast as the machine allows? python benchmarks/rollout.py [--compare] [--only tanks ...] [--json FILE] [--quick]

    tanks, lgssm, arm   epochs and rollouts; --compare: beside PyTorch (the extra `compare`) and Pinocchio, as ratios
    gru                 the recurrence alone beside torch.nn.GRU
    startup             what a user waits for: imports, commands, the first call, discovery (minutes)
    clone               make train from a fresh clone (downloads packages)
    mappings            fused against split rollouts; members by vmap, one after another, over devices
    grid                members, horizons and precisions on one core and on two (half an hour)

Ratios first, each from one process that takes its calls in turn; then the roof and how much of it is reached; then bare
times. Every part has a process of its own, because the number of cores is set before JAX starts. FILE keeps the figures
of parts that are not measured this time; `--page docs/performance.md` writes its tables; `--shown` measures nothing.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from speed.tables import show, write

_ROOT = Path(__file__).resolve().parents[1]
PARTS = ("tanks", "lgssm", "arm", "gru", "startup", "clone", "mappings", "grid")
_USUAL = ("tanks", "lgssm", "arm", "gru")
_BOTH = ("arm", "grid")  # on one core too


def main() -> None:
    chosen = arguments()
    found: dict[str, Any] = {"measured": {}}
    if chosen.json and chosen.json.exists():
        found = json.loads(chosen.json.read_text(encoding="utf-8"))
    if not chosen.shown:
        if usable() < 2:
            print("one usable core: parts that need two are left out", file=sys.stderr)
        for part, cores in settings(chosen.only):
            print(f"{part} on {cores} core(s) ...", file=sys.stderr, flush=True)
            name = f"{part}, {cores} core{'s' if cores > 1 else ''}"
            figures = measured(part, cores, quick=chosen.quick, compare=chosen.compare)
            found["measured"][name] = {**figures, "cpu": f"{processor()}, {usable()} cores", "quick": chosen.quick}
            if chosen.json:
                chosen.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    show(found)
    if chosen.page:
        if any(part["quick"] for part in found["measured"].values()):
            sys.exit(f"error: --page: expected figures of whole runs in {chosen.json}, found some of --quick")
        write(found, chosen.page)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=_USUAL, help="parts to measure")
    parser.add_argument("--compare", action="store_true", help="with PyTorch: pip install 'pgrssnn_jax[compare]'")
    parser.add_argument("--json", type=Path, help="file of the figures, which is added to")
    parser.add_argument("--page", type=Path, help="page whose marked part becomes the tables")
    parser.add_argument("--shown", action="store_true", help="measure nothing, show what is in the file")
    parser.add_argument("--quick", action="store_true", help="small sizes, few repetitions: does it run?")
    return parser.parse_args()


def settings(parts: list[str]) -> list[tuple[str, int]]:
    """Every process to start: its part and its number of cores."""
    names = []
    for part in parts:
        of_grid = [f"grid {s} {p}" for s in ("tanks", "lgssm", "arm") for p in ("float32", "float64")]
        names += of_grid if part == "grid" else [part]
    return [
        (name, cores)
        for name in names
        for cores in ((1, 2) if name.split(" ")[0] in _BOTH else (2,))
        if cores <= usable()
    ]


def measured(part: str, cores: int, *, quick: bool, compare: bool) -> dict[str, Any]:
    """What a process with that many cores finds."""
    mine = set(sorted(os.sched_getaffinity(0))[:cores]) if hasattr(os, "sched_getaffinity") else None
    flags = os.environ.get("XLA_FLAGS", "") + (" --xla_cpu_multi_thread_eigen=false" if cores == 1 else "")
    environment = {**os.environ, "XLA_FLAGS": flags.strip(), "OMP_NUM_THREADS": str(cores)}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "found.json"
        command = [sys.executable, "-m", "benchmarks.speed.worker", part, "--cores", str(cores), "--out", str(out)]
        command += ["--quick"] * quick + ["--compare"] * compare
        pinned = partial(os.sched_setaffinity, 0, mine) if mine else None
        subprocess.run(command, cwd=_ROOT, env=environment, check=True, preexec_fn=pinned)
        return json.loads(out.read_text(encoding="utf-8"))


def usable() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processor() -> str:
    """Its model's name."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())


if __name__ == "__main__":
    main()
