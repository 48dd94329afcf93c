"""What `metrics.json` says, in words and rounded numbers: one reading for the tables, the figures and the page.

A figure that is missing (None, NaN, infinite) is shown as a dash, never as a number. Where a system has several
outputs, one figure of merit of one member is the mean over outputs.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pgrssnn_jax.records.units import with_unit

Metrics = Mapping[str, Any]
Number = float | int
MISSING = "–"
MERITS = ("rmse", "nrmse", "fit_percent", "cc")


class SummaryRow(NamedTuple):
    """All members together, without the first `n_init` samples; `headline`: the n_init of the run itself."""

    n_init: int
    headline: bool
    mean: float
    std: float
    median: float
    best: float
    ensemble: float
    nrmse: float


class MemberRow(NamedTuple):
    """One member on the test record; figures are NaN where it failed."""

    seed: int
    dataset: int
    failed: bool
    reason: str
    best_epoch: int | None
    rmse: float
    nrmse: float
    fit_percent: float
    cc: float


def number(value: Number | None, unit: str = "", *, std: Number | None = None) -> str:
    """Four significant digits, ± the deviation where there is one, and the unit; a dash for what is not a number.

    The deviation has as many decimals as the value, or two digits where it is smaller than these show.
    """
    if value is None or not math.isfinite(value):
        return MISSING
    digits = f"{value:#.4g}".removesuffix(".")
    if std is not None and math.isfinite(std):
        decimals = len(digits.partition(".")[2])
        plain = "e" not in digits and 10.0 ** (1 - decimals) <= std < 1e6
        digits += f" ± {std:.{decimals}f}" if plain else f" ± {std:.2g}"
    return f"{digits} {unit}".rstrip()


def percent(share: Number | None) -> str:
    """A share as a percentage with one decimal where that is not zero; large ones without."""
    if share is None or not math.isfinite(share):
        return MISSING
    digits = 0 if abs(share) >= 0.9995 else 1
    return f"{round(100 * share, digits) + 0.0:.{digits}f}".removesuffix(".0") + " %"  # + 0.0: no -0


def duration(seconds: Number | None) -> str:
    """Seconds with three significant digits, whole ones from 1000 on."""
    if seconds is None or not math.isfinite(seconds):
        return MISSING
    return f"{seconds:.0f} s" if seconds >= 999.5 else f"{seconds:.3g} s"


def phases(by_phase: Mapping[str, Number | None]) -> str:
    """The time of each phase, in words."""
    return ", ".join(f"{name} {duration(value)}" for name, value in by_phase.items() if name != "total")


def over_outputs(values: Sequence[Number | None] | Number | None) -> float:
    """The mean over outputs; NaN if a value is missing. A value that is one number already stays as it is."""
    listed = list(values) if isinstance(values, Sequence) else [values]
    numbers = [math.nan if v is None else float(v) for v in listed]
    return sum(numbers) / len(numbers) if numbers else math.nan


def unit(metrics: Metrics) -> str:
    """The unit that all outputs share; empty where they differ."""
    units = {output.get("unit", "") for output in metrics["outputs"]}
    return units.pop() if len(units) == 1 else ""


def in_unit(unit: Any) -> str:
    return f" in {unit}" if unit else ""


def outputs(metrics: Metrics) -> str:
    return "outputs: " + ", ".join(with_unit(o["name"], o.get("unit")) for o in metrics["outputs"])


def heading(metrics: Metrics) -> str:
    return f"{metrics['system']} · {metrics['model']}"


def simulated(metrics: Metrics) -> bool:
    return metrics["source"] == "simulated"


def source(metrics: Metrics) -> str:
    """Where the data came from, in words."""
    kind = "SIMULATED DATA" if simulated(metrics) else metrics["source"]
    return "source: " + ", ".join(filter(None, (kind, metrics.get("origin"))))


def counts(metrics: Metrics) -> str:
    """Planned, finished and failed members, always all three; and those that never came to an end, if any."""
    summary = metrics["summary"]
    planned, finished, failed = summary["planned"], summary["finished"], summary["failed"]
    lost = planned - finished - failed
    return f"{planned} planned, {finished} finished, {failed} failed" + (f", {lost} without a result" if lost else "")


def incomplete(metrics: Metrics) -> str:
    """One loud phrase if not every planned member finished, else empty."""
    planned, finished = metrics["summary"]["planned"], metrics["summary"]["finished"]
    how = "failed" if planned - finished == metrics["summary"]["failed"] else "did not finish"
    return "" if finished == planned else f"{planned - finished} of {planned} members {how}"


def merit(metrics: Metrics) -> str:
    """How "RMSE" is meant in this run."""
    return "RMSE" if len(metrics["outputs"]) == 1 else f"RMSE (mean of {len(metrics['outputs'])} outputs)"


def summary_rows(metrics: Metrics) -> list[SummaryRow]:
    """One row per n_init in increasing order; the run's own n_init is always among them."""
    summary, own = metrics["summary"], metrics["n_init"]
    found = {int(n): dict(figures) for n, figures in (summary.get("by_n_init") or {}).items()}
    found[own] = {k: v for k, v in summary.items() if k != "by_n_init"} | found.get(own, {})

    def row(n_init: int, figures: Mapping[str, Any]) -> SummaryRow:
        names = ("rmse_mean", "rmse_std", "rmse_median", "rmse_best", "rmse_ensemble", "nrmse_mean")
        return SummaryRow(n_init, n_init == own, *(over_outputs(figures.get(name)) for name in names))

    return [row(n_init, found[n_init]) for n_init in sorted(found)]


def headline(metrics: Metrics) -> SummaryRow:
    """The row at the n_init of the run."""
    return next(row for row in summary_rows(metrics) if row.headline)


def member_rows(metrics: Metrics) -> list[MemberRow]:
    """The members in the order of `metrics.json`."""

    def row(member: Mapping[str, Any]) -> MemberRow:
        merits = (over_outputs((member.get("test") or {}).get(name)) for name in MERITS)
        failed, reason = member["status"] != "ok", member.get("reason") or ""
        best_epoch = member.get("best_epoch")
        return MemberRow(member["seed"], member["dataset"], failed, reason, best_epoch, *merits)

    return [row(member) for member in metrics["members"]]


def ranked(rows: Sequence[MemberRow]) -> tuple[list[MemberRow], list[MemberRow]]:
    """Finished members from best to worst test RMSE (those without one last), and failed members."""
    finished = [row for row in rows if not row.failed]
    return sorted(finished, key=lambda row: (math.isnan(row.rmse), row.rmse)), [row for row in rows if row.failed]
