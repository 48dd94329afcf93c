"""Measures one part in this process: python -m benchmarks.speed.worker PART --cores N --out FILE (see `rollout.py`)."""

import argparse
import json
import resource
import sys
from pathlib import Path

import numpy as np

import pgrssnn_jax  # noqa: F401  sets flags of the compiler before JAX starts
from pgrssnn_jax.acceleration.devices import use_all_cores

from . import grid, measure, startup
from .roof import machine
from .timing import count_compilations

_WITH_ROOF = ("tanks", "lgssm", "arm")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part")
    parser.add_argument("--cores", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--compare", action="store_true")
    chosen = parser.parse_args()
    use_all_cores()
    count_compilations()
    name, *more = chosen.part.split(" ")
    if name == "grid":
        system, precision = more
        figures = grid.grid_part(system, np.dtype(precision).type, quick=chosen.quick)
    elif name == "mappings":
        figures = grid.mappings_part(quick=chosen.quick)
    elif name in ("startup", "clone"):
        figures = {"startup": startup.startup_part, "clone": startup.clone_part}[name](quick=chosen.quick)
    else:
        parts = {"arm": measure.arm_part, "gru": measure.gru_part}
        part = parts.get(name) or (lambda **how: measure.system_part(name, **how))
        figures = part(quick=chosen.quick, compare=chosen.compare)
    in_kilobytes = 1024 if sys.platform == "darwin" else 1  # macOS counts bytes
    found = {
        "cores": chosen.cores,
        "figures": figures,
        "machine": machine(chosen.cores) if name in _WITH_ROOF else None,
        "compilations": count_compilations(),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / in_kilobytes / 1024,
    }
    chosen.out.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
