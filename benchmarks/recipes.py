"""`recipe=auto` on generated data: is PG-RSSNN ever worse than its physics, or than a black box of its size?

    python benchmarks/recipes.py --cases 60 --seed 900
    python benchmarks/recipes.py --cases 48 --seed 1700 --intervals    # without the rivals

Case k takes, in turn, a system, a number of samples, a physics and a noise. Physics: `right` has the plant's numbers,
`bent` numbers that are off, `wrong` lacks an effect besides. Figures: RMSE on the test record of the case, mean over
members; the physics alone starts its records in the same way. Nothing is chosen on the test record.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from hidden import suite
from hidden.case import Case
from hidden.lgssm import TRUE
from hidden.nominal import nominal, true_parameters

import pgrssnn_jax as pg
from pgrssnn_jax.acceleration.devices import keep_compiled, use_all_cores
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Record, crop

SYSTEMS = ("tanks", "pendulum", "lgssm", "servo")
SAMPLES = (100, 200, 400, 2000)  # at most: a record that is shorter is taken whole
PHYSICS = ("right", "bent", "wrong")
NOISES = ("white", "ar95", "heavy")
RIVALS = ("physics_only", "black_box")
TOLERANCE = 1.02  # worse, or better, by more than 2 %


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=900)
    parser.add_argument("--model", default="pg_rssnn")
    parser.add_argument("--intervals", action="store_true", help="no rivals: what the intervals hold, alone")
    parser.add_argument("--out", type=Path, help="JSON file for the rows")
    arguments = parser.parse_args()
    use_all_cores()
    keep_compiled()
    rows, rivals = [], not arguments.intervals
    kinds = [(s, n, p) for n in SAMPLES for p in PHYSICS for s in SYSTEMS]
    for k in range(arguments.cases):
        system, samples, kind = kinds[(k * 7) % len(kinds)]
        noise = NOISES[k % len(NOISES)]
        rng = np.random.default_rng([arguments.seed, k])
        rows.append(_row(system, samples, kind, noise, arguments.seed + k, rng, arguments.model, rivals))
        print(" ".join(f"{name}={_short(value)}" for name, value in rows[-1].items()), flush=True)
        if arguments.out:
            arguments.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    for rival in RIVALS if rivals else ():
        worse = sum(row["ours"] > TOLERANCE * row[rival] for row in rows)
        better = sum(TOLERANCE * row["ours"] < row[rival] for row in rows)
        print(f"against {rival}: worse {worse}, better {better} of {len(rows)} by more than 2 %")
    inside = [row["inside"] for row in rows if row["inside"] is not None]
    if inside:
        good = sum(0.85 <= share <= 0.95 for share in inside)
        print(f"90 % bands hold {np.mean(inside):.1%} of the test samples on average, 85 to 95 % in {good} cases")


def _row(
    system: str,
    samples: int,
    kind: str,
    noise: str,
    seed: int,
    rng: np.random.Generator,
    model: str,
    rivals: bool,
) -> dict[str, Any]:
    catalogue = suite.catalogue(system)
    names = [name for name in catalogue.named if name not in catalogue.recalibrated]
    truth = (str(rng.choice(names)),) if kind == "wrong" else ()
    plan = suite.Plan(system, seed, "single" if truth else "none", truth, (), catalogue.noises[1], noise)
    case = suite.build(plan)
    physics = _right(case) if kind == "right" else nominal(case)
    train = crop(case.train, 0, min(samples, case.train.u.shape[1]))
    started = time.perf_counter()
    ours = pg.fit(model, physics, train, recipe="auto", quiet=True)
    seconds = time.perf_counter() - started
    metrics = ours.evaluate(case.test).metrics
    against = _rivals(ours, physics, train, case, metrics["n_init"]) if rivals else {}
    return {
        "system": system, "samples": train.u.shape[1], "physics": kind, "noise": noise, "truth": ",".join(truth),
        "ours": metrics["summary"]["rmse_mean"], "ensemble": metrics["summary"].get("rmse_ensemble"),
        **against, "floor": case.floor,
        "inside": (metrics["interval"] or {}).get("coverage", [None])[0], "seconds": seconds,
        "chosen": metrics["recipe"]["chosen"], "fell_back": len(metrics["recipe"]["fell_back"]),
    }  # fmt: skip


def _rivals(ours: pg.Ensemble, physics: Physics, train: Record, case: Case, skipped: int) -> dict[str, float]:
    """Mean RMSE of the physics alone and of a black box on the same samples."""
    run = ours.settings.run
    same = {"initial_state": run.initial_state, "n_init": run.n_init, "report_n_init": [skipped], "quiet": True}
    alone = pg.fit("physics_only", physics, train, validation=train, recipe="default", **same)
    black = pg.fit("rssnn", physics, train, recipe="auto", report_n_init=[skipped], quiet=True)
    scores = (one.evaluate(case.test).metrics["summary"]["rmse_mean"] for one in (alone, black))
    return dict(zip(RIVALS, scores, strict=True))


def _right(case: Case) -> Physics:
    """The nominal physics with the plant's numbers."""
    if case.system == "lgssm":
        return nominal(case._replace(physics=TRUE))
    physics = nominal(case)
    return physics._replace(params={**physics.params, **true_parameters(case)})


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value).replace(" ", "")


if __name__ == "__main__":
    main()
