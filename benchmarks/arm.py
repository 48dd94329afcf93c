"""Speed of the arm's dynamics and of training on it: python benchmarks/arm.py [--json FILE] [--quick].

Microseconds per evaluation of the forward dynamics for both backends, compiled into the free run they are meant for (60
sequences, 605 samples, RK4: 145 200 evaluations), with value and gradient; Pinocchio alone; one PG-RSSNN epoch on 60 x
605 samples. One device, one thread; compile time apart; the median of interleaved repetitions.
"""

import argparse
import json
import os
from pathlib import Path
from typing import Any

os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])  # one core, or the threads would not be comparable

from rich.console import Console
from rich.table import Table
from speed.arm_dynamics import EVALUATIONS_PER_CALL, evaluations, free_runs, pinocchio_calls
from speed.cases import ARM_SAMPLES, ARM_SEQUENCES, SYSTEMS, training, training_call
from speed.timing import compiled, interleaved, spread

from pgrssnn_jax.physics.arms.build import arm


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments.add_argument("--quick", action="store_true", help="few repetitions: does it run?")
    chosen = arguments.parse_args()
    samples = 20 if chosen.quick else ARM_SAMPLES
    repeats = 2 if chosen.quick else 7
    figures = {"free_run": dynamics(samples, repeats), "epoch": epochs(samples, repeats)}
    show(figures, samples)
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1) + "\n")


def dynamics(samples: int, repeats: int) -> dict[str, dict[str, float]]:
    """µs per evaluation and seconds to compile."""
    programs, alone = free_runs(samples), pinocchio_calls()
    found = interleaved({**{name: one.call for name, one in programs.items()}, **alone}, repeats)
    figures = {}
    for name, ms in found.items():
        count = EVALUATIONS_PER_CALL if name in alone else evaluations(samples)
        seconds = programs[name].compile_s if name in programs else 0.0
        figures[name] = {"us": 1e3 * spread(ms)[0] / count, "compile_s": seconds}
    return figures


def epochs(samples: int, repeats: int) -> dict[str, dict[str, float]]:
    """Seconds per training epoch of one member on 60 sequences, from chunks of five epochs with one validation."""
    per_call = 5
    programs = {}
    for gradient in ("stopped", "full"):
        physics = arm(physics_gradient=gradient)
        fit, data = training(SYSTEMS["arm"], physics, samples=samples, epochs=per_call)
        programs[gradient] = compiled(*training_call(fit, data, 1))
    found = interleaved({name: one.call for name, one in programs.items()}, max(2, repeats // 2))
    return {
        name: {"s": spread(ms)[0] / 1e3 / per_call, "compile_s": programs[name].compile_s} for name, ms in found.items()
    }


def show(figures: dict[str, Any], samples: int) -> None:
    console = Console(width=110)
    table = Table(title=f"arm: {ARM_SEQUENCES} sequences of {samples} samples, RK4, one core", title_justify="left")
    for column in ("what", "figure", "unit"):
        table.add_column(column, justify="right" if column == "figure" else "left")
    for name, found in figures["free_run"].items():
        compiled_in = f" (compiled in {found['compile_s']:.1f} s)" if found["compile_s"] else ""
        table.add_row(name, f"{found['us']:.2f}", f"µs per evaluation{compiled_in}")
    for name, found in figures["epoch"].items():
        compiled_in = f"s (compiled in {found['compile_s']:.1f} s)"
        table.add_row(f"PG-RSSNN epoch, gradient {name}", f"{found['s']:.3f}", compiled_in)
    console.print(table)


if __name__ == "__main__":
    main()
