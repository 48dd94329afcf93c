"""Discovery beside PySINDy and ADCD on the same cases: python benchmarks/head_to_head.py [--cases 36] [--seed 4100]
[--only ours | pysindy | pysindy_best | adcd] [--json FILE] [--page docs/head_to_head.md], and for the others
`pip install -e '.[compare]'`.

    suite   hidden-effect cases, one effect or none, noise of three kinds: all methods
    laws    ADCD's own scenarios: ADCD on their static data; this project on those that are the law of a motion
    tanks   the measured cascaded tanks (`PGRSSNN_DATA`): this project beside published figures

FILE holds a row per case and method, one a line: rows that are in it are not computed again, so an interrupted run goes
on; --most N ends it after N new rows. It keeps rows of older code: delete it after a change. --page writes the tables
of FILE into that page.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from discovery import run_case
from head_to_head_tables import tables
from hidden import suite, with_adcd, with_pysindy
from hidden.case import Case
from hidden.nominal import nominal
from hidden.score import FINDINGS, Row
from hidden.suite import Plan
from hidden.terms import CAN_NAME, MEANING, size_of
from scipy.optimize import least_squares
from speed.tables import replace_between

import pgrssnn_jax as pg
from pgrssnn_jax.acceleration.devices import keep_compiled
from pgrssnn_jax.discovery.problem import start_guess
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.simulate import free_run
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.training.metrics import nrmse, rmse

METHODS = ("ours", "pysindy", "pysindy_best", "adcd")  # in this order: adcd changes JAX's precision when it is imported
NOISES = ("white", "ar95", "heavy")
# Number of an effect that is compared: its name in the effect, that of the simulator's size, and whether in samples.
SIZES: dict[str, tuple[str, str, bool]] = {
    "input_offset": ("offset", "u_offset", False),
    "sensor_offset": ("offset", "y_offset", False),
    "sensor_gain": ("gain", "y_gain", False),
    "input_saturation": ("high", "u_top", False),
    "sensor_saturation": ("high", "y_top", False),
    "input_dead_zone": ("width", "u_dead", False),
    "input_delay": ("delay", "delay", True),
    "input_lag": ("time_constant", "lag", True),
    "backlash": ("half_width", "u_play", False),
    "coulomb_friction": ("a", "dry", False),
    "quadratic_drag": ("c", "drag", False),
    "cubic_spring": ("k", "cubic", False),
    "leak": ("r", "leak", False),
    "inflow": ("f", "inflow", False),
    "leak_tank1": ("rate", "leak", False),
    "bypass": ("share", "bypass", False),
    "pump_saturation": ("voltage", "u_top", False),
    "pump_dead_zone": ("voltage", "u_dead", False),
    "outlet_exponent": ("exponent", "exponent", False),
    "overflow_1to2": ("level", "rim_1", False),
    "overflow_lost": ("level", "rim_1", False),
    "tank2_overflow": ("level", "rim_2", False),
}


def main() -> None:
    arguments = _arguments()
    keep_compiled()
    rows = _read(arguments.json)
    done = {_key(row) for row in rows}
    methods = [arguments.only] if arguments.only else METHODS
    for row, work in _tasks(arguments, methods):
        if _key(row) not in done and len(rows) - len(done) < arguments.most:
            started = time.process_time()  # processor seconds: other work on the machine does not count
            try:
                rows.append(row | work() | {"seconds": time.process_time() - started})
            except ImportError as missing:
                print(f"{row['method']}: not installed: {missing}")
                continue
            print(rows[-1], flush=True)
            if arguments.json:
                with arguments.json.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(rows[-1]) + "\n")
    text = tables(rows)
    print(text)
    if arguments.page:
        replace_between(arguments.page, "<!-- tables -->", "<!-- end of tables -->", f"\n{text}\n")


def suite_plans(cases: int, seed: int, systems: list[str]) -> list[Plan]:
    """One effect and none in turn; every system begins with another noise."""
    shares = [cases // len(systems) + (i < cases % len(systems)) for i in range(len(systems))]
    found = [
        suite.plans(system, share, seed + i, ("single", "none"), NOISES)
        for i, (system, share) in enumerate(zip(systems, shares, strict=True))
    ]
    return [plan for plans in found for plan in plans]


def _tasks(arguments: argparse.Namespace, methods: Any) -> Iterator[tuple[Row, Callable[[], Row]]]:
    """What identifies a row, and what computes the rest of it."""
    plans = suite_plans(arguments.cases, arguments.seed, arguments.systems)
    ours = Ours()
    run = {"ours": ours.case, "pysindy": by_pysindy, "pysindy_best": partial(by_pysindy, allowed=0.0), "adcd": by_adcd}
    for method in methods:
        for plan in plans if "suite" in arguments.parts else ():
            if method != "adcd" or plan.system in with_adcd.SYSTEMS:
                key = {"part": "suite", "method": method, **plan._asdict(), "truth": list(plan.truth)}
                yield key | {"removed": []}, lambda plan=plan, method=method: run[method](plan)
        if "laws" in arguments.parts and method == "ours":
            for name in with_adcd.LAWS:
                row = {"part": "laws", "method": method, "seed": arguments.seed, "truth": [name]}
                yield row, lambda name=name: ours.case(*with_adcd.law(name, arguments.seed))
        if "laws" in arguments.parts and method == "adcd":
            for name in with_adcd.scenarios():
                row = {"part": "laws", "method": method, "seed": arguments.seed, "truth": [name]}
                yield row, lambda name=name: with_adcd.at_home(name, arguments.seed)
        if "tanks" in arguments.parts and method == "ours":
            yield {"part": "tanks", "method": method}, measured_tanks


class Ours:
    """This project, with the settings of `discovery.py`; a system's program is compiled once."""

    def __init__(self) -> None:
        self.system, self.problems = "", []

    def case(self, plan: Plan, case: Case | None = None) -> Row:
        case = case or suite.build(plan)
        if self.system != plan.system:
            self.system, self.problems = plan.system, []
        row = run_case(plan, self.problems, case)
        name = plan.truth[0] if plan.truth else ""
        guess = row["numbers"].get(name, {}).get(SIZES.get(name, ("",))[0])
        test = row["test"]
        return {
            "verdict": row["verdict"],
            "names": row["names"],
            "alternatives": row["alternatives"],
            "found": row["verdict"] in FINDINGS,
            "first": row["first"],
            "right": row["right"],
            "parameter_error": _parameter_error(case, guess),
            **_errors(case, test["before"], test["after"]),
        }


