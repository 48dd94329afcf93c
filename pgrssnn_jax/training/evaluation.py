"""From trained members to predictions, and from predictions to `metrics.json`.

Means are never taken over silently missing members: planned, finished and failed stand beside every mean.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.models.initial_state import first_output_states
from pgrssnn_jax.models.model import Model
from pgrssnn_jax.models.rollout import Trajectory, rollout
from pgrssnn_jax.physics.stiffness import of_shorter_steps, stays_finite
from pgrssnn_jax.records.record import Array, Record, take, valid_mask
from pgrssnn_jax.records.scaling import Scaling, Units
from pgrssnn_jax.training.members import Member, MemberMapping, jit_members, repeat
from pgrssnn_jax.training.metrics import all_metrics, rmse
from pgrssnn_jax.training.objective import MemberData, Objective
from pgrssnn_jax.training.optimise import MemberState, MemberStatus
from pgrssnn_jax.training.plan import MemberTests, Plan, member_mapping

_FIGURES = ("rmse", "nrmse", "fit_percent", "cc")


class Trained(NamedTuple):
    """What predicting needs of trained members: their best parameters, scaling and units, all `[member]` first.

    start `[member, x]`: x_0 of the first training sequence, NaN where it is not known.
    """

    objective: Objective
    mapping: MemberMapping
    members: Sequence[Member]
    state: MemberState
    scaling: Scaling
    units: Units
    start: np.ndarray


class Predictions(NamedTuple):
    """Free runs with the best parameters of every member, in measured units: y `[member, seq, time, y]`; finite
    `[member]` is False where a state left the floating-point range; x0 `[member, seq, x]`: where the runs started;
    x `[member, seq, time, x]`: states; alone: y of the same members without their networks, None for a black box and
    where there are no networks."""

    y: np.ndarray
    finite: np.ndarray
    x0: np.ndarray
    x: np.ndarray | None = None
    alone: np.ndarray | None = None


def has_failed(outcome: int) -> bool:
    """Of `MemberState.outcome`."""
    return MemberStatus(outcome).failed


def trained_members(plan: Plan, state: MemberState) -> Trained:
    """The members of a plan after training; XLA alone evaluates them, here and where they are loaded."""
    start = jit_members(lambda s, d: plan.fit.objective.trained_start(s.best, d), plan.mapping)(state, plan.data)
    objective = plan.fit.objective._replace(route=None, devices=1)
    mapping = member_mapping(plan.settings, len(plan.members), plan.data.train.u.shape[1])
    return Trained(objective, mapping, plan.members, state, plan.data.scaling, plan.units, np.asarray(start))


def predict(trained: Trained, test: Record) -> Predictions:
    """Runs every member on its test record `[member, seq, time, channel]`, in the units that the model works in. One
    compiled program serves runs that were just trained and loaded ones: their predictions are equal bit by bit."""
    objective = trained.objective

    def one(state: MemberState, scaling: Scaling, start: Array, test: Record) -> tuple[Array, ...]:
        x0 = objective.test_state(state.best, scaling, start, test)
        run = rollout(objective.model, objective.assemble(state.best, scaling), test.u, x0, valid=valid_mask(test))
        alone = _without_networks(objective, state, scaling, test, x0)
        return run.y, _finite(run), x0, run.x, *alone

    start = trained.start.astype(np.float32)
    found = jit_members(one, trained.mapping)(trained.state, trained.scaling, start, test)
    y, finite, x0, x, *alone = found
    without = _measured(alone[0], trained.units) if alone else None
    return Predictions(_measured(y, trained.units), np.asarray(finite), np.asarray(x0), np.asarray(x), without)


def validated_outputs(trained: Trained, data: MemberData) -> np.ndarray:
    """What every member predicts of its validation record, `[member, seq, time, y]` in measured units."""
    y = jit_members(lambda s, d: trained.objective.validate(s.best, d).y, trained.mapping)(trained.state, data)
    return _measured(y, trained.units)


def outputs_as_tested(trained: Trained, data: MemberData) -> np.ndarray:
    """As `validated_outputs`, from starts that are found as those of a test record."""
    y = jit_members(lambda s, d: trained.objective.as_tested(s.best, d).y, trained.mapping)(trained.state, data)
    return _measured(y, trained.units)


def predict_from(trained: Trained, u: np.ndarray, x0: np.ndarray) -> Predictions:
    """Runs every member from u `[seq, time, u]` in measured units and x0 `[member, seq, x]` in the physics' units."""

    def one(state: MemberState, scaling: Scaling, units: Units, u: Array, x0: Array) -> tuple[Array, ...]:
        params = trained.objective.assemble(state.best, scaling)
        run = rollout(trained.objective.model, params, units.u.to_scaled(u), x0, chunk="auto")
        return run.y, _finite(run)

    start, inputs = jnp.asarray(x0, jnp.float32), repeat(np.asarray(u, np.float32), len(x0))
    y, finite = jit_members(one, trained.mapping)(trained.state, trained.scaling, trained.units, inputs, start)
    return Predictions(_measured(y, trained.units), np.asarray(finite), np.asarray(x0))


def _without_networks(
    objective: Objective, state: MemberState, scaling: Scaling, test: Record, x0: Array
) -> tuple[Array, ...]:
    """y of the physics of a member alone, where it has networks beside it."""
    model = objective.model
    if model.graph is None or not model.spec.guided:
        return ()
    params = objective.assemble(state.best, scaling)
    return (rollout(model._replace(graph=None), params, test.u, x0, valid=valid_mask(test)).y,)


def _finite(run: Trajectory) -> Array:
    return (run.first_bad == run.y.shape[1]).all()


