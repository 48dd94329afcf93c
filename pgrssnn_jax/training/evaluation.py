"""From trained members to predictions, and from predictions to `metrics.json`.

Means are never taken over silently missing members: planned, finished and failed stand beside every mean.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.records.record import Array, Record, valid_mask
from pgrssnn_jax.records.scaling import Units
from pgrssnn_jax.training.members import Member, MemberMapping, jit_members
from pgrssnn_jax.training.metrics import all_metrics, rmse
from pgrssnn_jax.training.objective import MemberData, Objective
from pgrssnn_jax.training.optimise import MemberState, MemberStatus


class Predictions(NamedTuple):
    """Free runs with the best parameters of every member, in physical units: `[member, seq, time, y]`; finite
    `[member]` is False where a state left the floating-point range; x0 `[member, seq, x]`: where the test runs started.
    """

    test: np.ndarray
    validation: np.ndarray
    finite: np.ndarray
    x0: np.ndarray


def predict(
    objective: Objective,
    state: MemberState,
    data: MemberData,
    test: Record,
    mapping: MemberMapping,
) -> Predictions:
    """Runs the best parameters of every member on its validation and test records `[member, seq, time, channel]`."""

    def one(state: MemberState, data: MemberData, test: Record) -> tuple[Array, ...]:
        model, params = objective.model, objective.assemble(state.best, data.scaling)
        start = objective.test_state(state.best, data, test)
        on_test = rollout(model, params, test.u, start, valid=valid_mask(test))
        on_validation = objective.validate(state.best, data)
        return on_test.y, on_validation.y, (on_test.first_bad == test.u.shape[1]).all(), start

    return Predictions(*map(np.asarray, jit_members(one, mapping)(state, data, test)))


def in_physical_units(predictions: Predictions, units: Units) -> Predictions:
    """Undoes the standardisation of records (`scaling.standardise`); units per member."""
    offset, scale = (np.asarray(a)[:, None, None, :] for a in units.y)
    return predictions._replace(
        test=offset + scale * predictions.test, validation=offset + scale * predictions.validation
    )


def member_rows(
    members: Sequence[Member],
    state: MemberState,
    predictions: Predictions,
    *,
    validation: Record,
    test: Record,
    n_inits: Sequence[int],
) -> list[dict[str, Any]]:
    """One entry of `metrics.json` per member; validation and test are measured records `[member, seq, time, y]`.

    The first of n_inits is the one of the main figures.
    """
    rows: list[dict[str, Any]] = []
    for i, member in enumerate(members):
        outcome = MemberStatus(int(state.outcome[i]))
        if not outcome.failed and not predictions.finite[i]:
            outcome = MemberStatus.STATE_NOT_FINITE
        row: dict[str, Any] = {
            **member._asdict(),
            "status": "failed" if outcome.failed else "ok",
            "reason": outcome.sentence if state.epoch[i] or outcome.failed else "not trained",
            "best_epoch": int(state.best_epoch[i]),
            "epochs": int(state.epoch[i]),
            "rollbacks": int(state.rollbacks[i]),
            "test": None,
            "validation": None,
        }
        if not outcome.failed:
            on_test = {
                n: all_metrics(measured=test.y[i], predicted=predictions.test[i], mask=test.mask[i], n_init=n)
                for n in n_inits
            }
            row["test"] = on_test[n_inits[0]]
            row["validation"] = all_metrics(
                measured=validation.y[i], predicted=predictions.validation[i], mask=validation.mask[i], n_init=0
            )
            row["by_n_init"] = {str(n): figures for n, figures in on_test.items()}
        rows.append(row)
    return rows


def ensemble(rows: Sequence[dict[str, Any]], test: Record, predictions: Predictions) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the finished members' predictions, `[seq, time, y]`.

    NaN when no member finished, or when the members predict different test records, of which no mean makes sense.
    """
    finished = [i for i, row in enumerate(rows) if row["status"] == "ok"]
    same = all(np.array_equal(test.y[i], test.y[0]) and np.array_equal(test.u[i], test.u[0]) for i in finished)
    if not finished or not same:
        missing = np.full(test.y.shape[1:], np.nan)
        return missing, missing
    chosen = predictions.test[finished].astype(np.float64)
    return chosen.mean(0), chosen.std(0)


def summary(
    rows: Sequence[dict[str, Any]], test: Record, ensemble_mean: np.ndarray, n_inits: Sequence[int]
) -> dict[str, Any]:
    """Figures over the finished members; a member's figure is the mean over its outputs."""
    finished = [row for row in rows if row["status"] == "ok"]
    counts = {"planned": len(rows), "finished": len(finished), "failed": len(rows) - len(finished)}
    by_n_init = {str(n): _over_members(finished, test, ensemble_mean, n) for n in n_inits}
    return {**counts, **by_n_init[str(n_inits[0])], "by_n_init": by_n_init}


def _over_members(
    finished: Sequence[dict[str, Any]], test: Record, ensemble_mean: np.ndarray, n_init: int
) -> dict[str, float]:
    figures = {f"{name}_mean": float("nan") for name in ("rmse", "nrmse", "fit_percent", "cc")}
    figures |= {f"rmse_{what}": float("nan") for what in ("std", "median", "best", "ensemble")}
    if not finished:
        return figures
    for name in ("rmse", "nrmse", "fit_percent", "cc"):
        values = np.array([np.mean(row["by_n_init"][str(n_init)][name]) for row in finished])
        figures[f"{name}_mean"] = float(np.mean(values))
        if name == "rmse":
            spread = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            figures |= {"rmse_std": spread, "rmse_median": float(np.median(values)), "rmse_best": float(values.min())}
    if np.isfinite(ensemble_mean).all():
        together = rmse(measured=test.y[0], predicted=ensemble_mean, mask=test.mask[0], n_init=n_init)
        figures["rmse_ensemble"] = float(np.mean(together))
    return figures