def by_pysindy(plan: Plan, allowed: float = 1.0) -> Row:
    case = suite.build(plan)
    found = with_pysindy.regressed(case, allowed)
    names = [MEANING.get((term.role, term.shape), ()) for term, _ in found.terms]
    extra = {"given": found.given, "window": found.window, "threshold": _finite(found.threshold)}
    return _of_terms(case, found.terms, names, found.physics) | extra


def _of_terms(case: Case, terms: Any, names: list[tuple[str, ...]], physics: Physics) -> Row:
    """The scores of a method that finds terms in equations."""
    wanted = set(case.accepted[0]) if case.accepted else set()
    first = bool(names) and bool(wanted & set(names[0]))
    guess = None
    if first and case.truth[0] in names[0]:
        guess = size_of(case.truth[0], *terms[0], physics, nominal(case))
    return {
        "terms": [[term.text, c] for term, c in terms],
        "names": [list(several) for several in names],
        "has_term": bool(wanted & CAN_NAME),
        "found": bool(terms),
        "first": first,
        "right": all(wanted & set(several) for several in names) and bool(names) if wanted else not terms,
        "parameter_error": _parameter_error(case, guess),
        **_errors(case, on_test(nominal(case), case.test), on_test(physics, case.test)),
    }


def by_adcd(plan: Plan) -> Row:
    case = suite.build(plan)
    terms, physics = with_adcd.corrections(case, plan.seed)
    names = [MEANING.get((term.role, term.shape), ()) for term, _ in terms]
    return _of_terms(case, terms, names, physics)