def _measured(y: Array, units: Units) -> np.ndarray:
    """Undoes the standardisation of records (`scaling.standard_units`)."""
    offset, scale = (np.asarray(a)[:, None, None, :] for a in units.y)
    return offset + scale * np.asarray(y)


def member_rows(
    trained: Trained,
    tests: MemberTests,
    predictions: Predictions,
    validation: Record | None = None,
    validated: np.ndarray | None = None,
) -> list[dict[str, Any]]:
    """One entry of `metrics.json` per member; validation: measured records `[member, seq, time, y]` with what was
    predicted on them, None where they are not at hand."""
    rows: list[dict[str, Any]] = []
    hints: dict[int, str] = {}  # by the dataset
    test, state, n_inits = tests.measured, trained.state, tests.n_inits
    for i, member in enumerate(trained.members):
        status = MemberStatus(int(state.outcome[i]))
        if not status.failed and not predictions.finite[i]:
            status = MemberStatus.STATE_NOT_FINITE
        if status.failed and member.dataset not in hints:
            hints[member.dataset] = _hint(trained.objective.model, take(tests.record, i))
        reason = status.sentence if state.epoch[i] or status.failed else "not trained"
        row: dict[str, Any] = {
            **member._asdict(),
            "status": "failed" if status.failed else "ok",
            "reason": reason + (hints[member.dataset] if status.failed else ""),
            "best_epoch": int(state.best_epoch[i]),
            "epochs": int(state.epoch[i]),
            "rollbacks": int(state.rollbacks[i]),
            "test": None,
            "validation": None,
        }
        if not status.failed:
            on_test = {n: _figures(take(test, i), predictions.y[i], n) for n in n_inits}
            row["test"] = on_test[n_inits[0]]
            if validation is not None and validated is not None:
                row["validation"] = _figures(take(validation, i), validated[i], 0)
            row["by_n_init"] = {str(n): figures for n, figures in on_test.items()}
        rows.append(row)
    return rows


def _hint(model: Model, test: Record) -> str:
    """What keeps the physics of a member in the floating-point range, where it leaves the range without networks."""
    physics, u, x0 = model.physics, np.asarray(test.u), np.asarray(first_output_states(model, test))
    alone = model.spec.guided and not stays_finite(physics, u, x0)
    return of_shorter_steps(physics, u, x0) if alone else ""


def _figures(record: Record, predicted: np.ndarray, n_init: int) -> dict[str, list[float]]:
    return all_metrics(measured=record.y, predicted=predicted, mask=record.mask, n_init=n_init)


def ensemble(rows: Sequence[dict[str, Any]], test: Record, predictions: Predictions) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the finished members' predictions, `[seq, time, y]`.

    NaN when no member finished, or when the members predict different test records, of which no mean makes sense.
    """
    finished = [i for i, row in enumerate(rows) if row["status"] == "ok"]
    first = finished[0] if finished else 0
    same = all(np.array_equal(test.y[i], test.y[first]) and np.array_equal(test.u[i], test.u[first]) for i in finished)
    if not finished or not same:
        missing = np.full(test.y.shape[1:], np.nan)
        return missing, missing
    chosen = predictions.y[finished].astype(np.float64)
    return chosen.mean(0), chosen.std(0)


def groups(rows: Sequence[dict[str, Any]], ensemble_mean: np.ndarray) -> list[list[int]]:
    """Finished members that were tested on the same record: all, or those of each dataset."""
    finished = [i for i, row in enumerate(rows) if row["status"] == "ok"]
    if np.isfinite(ensemble_mean).any() or not finished:
        return [finished] if finished else []
    datasets = list(dict.fromkeys(rows[i]["dataset"] for i in finished))
    return [[i for i in finished if rows[i]["dataset"] == dataset] for dataset in datasets]


def summary(
    rows: Sequence[dict[str, Any]], test: Record, ensemble_mean: np.ndarray, n_inits: Sequence[int]
) -> dict[str, Any]:
    """Figures over the finished members; a member's figure is the mean over its outputs."""
    finished = [i for i, row in enumerate(rows) if row["status"] == "ok"]
    counts = {"planned": len(rows), "finished": len(finished), "failed": len(rows) - len(finished)}
    own, shared = [rows[i] for i in finished], take(test, finished[0] if finished else 0)
    by_n_init = {str(n): _over_members(own, shared, ensemble_mean, n) for n in n_inits}
    return {**counts, **by_n_init[str(n_inits[0])], "by_n_init": by_n_init}


def _over_members(
    finished: Sequence[dict[str, Any]], test: Record, ensemble_mean: np.ndarray, n_init: int
) -> dict[str, float]:
    names = [f"{name}_mean" for name in _FIGURES] + [f"rmse_{what}" for what in ("std", "median", "best", "ensemble")]
    figures = dict.fromkeys(names, float("nan"))
    if not finished:
        return figures
    of_members = [row["by_n_init"][str(n_init)] for row in finished]
    values = {name: np.array([np.mean(row[name]) for row in of_members]) for name in _FIGURES}
    figures |= {f"{name}_mean": float(np.mean(each)) for name, each in values.items()}
    rmses = values["rmse"]
    spread = float(np.std(rmses, ddof=1)) if len(rmses) > 1 else 0.0
    figures |= {"rmse_std": spread, "rmse_median": float(np.median(rmses)), "rmse_best": float(rmses.min())}
    if np.isfinite(ensemble_mean).all():
        together = rmse(measured=test.y, predicted=ensemble_mean, mask=test.mask, n_init=n_init)
        figures["rmse_ensemble"] = float(np.mean(together))
    return figures
