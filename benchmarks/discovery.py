"""Does discovery name what is hidden? python benchmarks/discovery.py [--cases 100] [--systems tanks lgssm pendulum ...]
[--kinds none single double removed] [--noises white ar95 ...] [--seeds 0 ...] [--units] [--json FILE].

Seeded cases from independent simulators (`hidden/`), each with random parameters and noise; discovery is given the
record and the nominal physics, nothing else. Prints a line per case and a table by system, kind and noise. FILE holds a
row per case, one a line: cases that are in it are not run again, unless discovery, effects, physics or the simulators
have changed since.
"""

import argparse
import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from hidden import suite
from hidden.case import SYSTEMS, Case
from hidden.noise import KINDS as NOISES
from hidden.nominal import nominal, true_parameters
from hidden.score import Row, is_right, scores
from hidden.suite import KINDS, Plan
from rich.console import Console

from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.discover import Discovery, discover_in
from pgrssnn_jax.discovery.finding import interval
from pgrssnn_jax.discovery.inverse.discover import discover_by_torques, motion_evidence
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup, set_up
from pgrssnn_jax.effects.base import effects_of
from pgrssnn_jax.effects.systems import catalogue
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training.settings import training_settings

# Arms are judged by their torques, where the noise allows it. Elsewhere the physics is integrated as it should be,
# records are whole, and names are what counts: no network is trained.
_WHOLE: dict[str, Any] = {"replace": {}, "stretches": [], "network_epochs": 0}
_AS_USERS: dict[str, Any] = {"network_epochs": 0}  # an arm in stretches, with what discovery changes in it
_ROOT = Path(__file__).resolve().parents[1]
_DECIDES = ("pgrssnn_jax/discovery", "pgrssnn_jax/effects", "pgrssnn_jax/physics", "benchmarks/hidden")
_TELL_ONLY = ("score.py", "check.py", "with_pysindy.py", "with_adcd.py", "terms.py")  # decide nothing


def main() -> None:
    arguments = _arguments()
    jax.config.update("jax_num_cpu_devices", arguments.devices)
    console, code = Console(width=160), digest()
    known = known_rows(arguments.json, code)
    rows = []
    for system in arguments.systems:
        problems: list[tuple[Problem, Corrected]] = []
        for seed in arguments.seeds:
            for plan in suite.plans(system, arguments.cases, seed, arguments.kinds, arguments.noises):
                plan = plan._replace(in_other_units=arguments.units and system != "arm")
                row = known.get(key_of(plan))
                if row is None:
                    row = run_case(plan, problems) | {"code": code}
                    console.print(_line(row), soft_wrap=True, highlight=False)
                    append_row(arguments.json, row)
                rows.append(row)
    console.print(scores(rows))


def run_case(plan: Plan, problems: list[tuple[Problem, Corrected]], case: Case | None = None) -> Row:
    """One case; problems: the first case's, compiled once, because the others differ in numbers alone; case: None for
    that of the plan."""
    case = case or suite.build(plan)
    setup = setup_of(case, plan.removed)
    if (motion := motion_evidence(setup, lambda line: None)) is not None:
        return _by_torques(plan, case, setup, motion)
    if plan.in_other_units or not problems:  # units are part of the program
        problems.clear()
        problem = build_problem(setup.physics, setup.first_effects, fixed=setup.settings.fixed)
        problems.append((problem, Corrected()))
    problem, corrected = problems[0]
    problem = problem.with_numbers(setup.physics.params)
    started = time.perf_counter()
    found = discover_in(problem, setup, lambda line: None, corrected)
    seconds = time.perf_counter() - started
    selection, judgement = found.selection, found.judgement
    screenings, unnamed = selection.screenings, judgement.unnamed
    names = sorted(selection.final.estimate.active, key=lambda name: screenings[name].base.score)
    unit = selection.floor or 1.0
    return {
        **plan._asdict(),
        "verdict": str(judgement.verdict),
        "names": names,
        "right": is_right(case, plan.kind, names, str(judgement.verdict)),
        "first": bool(names) and any(names[0] in accepted for accepted in case.accepted),
        "alternatives": {name: [one.name for one in found] for name, found in judgement.alternatives.items() if found},
        "unnamed": unnamed and unnamed[1].name,
        "errors": [selection.first.rms() / unit, selection.last.rms() / unit],
        "distances": _distances(found, true_parameters(case)),
        "closed": _closed(found, case),
        "seconds": seconds,
        "steps": found.seconds,
        "numbers": _numbers(found, names),
        "test": {name: one.error for name, one in found.test.models.items()},
        "floor": found.proved.floor,
    }


