"""How often do 95 % intervals hold the true parameters? python benchmarks/interval_coverage.py [--cases 8]
[--systems servo chain ...] [--noises white process ...] [--seed 0].

Cases of the hidden-effect suite in which nothing is missing: the physics alone is fitted, as a discovery does for its
final parameters, which takes a second a case. Prints, by noise and by system, the share of true parameters within the
interval of the sandwich and within the widest one (`discovery/deviations.py`), and the median ratio of their widths.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
import scipy
from discovery import setup_of
from hidden import suite
from hidden.case import SYSTEMS, Case
from hidden.noise import KINDS as NOISES
from hidden.nominal import true_parameters
from rich.console import Console
from rich.table import Table

from pgrssnn_jax.discovery.deviations import deviations
from pgrssnn_jax.discovery.estimate import Settings, evaluate
from pgrssnn_jax.discovery.identify import most_likely
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.problem import Problem, build_problem, weighted_signals
from pgrssnn_jax.discovery.recalibrate import nominal_guess, recalibrated_guess


class Number(NamedTuple):
    """A true parameter: is it within the interval of the sandwich, and within the widest one; ratio of their widths."""

    sandwich: bool
    widest: bool
    ratio: float


def main() -> None:
    arguments = _arguments()
    found: dict[str, list[Number]] = defaultdict(list)
    console = Console(width=120)
    for system in arguments.systems:
        problem: Problem | None = None
        for noise in arguments.noises:
            for plan in suite.plans(system, arguments.cases, arguments.seed, ["none"], [noise]):
                case = suite.build(plan)
                problem = problem or build_problem(setup_of(case, ()).physics, ())
                numbers = list(_numbers(problem, case))
                for key in ("all", f"noise {noise}", f"system {system}") if numbers else ():
                    found[key] += numbers
    table = Table("", "numbers", "sandwich", "widest one", "ratio of widths")
    for key, numbers in sorted(found.items()):
        sandwich, widest, ratio = zip(*numbers, strict=True)
        table.add_row(
            key, f"{len(numbers)}", *(f"{np.mean(a):.0%}" for a in (sandwich, widest)), f"{np.median(ratio):.2f}"
        )
    console.print(table)


def _numbers(problem: Problem, case: Case) -> Iterator[Number]:
    """Of the parameters that a fit moves and that do not end at a bound."""
    setup, fits = setup_of(case, ()), Settings()
    chosen, problem = setup.settings, problem.with_numbers(setup.physics.params)
    if chosen.tolerance is None:
        raise ValueError("interval coverage: tolerance: expected a number, found None")
    with jax.enable_x64(True):
        signals = weighted_signals(problem, setup.estimation, folds=chosen.folds, block=chosen.block)
        begun = recalibrated_guess(problem, signals, nominal_guess(problem, signals, fits), fits, chosen)
        noise = noise_floor(evaluate(problem, signals, begun).error, signals.weight) / signals.size
        held = problem.held(chosen.tolerance, noise)
        held, guess = most_likely(held, signals, begun, chosen.tolerance, fits)
        found = deviations(held, signals, guess, fits)
    width = scipy.stats.t.ppf(0.975, found.freedom)
    labels = {held.slots[place].label: k for k, place in enumerate(found.free)}
    for name, value in true_parameters(case).items():
        if name in labels:
            k = labels[name]
            off, coloured, widest = abs(value - guess.theta[found.free[k]]) / width, found.coloured[k], found.widest[k]
            yield Number(off <= coloured, off <= widest, float(widest / coloured))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    systems = [system for system in SYSTEMS if system != "arm"]
    parser.add_argument("--cases", type=int, default=8, help="per system and noise")
    parser.add_argument("--systems", nargs="+", choices=systems, default=systems)
    parser.add_argument("--noises", nargs="+", choices=NOISES, default=list(NOISES))
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


if __name__ == "__main__":
    main()
