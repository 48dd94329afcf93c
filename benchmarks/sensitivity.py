"""What does each number that decides change? python benchmarks/sensitivity.py [--cases 8] [--systems pendulum duffing]
[--kinds none single] [--noises white ar95 ...] [--seed 0] [--json FILE].

Every field of `Criteria` is halved and doubled, one at a time, and every case is decided again. Prints per field how
many verdicts or names change, and how many right answers are lost and won. Screenings that a field does not touch are
made once, with random numbers of their own, so that a change of the outcome is one of the field. FILE holds a row per
case, one a line: cases that are in it are not run again, as in `discovery.py`.
"""

import argparse
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from discovery import append_row, digest, key_of, known_rows, setup_of
from hidden import suite
from hidden.case import SYSTEMS, Case
from hidden.noise import KINDS as NOISES
from hidden.score import Row, is_right
from hidden.suite import KINDS, Plan
from rich.console import Console
from rich.table import Table

from pgrssnn_jax.discovery import discover, nameless, scoring, search, tested
from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.discover import discover_in
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.settings import Criteria, DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup

_OF_SCREENINGS = ("p_value", "finalists", "hopeless", "draws", "block")  # fields that a screening depends on
_ONCE = (  # functions, in the modules that call them
    (scoring, scoring.score_candidates),
    (nameless, nameless.score_corrections),
    (nameless, nameless.errors_follow),
    (nameless, nameless.line_beside_noise),
    (search, search.nominal_guess),
    (search, search.recalibrated_guess),
    (discover, discover.smoothed_correction),
    (tested, tested.final_numbers),
    (tested, tested.validations_on_test),
    (tested, tested.improvement_by_correction),
)


@dataclass(frozen=True)
class Varied(DiscoverySettings):
    """The defaults, with other criteria."""

    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def criteria(self) -> Criteria:
        return super().criteria._replace(**self.changes)


class Outcome(NamedTuple):
    verdict: str
    names: list[str]
    right: bool


def main() -> None:
    arguments, known, code = _arguments(), dict[Any, Any](), digest()
    jax.config.update("jax_num_cpu_devices", arguments.devices)
    stored, rows = known_rows(arguments.json, code), list[Row]()
    for module, function in _ONCE:
        setattr(module, function.__name__, _remembered(function, known))
    for system in arguments.systems:
        kept: list[tuple[Problem, Corrected]] = []
        for plan in suite.plans(system, arguments.cases, arguments.seed, arguments.kinds, arguments.noises):
            row = stored.get(key_of(plan))
            if row is None:
                known.clear()
                row = _row(plan, kept) | {"code": code}
                append_row(arguments.json, row)
            rows.append(row)
            print(_line(row), flush=True)
    Console(width=120).print(_table(rows))


def _row(plan: Plan, kept: list[tuple[Problem, Corrected]]) -> Row:
    """The outcomes of one case; kept: compiled with the first case of a system."""
    case = suite.build(plan)
    setup = setup_of(case, plan.removed)
    if not kept:
        problem = build_problem(setup.physics, setup.first_effects, fixed=setup.settings.fixed)
        kept.append((problem, Corrected()))
    others = {f"{name} {way}": _outcome(kept[0], case, plan.kind, setup, {name: v}) for name, way, v in variations()}
    return {**plan._asdict(), "usual": _outcome(kept[0], case, plan.kind, setup, {}), "others": others}


def _line(row: Row) -> str:
    usual, truth = Outcome(*row["usual"]), " + ".join(row["truth"]) or "none"
    changed = [name for name, other in row["others"].items() if Outcome(*other)[:2] != usual[:2]]
    mark = "right" if usual.right else "WRONG"
    said = f"{usual.verdict} {' + '.join(usual.names)}".strip()
    return f"{mark} {row['system']} {row['seed']} {row['noise_kind']}: {truth} -> {said}; changed by {changed}"


def variations() -> Iterator[tuple[str, str, Any]]:
    """Field, "half" or "twice", and the number."""
    for name, value in Criteria()._asdict().items():
        for way, factor in (("half", 0.5), ("twice", 2.0)):
            yield name, way, max(1, round(value * factor)) if isinstance(value, int) else value * factor


def _outcome(
    kept: tuple[Problem, Corrected], case: Case, kind: str, setup: Setup, changes: Mapping[str, Any]
) -> Outcome:
    settings = Varied(**{**vars(setup.settings), "changes": changes})
    problem = kept[0].with_numbers(setup.physics.params)
    found = discover_in(problem, setup._replace(settings=settings), lambda line: None, kept[1])
    names, verdict = found.selection.final.estimate.active, str(found.judgement.verdict)
    return Outcome(verdict, sorted(names), is_right(case, kind, names, verdict))


def _differences(usual: Outcome, other: Outcome) -> dict[str, int]:
    return {
        "changed": usual[:2] != other[:2],
        "lost": usual.right and not other.right,
        "won": other.right and not usual.right,
    }


def _remembered(function: Callable[..., Any], known: dict[Any, Any]) -> Callable[..., Any]:
    """The same function, which works once for the same numbers. Random numbers depend on the effects of the model that
    is examined alone; of the criteria those count that screenings depend on."""

    @wraps(function)
    def once(*given: Any, **named: Any) -> Any:
        leaves = jax.tree.leaves([given, named], is_leaf=lambda one: isinstance(one, Criteria))
        key = (function.__name__, *(_fingerprint(leaf) for leaf in leaves))
        if key not in known:
            names = [leaf for leaf in leaves if isinstance(leaf, str)]
            seed = np.random.default_rng(zlib.crc32(" ".join(sorted(names)).encode()))
            given, named = jax.tree.map(
                lambda leaf: seed if isinstance(leaf, np.random.Generator) else leaf, (given, named)
            )
            known[key] = function(*given, **named)
        return known[key]

    return once


def _fingerprint(leaf: Any) -> Any:
    if isinstance(leaf, Criteria):
        return tuple(getattr(leaf, name) for name in _OF_SCREENINGS)
    if isinstance(leaf, Problem):
        return leaf.theta.tobytes(), leaf.noise
    if isinstance(leaf, np.ndarray | jax.Array):
        return zlib.crc32(np.ascontiguousarray(leaf).tobytes())
    return leaf if isinstance(leaf, int | float | str) else None


def _table(rows: Sequence[Row]) -> Table:
    columns = ("criterion", "value", "halved: changed", "right lost", "won", "doubled: changed", "right lost", "won")
    table = Table(*columns, title=f"{len(rows)} cases")
    for name, value in Criteria()._asdict().items():
        counts = Counter[tuple[str, str]]()
        for way in ("half", "twice"):
            for row in rows:
                usual, other = Outcome(*row["usual"]), Outcome(*row["others"][f"{name} {way}"])
                counts.update({(way, what): int(is_so) for what, is_so in _differences(usual, other).items()})
        cells = [str(counts[way, what]) for way in ("half", "twice") for what in ("changed", "lost", "won")]
        table.add_row(name, f"{value:g}", *cells)
    return table


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=8, help="per system")
    parser.add_argument("--systems", nargs="+", default=["pendulum", "duffing", "tanks"], choices=SYSTEMS)
    parser.add_argument("--kinds", nargs="+", default=["none", "single"], choices=KINDS)
    parser.add_argument("--noises", nargs="+", default=["white", "ar95", "heavy", "state"], choices=NOISES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--devices", type=int, default=2)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
