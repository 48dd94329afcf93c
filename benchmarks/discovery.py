"""Does discovery name what is hidden? python benchmarks/discovery.py [--cases 100] [--systems tanks lgssm pendulum]
[--kinds single double none removed] [--seed 0] [--json FILE] [--sindy].

Seeded cases from independent simulators (`hidden/`), each with random parameters and noise; discovery is given the
record and the nominal physics, nothing else. Prints a line per case, a table per kind, the confusions and the seconds.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from hidden import compare, pendulum, suite
from hidden.case import Case
from hidden.suite import KINDS, Plan
from rich.console import Console
from rich.table import Table

from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup, set_up
from pgrssnn_jax.discovery.unknown import flexible_problem
from pgrssnn_jax.discovery.workflow import Discovery, discover_in
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training.settings import training_settings

# The physics is integrated as it should be, records are whole, and names are what counts: no network is trained.
_WHOLE = {"replace": {}, "stretches": [], "network_epochs": 0}
_AS_USERS = {"network_epochs": 0}  # an arm in stretches, with what discovery changes in it


def main() -> None:
    arguments = _arguments()
    jax.config.update("jax_num_cpu_devices", arguments.devices)
    console = Console(width=160)
    rows = []
    for system in arguments.systems:
        problems: list[tuple[Problem, Problem]] = []
        plans = suite.plans(system, arguments.cases, arguments.seed, arguments.kinds)
        for plan in plans:
            rows.append(_one(plan, problems, sindy=arguments.sindy))
            console.print(_line(rows[-1]), soft_wrap=True, highlight=False)
            if arguments.json is not None:
                arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        console.print(_table([row for row in rows if row["system"] == system], system))


def _one(plan: Plan, problems: list[tuple[Problem, Problem]], *, sindy: bool) -> dict[str, Any]:
    """One case; problems: the first case's, compiled once, because the others differ in numbers alone."""
    case = suite.build(plan)
    setup = _set_up(case, plan.removed)
    if not problems:
        problem = build_problem(setup.physics, setup.effects, fixed=setup.settings.fixed)
        problems.append((problem, flexible_problem(problem)))
    problem, flexible = (one.with_numbers(setup.physics.params) for one in problems[0])
    started = time.perf_counter()
    found = discover_in(
        problem, setup.estimation, setup.test, setup.settings, lambda line: None, start=setup.start, flexible=flexible
    )
    seconds = time.perf_counter() - started
    names = list(found.found.final.estimate.active)
    return {
        **plan._asdict(),
        "verdict": str(found.judged.verdict),
        "names": sorted(names, key=lambda name: -found.found.stages[name].base.cost),
        "right": _right(case, plan.kind, names, str(found.judged.verdict)),
        "closed": _closed(found, case),
        "seconds": seconds,
        "steps": found.seconds,
        **(_by_sindy(case) if sindy and case.system in compare.SYSTEMS else {}),
    }


def _set_up(case: Case, removed: Sequence[str]) -> Setup:
    """As `pg.discover` begins, from the defaults and what a benchmark leaves out."""
    physics = _nominal(case)
    known = {effect.name for effect in catalogue(physics)}
    settings = DiscoverySettings(
        **(_AS_USERS if case.system == "arm" else _WHOLE), without=[name for name in removed if name in known]
    )
    train, test = (_at_rest(r) if case.system == "arm" else r for r in (case.train, case.test))
    return set_up(physics, train, test, settings, training_settings("pg_rssnn"), notify=lambda line: None)


def _at_rest(record: Record) -> Record:
    return record._replace(info=replace(record.info, start="rest"))


def _by_sindy(case: Case) -> dict[str, Any]:
    """Right: a name of what is there, or none where nothing is."""
    name = compare.sindy_name(case)
    accepted = {one for names in case.accepted for one in names} or {None}
    return {"sindy": name, "sindy_right": name in accepted}


def _nominal(case: Case) -> Physics:
    """The physics that discovery is given: the nominal one, integrated finely enough not to be in the way; an arm is
    what users have."""
    if case.system == "tanks":
        return cascaded_tanks(**case.physics, integrator="rk4")
    if case.system == "lgssm":
        return lgssm(**case.physics)
    if case.system == "pendulum":
        return pendulum.pendulum(**case.physics)
    return arm(**{"sub_steps": 5, **case.physics})  # finely enough not to be in the way


def _right(case: Case, kind: str, names: Sequence[str], verdict: str) -> bool:
    if kind == "removed":
        return verdict == "unknown_effect"
    if kind == "none":
        return not names and verdict in ("no_discrepancy", "miscalibrated")
    matched = [any(name in accepted for name in names) for accepted in case.accepted]
    return all(matched) and len(names) == len(matched) and verdict in ("effect_found", "ambiguous")


def _closed(found: Discovery, case: Case) -> float:
    """Part of the recalibrated gap on the test record, above the noise, that is gone."""
    floor = case.floor / (np.std(case.test.y) if found.merit.name == "NRMSE" else 1.0)
    gap = found.test.recalibrated.error - floor
    return (found.test.recalibrated.error - found.test.after.error) / gap if gap > 0 else float("nan")


def _percent(share: float) -> str:
    """A dash where there was no gap to close."""
    return "–" if np.isnan(share) else f"{100 * share:.0f} %"


def _line(row: dict[str, Any]) -> str:
    mark = "right" if row["right"] else "WRONG"
    truth, removed = " + ".join(row["truth"]) or "none", " (removed)" if row["removed"] else ""
    said = f"{row['verdict']} {' + '.join(row['names'])}".strip()
    more = f"; sindy {row['sindy']}" if "sindy" in row else ""
    return (
        f"{mark} {row['system']} {row['seed']} noise {row['noise']:g}: {truth}{removed} -> {said}; "
        f"closed {_percent(row['closed'])}, {row['seconds']:.1f} s{more}"
    )


def _table(rows: Sequence[dict[str, Any]], system: str) -> Table:
    compared = all("sindy" in row for row in rows)
    columns = ("kind", "cases", "right", "right name first", "median closed", "median s")
    table = Table(*columns, *(["SINDy names one"] if compared else []), title=system)
    for kind in KINDS:
        own = [row for row in rows if row["kind"] == kind]
        if own:
            first = sum(bool(row["names"]) and row["names"][0] in row["truth"] for row in own)
            gaps = [row["closed"] for row in own if not np.isnan(row["closed"])]
            closed = _percent(float(np.median(gaps)) if gaps else float("nan"))
            seconds = f"{np.median([row['seconds'] for row in own]):.1f}"
            figures = [len(own), sum(row["right"] for row in own), first, closed, seconds]
            figures += [sum(row["sindy_right"] for row in own)] if compared else []
            table.add_row(kind, *map(str, figures))
    return table


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=100, help="per system")
    parser.add_argument("--systems", nargs="+", default=["tanks", "lgssm", "pendulum"])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--devices", type=int, default=2)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--sindy", action="store_true", help="the same cases by SINDy on residual derivatives")
    return parser.parse_args()


if __name__ == "__main__":
    main()