def _by_torques(plan: Plan, case: Case, setup: Setup, motion: Motion) -> Row:
    started = time.perf_counter()
    found = discover_by_torques(setup, motion, lambda line: None)
    seconds, gains = time.perf_counter() - started, found.chosen.gains
    names = [*sorted(found.active, key=lambda name: -gains[name].value), *found.friction]
    models, unit = found.test.models, found.floor or 1.0
    recalibrated, after = models["recalibrated"].error, models["after"].error
    return {
        **plan._asdict(),
        "verdict": str(found.verdict),
        "names": names,
        "right": is_right(case, plan.kind, names, str(found.verdict)),
        "first": bool(names) and any(names[0] in accepted for accepted in case.accepted),
        "alternatives": {},
        "unnamed": None,
        "errors": [recalibrated / unit, after / unit],
        "distances": {},
        "closed": (recalibrated - after) / (recalibrated - unit) if recalibrated > unit else None,
        "seconds": seconds,
        "steps": dict(found.seconds),
        "numbers": {},
        "test": {name: one.error for name, one in models.items()},
    }


def setup_of(case: Case, removed: Sequence[str]) -> Setup:
    """As `pg.discover` begins, from the defaults and what a benchmark leaves out."""
    physics = nominal(case)
    known = {effect.name for effect in catalogue(physics)}
    settings = DiscoverySettings(
        **(_AS_USERS if case.system == "arm" else _WHOLE), without=[name for name in removed if name in known]
    )
    train, test = (_at_rest(r) if case.system == "arm" else r for r in (case.train, case.test))
    return set_up(physics, train, test, settings, training_settings("pg_rssnn"), notify=lambda line: None)


def _at_rest(record: Record) -> Record:
    return record._replace(info=replace(record.info, start="rest"))


def _numbers(found: Discovery, names: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Of the effects that were named."""
    known = effects_of(found.problem.params(found.selection.final.estimate.theta))
    return {name: {key: np.ravel(value).tolist() for key, value in known[name].items()} for name in names}


def _distances(found: Discovery, truth: dict[str, float]) -> dict[str, float]:
    """Of each true number of the physics from its estimate, in halves of the 95 % interval: within it up to 1."""
    problem, final = found.problem, found.selection.final
    places = {slot.label: i for i, slot in enumerate(problem.slots) if slot.effect is None}
    distances = {}
    for name, value in truth.items():
        low, high = interval(final.estimate.theta[places[name]], final.deviation[places[name]], final.freedom)
        half = max((high - low) / 2, np.finfo(float).tiny)
        distances[name] = float((value - (low + high) / 2) / half)
    return distances


def _closed(found: Discovery, case: Case) -> float | None:
    """Part of the recalibrated gap on the test record, above the noise, that is gone; None where there was none."""
    floor = case.floor / (np.std(case.test.y) if found.test.metric.name == "NRMSE" else 1.0)
    gap = found.test.recalibrated.error - floor
    return float((found.test.recalibrated.error - found.test.after.error) / gap) if gap > 0 else None


def _line(row: Row) -> str:
    aside = row["kind"] == "none" and row["verdict"] in ("unexplained", "not_confirmed")
    mark = "right" if row["right"] else "apart" if aside else "WRONG"  # apart: no finding, but not told either
    truth, removed = " + ".join(row["truth"]) or "none", " (removed)" if row["removed"] else ""
    said = f"{row['verdict']} {' + '.join(row['names'])}".strip()
    said += f" or {row['alternatives']}" if row["alternatives"] else ""
    said += f" unnamed {row['unnamed']}" if row["unnamed"] else ""
    closed = "" if row["closed"] is None else f", closed {100 * row['closed']:.0f} %"
    missed = [f"{name} ({distance:+.1f})" for name, distance in row["distances"].items() if abs(distance) > 1]
    first, last = row["errors"]
    return (
        f"{mark} {row['system']} {row['seed']} {row['noise_kind']} {row['noise']:g}: {truth}{removed} -> {said}; "
        f"errors {first:.2f} to {last:.2f} noises{closed}"
        + (f", intervals miss {' '.join(missed)}" if missed else "")
        + f", {row['seconds']:.1f} s"
    )


def digest() -> str:
    """Of the sources of discovery: a row holds for the code that made it."""
    found = hashlib.sha256()
    for folder in _DECIDES:
        for file in sorted((_ROOT / folder).rglob("*.py")):
            if file.name not in _TELL_ONLY:
                found.update(file.read_bytes())
    return found.hexdigest()[:12]


def key_of(plan: Plan) -> str:
    return json.dumps(plan._asdict(), sort_keys=True)


def known_rows(file: Path | None, code: str) -> dict[str, Row]:
    """Rows of an earlier run by their plans."""
    if file is None or not file.exists():
        return {}
    rows: list[dict[str, Any]] = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    fields = Plan._fields
    return {json.dumps({k: row[k] for k in fields}, sort_keys=True): row for row in rows if row["code"] == code}


def append_row(file: Path | None, row: Row) -> None:
    if file is not None:
        with file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(row) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=100, help="per system and seed")
    parser.add_argument("--systems", nargs="+", default=[one for one in SYSTEMS if one != "arm"], choices=SYSTEMS)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--noises", nargs="+", default=["white"], choices=NOISES)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--units", action="store_true", help="inputs and outputs times random powers of ten")
    parser.add_argument("--devices", type=int, default=2)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
