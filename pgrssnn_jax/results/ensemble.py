"""Trained members as a result that simulates, scores, plots, saves and shows itself."""

from collections.abc import Mapping
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any, NamedTuple, overload

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.figure import Figure

from pgrssnn_jax.effects.stored import physics_to_json
from pgrssnn_jax.models.model import Model, ModelParams
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.check import checked_inputs, checked_start
from pgrssnn_jax.records.arguments import check_kind, shown
from pgrssnn_jax.records.record import Array, Record, RecordInfo
from pgrssnn_jax.reports.prediction import compared, prediction_figure
from pgrssnn_jax.reports.tables import member_table
from pgrssnn_jax.reports.write import write_report, yaml_text
from pgrssnn_jax.training import evaluation
from pgrssnn_jax.training.calibration import calibrated
from pgrssnn_jax.training.checkpoints import Checkpoint, CheckpointFolder
from pgrssnn_jax.training.diagnostics import diagnostics
from pgrssnn_jax.training.evaluation import Trained
from pgrssnn_jax.training.intervals import Intervals
from pgrssnn_jax.training.loop import Losses, losses_table
from pgrssnn_jax.training.members import select
from pgrssnn_jax.training.plan import Plan, member_tests
from pgrssnn_jax.training.run_folder import RunFolder
from pgrssnn_jax.training.run_lock import locked
from pgrssnn_jax.training.settings import TrainingSettings, settings_to_config


class Evaluated(NamedTuple):
    """What `metrics.json` and `predictions.npz` hold."""

    metrics: dict[str, Any]
    arrays: dict[str, np.ndarray]


class Simulated(NamedTuple):
    """A free run with its interval: y `[member, *seq, time, y]`; mean over members, and the ends of the interval around
    it, `[*seq, time, y]`."""

    y: Float[np.ndarray, "member *seq time y"]
    mean: Float[np.ndarray, "*seq time y"]
    low: Float[np.ndarray, "*seq time y"]
    high: Float[np.ndarray, "*seq time y"]