def on_test(physics: Physics, record: Record, n_init: int = 50) -> float:
    """RMSE of a free run, of several outputs NRMSE, from a start fitted to the first n_init samples, which do not
    count: as a discovery measures it."""
    u, y = np.asarray(record.u, float), np.asarray(record.y, float)
    spread = y.std(axis=(0, 1))
    with jax.enable_x64(True), np.errstate(over="ignore", invalid="ignore"):

        def misfit(x0: np.ndarray) -> np.ndarray:
            found = free_run(physics, u[:, :n_init], x0[None])[0]
            return np.nan_to_num(np.ravel((found - y[:, :n_init]) / spread), nan=1e6, posinf=1e6, neginf=-1e6)

        start = start_guess(physics, u[:, :n_init], y[:, :n_init], np.ones_like(y[:, :n_init], bool))[0]
        found = np.asarray(free_run(physics, u, least_squares(misfit, start).x[None])[0])
        metric = nrmse if y.shape[-1] > 1 else rmse
        return float(np.mean(metric(measured=record.y, predicted=found, mask=record.mask, n_init=n_init)))


def _errors(case: Case, before: float, after: float) -> Row:
    """Free runs on the test record, in units of the noise."""
    unit = case.floor / (float(np.std(case.test.y)) if case.test.y.shape[-1] > 1 else 1.0)
    return {"before": _finite(before / unit), "after": _finite(after / unit)}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _parameter_error(case: Case, guess: Any) -> float | None:
    """|estimate - truth| / |truth|; of an array by their norms."""
    if guess is None or not case.truth or case.truth[0] not in SIZES:
        return None
    _, key, in_samples = SIZES[case.truth[0]]
    truth = np.ravel(case.magnitudes.get(key, np.nan)) * (case.train.info.dt if in_samples else 1.0)
    guess = np.ravel(guess)
    if len(guess) != len(truth):  # a number per state or channel, of which one is not neutral
        guess, truth = (np.array([a[np.argmax(np.abs(a))]]) for a in (guess, truth))
    return _finite(float(np.linalg.norm(guess - truth) / np.linalg.norm(truth)))


def measured_tanks() -> Row:
    """Free-run RMSE in V on the test record of the measured tanks; seeds and recipe of `pg.fit`."""
    train, test = pg.load_benchmark("cascaded_tank")
    physics = pg.physics.cascaded_tanks(clamp=True)
    found = pg.discover(physics, train, test, quiet=True, network_epochs=0)
    summary = pg.fit("pg_rssnn", found.physics, train, quiet=True).evaluate(test).metrics["summary"]
    return {
        "source": str(test.info.source),
        "names": [effect.name for effect in found.effects],
        "gap": {key: found.gap[key]["test"] for key in ("before", "recalibrated", "after")},
        "network": {key: summary[f"rmse_{key}"] for key in ("mean", "std", "best", "ensemble")},
    }


def _read(file: Path | None) -> list[Row]:
    if file is None or not file.exists():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def _key(row: Row) -> str:
    fields = ("part", "method", *Plan._fields)
    return json.dumps({key: row.get(key) for key in fields}, sort_keys=True)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=36, help="of the suite, over its systems")
    parser.add_argument("--seed", type=int, default=4100)
    parser.add_argument("--systems", nargs="+", default=list(with_pysindy.SYSTEMS), choices=with_pysindy.SYSTEMS)
    parser.add_argument("--parts", nargs="+", default=["suite", "laws", "tanks"], choices=["suite", "laws", "tanks"])
    parser.add_argument("--only", choices=METHODS)
    parser.add_argument("--most", type=int, default=10**6, help="rows to compute in this call")
    parser.add_argument("--json", type=Path, help="rows, one a line")
    parser.add_argument("--page", type=Path, help="Markdown whose tables are written again")
    return parser.parse_args()


if __name__ == "__main__":
    main()