class Ensemble:
    """Members (seeds × datasets) of one model after training. `trained` holds their parameters, `losses` their history.

    Everything that it takes and gives is in measured units.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        trained: Trained,
        losses: Losses,
        info: RecordInfo,
        *,
        n_train: int,
        n_sequences: int,
        seconds: Mapping[str, float],
        plan: Plan | None = None,
        labels: Mapping[str, str | None] | None = None,
        recipe: Mapping[str, Any] | None = None,
        intervals: Intervals | None = None,
    ) -> None:
        """info: of the training record; n_train: samples per training sequence; n_sequences: of a member; plan: with
        the data of training, None after loading; labels: names of the configuration's files; recipe: how `recipe=auto`
        chose the settings; intervals: of a run that is loaded; others are calibrated when they are asked for."""
        self.settings, self.trained, self.losses, self.info = settings, trained, losses, info
        self.n_train, self.n_sequences = n_train, n_sequences
        self.seconds, self.plan, self.labels = dict(seconds), plan, labels or {}
        self.recipe = recipe
        self._intervals = intervals
        self._evaluated: Evaluated | None = None

    @property
    def physics(self) -> Physics:
        return self.trained.objective.model.physics

    @property
    def model(self) -> Model:
        return self.trained.objective.model

    def params(self, member: int) -> ModelParams:
        """The numbers of one member, for `pg.rollout`. Raises `ValueError` for a member that does not exist."""
        count = len(self.trained.members)
        if type(member) is not int or not 0 <= member < count:
            raise ValueError(f"params: member: expected 0 to {count - 1}, found {shown(member)}")
        best, scaling = select((self.trained.state.best, self.trained.scaling), member)
        return self.trained.objective.assemble(best, scaling)

    @overload
    def simulate(self, u: Array, x0: Array | None = None) -> Float[np.ndarray, "member *seq time y"]: ...

    @overload
    def simulate(self, u: Array, x0: Array | None = None, *, interval: float) -> Simulated: ...

    def simulate(
        self, u: Array, x0: Array | None = None, *, interval: float | None = None
    ) -> Float[np.ndarray, "member *seq time y"] | Simulated:
        """Free run of every member from inputs u `[time, input]` or `[sequence, time, input]`; NaN for a failed one.

        x0 `[state]`, `[sequence, state]` or `[member, sequence, state]` (`initial_state`) in the physics' units; None:
        as in training, where that is a known state.
        interval: 0.9 for the interval that holds nine in ten measurements (`training/intervals.py`), which changes the
        result to a `Simulated`. Raises `ValueError` for other shapes, for inputs that are not finite, where training
        knew no start, and where no interval was calibrated.
        """
        u = checked_inputs(u, len(self.physics.inputs))
        if not np.isfinite(u).all():
            raise ValueError("simulate: u: expected finite numbers, found NaN or infinity")
        sequences = u if u.ndim == 3 else u[None]
        start = self._known_start()[:, None] if x0 is None else self._given_start(x0, len(sequences))
        start = np.broadcast_to(start, (len(self.trained.members), len(sequences), self.model.n_x))
        y = evaluation.predict_from(self.trained, sequences, start).y.copy()
        y[~self._usable] = np.nan
        if interval is None:
            return y if u.ndim == 3 else y[:, 0]
        if self.intervals is None:
            raise ValueError("simulate: interval: expected a run that left samples out, found one without any")
        members = y[self._usable].astype(np.float64)
        mean, spread = members.mean(0), members.std(0)
        half = self.intervals.half_width(mean, spread, sequences, interval)
        found = Simulated(y, mean, mean - half, mean + half)
        return found if u.ndim == 3 else Simulated(y[:, 0], *(a[0] for a in found[1:]))

    def initial_state(self, record: Record) -> Float[np.ndarray, "member seq x"]:
        """x_0 of every member for a record, found as in a test: known, or estimated from its first samples."""
        tests = member_tests(self.trained.objective, self.trained.members, self.trained.units, (0,), record)
        return evaluation.predict(self.trained, tests.record).x0

    def _given_start(self, x0: Array, sequences: int) -> Float[np.ndarray, "*member_and_seq x"]:
        found = checked_start(x0, self.model.n_x, sequences, len(self.trained.members))
        if not np.isfinite(found).all():
            raise ValueError("simulate: x0: expected finite numbers, found NaN or infinity")
        return found

    @property
    def _usable(self) -> np.ndarray:
        """Which members have not failed."""
        return np.array([not evaluation.has_failed(int(outcome)) for outcome in self.trained.state.outcome], bool)

    @property
    def intervals(self) -> Intervals | None:
        """Calibration of the prediction intervals, on the samples that members left out; None where none were left out,
        and for runs of versions without intervals."""
        plan = self.plan
        if self._intervals is None and plan is not None:
            predicted = self._validated
            if predicted is None or plan.fit.objective.starts_as_tested(plan.data.validation):
                predicted = evaluation.outputs_as_tested(self.trained, plan.data)
            self._intervals = calibrated(plan, predicted, self._usable, self.losses, self.recipe)
        return self._intervals

    @cached_property
    def _validated(self) -> Float[np.ndarray, "member seq time y"] | None:
        """What the members predict of their validation records; None after loading."""
        return None if self.plan is None else evaluation.validated_outputs(self.trained, self.plan.data)

    def _known_start(self) -> Float[np.ndarray, "member x"]:
        initial, count = self.trained.objective.initial, len(self.trained.members)
        if initial.kind == "zero":
            return np.zeros((count, self.model.n_x))
        if initial.kind == "scaled_zero":
            return np.broadcast_to(np.asarray(self.trained.scaling.x.offset), (count, self.model.n_x))
        if initial.shared and np.isfinite(self.trained.start).all():
            return self.trained.start
        raise ValueError(
            f"simulate: x0: expected an initial state of {self.model.n_x} numbers, because training found one for each "
            f"record (initial_state={initial.kind}), found none; initial_state(record) finds that of a record"
        )

    def evaluate(self, test: Record) -> Evaluated:
        """The figures of `metrics.json` and the arrays of `predictions.npz` on a test record."""
        trained, wanted = self.trained, self.settings.run.report_n_init
        tests = member_tests(trained.objective, trained.members, trained.units, wanted, test)
        plan = self.plan
        predictions = evaluation.predict(trained, tests.record)
        rows = evaluation.member_rows(trained, tests, predictions, plan and plan.validation, self._validated)
        mean, deviation = evaluation.ensemble(rows, tests.measured, predictions)
        info, measured = test.info, tests.measured
        together = evaluation.groups(rows, mean)
        more, arrays = diagnostics(self.intervals, together, rows, tests, predictions)
        metrics = {
            "schema": 1,
            "system": self.physics.name,
            "physics": self.labels.get("physics") or self.physics.name,
            "experiment": self.labels.get("experiment"),
            "budget": self.labels.get("budget"),
            "model": self.settings.name,
            "data": self.labels.get("data") or info.benchmark or "record",
            "source": info.source,
            "origin": info.origin,
            "n_init": tests.n_inits[0],
            "recipe": self.recipe,
            "n_train": self.n_train,
            "n_sequences": self.n_sequences,
            "dt": self.physics.dt,
            "outputs": [channel._asdict() for channel in measured.info.outputs],
            "signals": {kind: [[s.name, s.unit] for s in getattr(self.physics, kind)] for kind in ("inputs", "states")},
            "members": rows,
            "summary": evaluation.summary(rows, measured, mean, tests.n_inits),
            **more,
            "seconds": {**self.seconds, "total": sum(self.seconds.values())},
        }
        arrays |= {
            "y": np.asarray(measured.y[0]),
            "u": np.asarray(measured.u[0]),
            "mask": np.asarray(measured.mask[0]),
            "y_hat": predictions.y.astype(np.float32),
            "ensemble_mean": mean,
            "ensemble_std": deviation,
            "seed": np.array([member.seed for member in trained.members]),
            "dataset": np.array([member.dataset for member in trained.members]),
            "x0": predictions.x0,
            "x0_train": trained.start,
        }
        if self.physics.skeleton is not None:
            seen = np.where(measured.mask[0], measured.y[0], np.nan)
            for name, y in (("measured", seen), ("predicted", compared(arrays, metrics).mean)):
                arrays[f"skeleton_{name}"] = self.physics.skeleton(y).astype(np.float32)
        self._evaluated = Evaluated(metrics, arrays)
        return self._evaluated

    def score(self, test: Record) -> pd.DataFrame:
        """A row per member: seed, dataset, status, best epoch, and RMSE, NRMSE, fit (%) and correlation on the test
        record, per output where there are several, and their mean over outputs."""
        metrics = self.evaluate(test).metrics
        names = [output["name"] for output in metrics["outputs"]]
        rows = []
        for member in metrics["members"]:
            row = {key: member[key] for key in ("seed", "dataset", "status", "reason", "best_epoch")}
            for figure in ("rmse", "nrmse", "fit_percent", "cc"):
                values = member["test"][figure] if member["test"] else [np.nan] * len(names)
                row[figure] = float(np.mean(values))
                if len(names) > 1:
                    row |= {f"{figure}_{name}": value for name, value in zip(names, values, strict=True)}
            rows.append(row)
        return pd.DataFrame(rows)

    def plot(self, test: Record) -> Figure:
        """Measured and predicted outputs of the test record, with the residual below."""
        found = self.evaluate(test)
        return prediction_figure(found.arrays, found.metrics)

    def save(self, folder: str | Path, test: Record | None = None) -> None:
        """Writes a run folder (`docs/runs.md`): parameters, physics, settings, history and a page; with figures on the
        test record that is given or was scored last. `pg.load` reads it. Raises `ValueError` where it cannot write."""
        check_kind("save: folder", folder, str | Path, "the name of a folder")
        found = self._evaluated if test is None else self.evaluate(test)
        run, data, physics = RunFolder(Path(folder)), {"train": f"{self.info.source}: {self.info.origin}"}, self.physics
        with locked(run.path):
            run.begin(self._config_text(), command="pg.fit", data=data, physics=physics_to_json(physics))
            checkpoints = CheckpointFolder(run.checkpoint)
            checkpoints.save(Checkpoint(self.trained.state, self.trained.scaling, self.trained.units, self.losses))
            checkpoints.close()
            self.finish(run, found)

    def _config_text(self) -> str:
        """The configuration of a run of the API, in the form that the commands write."""
        config: dict[str, Any] = settings_to_config(self.settings)
        shared = {"name": self.info.benchmark or "record", "shared_initial_state": self.info.start == "shared"}
        physics = {**physics_to_json(self.physics)["physics"], "effects": None}
        return yaml_text(
            {"physics": physics, **config, "data": {**shared, **config["data"]}, "resume": None, "recipe": self.recipe}
        )

    def finish(self, run: RunFolder, found: Evaluated | None) -> None:
        """History, predictions, figures of merit and page; without a test record only the history. DONE comes last."""
        run.write_csv("history.csv", losses_table(self.losses, self.trained.members))
        run.write_arrays("predictions.npz", {"x0_train": self.trained.start} if found is None else found.arrays)
        if self.intervals is not None:
            run.write_arrays("intervals.npz", self.intervals._asdict())
        if found is not None:
            run.write_json("metrics.json", found.metrics)
            write_report(run)
        run.finish()

    def __repr__(self) -> str:
        failed = int(np.sum(~self._usable))
        count, what = len(self.trained.members), f"{self.settings.name} on {self.physics.name}"
        return f"{what}: {count} members, {count - failed} finished, {failed} failed"

    def _repr_html_(self) -> str:
        return f"<b>{escape(repr(self))}</b>" + (
            member_table(self._evaluated.metrics).html() if self._evaluated else ""
        )
