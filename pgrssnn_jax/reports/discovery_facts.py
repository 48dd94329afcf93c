"""What `discovery.json` says: its verdict in words, its figures as rows. A missing figure is NaN, shown as a dash."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgrssnn_jax.physics.signals import unit_at
from pgrssnn_jax.reports.content import MISSING, Metrics, Number, number

Discovery = Mapping[str, Any]

VERDICTS = {
    "no_discrepancy": "The physics explains the data as it is",
    "miscalibrated": "The equations are right, their numbers were not",
    "effect_found": "A missing effect was found",
    "ambiguous": "An effect is missing, and the data allow several",
    "unknown_effect": "Something is missing that no known effect explains",
    "unexplained": "Errors stand above the noise, and nothing accounts for them",
    "not_confirmed": "What was found is not confirmed by the test record",
}
"""The heading for each verdict."""

STAND_INS = (
    "The named effects below act beside what has no name, or stand in for a part of it: "
    "their numbers may be bent by it."
)

STAGES = {"before": "nominal physics", "recalibrated": "numbers refitted", "after": "with the missing effects"}
SHOWN_INTERVALS = 5


_MOST = 0.5  # of the gap


class GapRow(NamedTuple):
    """The error of one stage of the physics; low and high: interval of the test figure."""

    stage: str
    words: str
    train: float
    test: float
    low: float
    high: float

    @property
    def interval(self) -> bool:
        """Is there one?"""
        return math.isfinite(self.low + self.high)


class Shift(NamedTuple):
    """One number of the physics: nominal, refitted on its own, and at the end, with the missing effects."""

    name: str
    unit: str
    before: float
    recalibrated: float
    recalibrated_std: float
    final: float
    final_std: float

    def relative(self, value: float) -> float:
        """How far `value` is from where the number began, as a share of it; NaN where it began at zero."""
        return (value - self.before) / abs(self.before) if self.before else math.nan

    @property
    def size(self) -> float:
        moved = [abs(self.relative(v)) for v in (self.recalibrated, self.final)]
        return max((m for m in moved if math.isfinite(m)), default=math.nan)


class Quantity(NamedTuple):
    """One number of an effect, of one channel or joint where it has several; at_bound: a fit was not let go further, so
    that its deviation says nothing."""

    name: str
    value: float
    std: float
    unit: str
    at_bound: bool = False

    @property
    def words(self) -> str:
        """Value with deviation and unit."""
        if self.at_bound:
            return f"{number(self.value, self.unit)}, at its bound"
        return number(self.value, self.unit, std=self.std)


def real(value: Any) -> float:
    return math.nan if value is None else float(value)


def chance(p: Number | None) -> str:
    return MISSING if p is None else f"{p:.2g}"


def by_torques(discovery: Discovery) -> bool:
    """Was the evidence the torques of a measured motion, not a simulation?"""
    return (discovery.get("evidence") or {}).get("kind") == "inverse_dynamics"


def heading(discovery: Discovery) -> str:
    verdict, count = str(discovery["verdict"]), len(discovery.get("effects") or ())
    left = real((discovery.get("gap") or {}).get("open_fraction"))
    if verdict == "effect_found" and left > _MOST:
        return "A part of what is missing was found"
    if verdict == "effect_found" and count > 1:
        return f"{count} missing effects were found"
    return VERDICTS.get(verdict, verdict)


def stand_ins(discovery: Discovery) -> bool:
    """Are there named effects that help, beside something that they do not explain?"""
    return discovery["verdict"] in ("unknown_effect", "unexplained") and bool(discovery.get("effects"))


def as_metrics(discovery: Discovery) -> Metrics:
    """The facts that the headers of the existing figures and pages are made of."""
    everyone = {"planned": 1, "finished": 1, "failed": 0}
    same = {name: discovery["data"].get(name) for name in ("source", "origin", "dt")}
    facts = {"system": discovery["system"], "model": heading(discovery), "outputs": discovery.get("outputs") or []}
    return {**facts, **same, "summary": everyone}


def gap_rows(discovery: Discovery) -> list[GapRow]:
    """Before, recalibrated, after; and the floor of the measurement noise where it is known."""
    gap = discovery.get("gap") or {}
    rows = []
    for stage, words in STAGES.items():
        error, interval = gap.get(stage) or {}, (gap.get("test_interval") or {}).get(stage) or (None, None)
        rows.append(GapRow(stage, words, real(error.get("train")), real(error.get("test")), *map(real, interval)))
    if gap.get("floor") is not None:
        rows.append(GapRow("floor", "noise of the measurement", math.nan, real(gap["floor"]), math.nan, math.nan))
    return rows


def gap_metric(discovery: Discovery) -> tuple[str, str]:
    """Name and unit of the error."""
    gap = discovery.get("gap") or {}
    return str(gap.get("metric") or "RMSE"), str(gap.get("unit") or "")


def gap_line(discovery: Discovery) -> str:
    """The errors on the test record in one line."""
    metric, unit = gap_metric(discovery)
    return f"test {metric}: " + ", ".join(f"{row.stage} {number(row.test, unit)}" for row in gap_rows(discovery))


def shifts(discovery: Discovery) -> list[Shift]:
    """Every number of the physics, largest relative shift first; at the end those that have none."""
    refitted, final = discovery.get("recalibration") or {}, discovery.get("parameters") or {}
    rows = []
    for name in dict.fromkeys([*refitted, *final]):
        old, new = refitted.get(name) or {}, final.get(name) or {}
        found = (old.get("before"), old.get("after"), old.get("std"), new.get("value"), new.get("std"))
        columns = [list(v) if isinstance(v, Sequence) else [v] for v in found]
        several = max(map(len, columns))
        for k in range(several):
            values = (real(column[k] if k < len(column) else None) for column in columns)
            label = f"{name}[{k + 1}]" if several > 1 else str(name)
            rows.append(Shift(label, str(new.get("unit") or old.get("unit") or ""), *values))
    return sorted(rows, key=lambda row: -math.inf if math.isnan(row.size) else row.size, reverse=True)


def remarks(discovery: Discovery) -> list[str]:
    """Numbers at their bounds, outside their prior, and combinations that the data do not determine."""
    at_bound = [name for name, row in (discovery.get("parameters") or {}).items() if row.get("at_bound")]
    said = [f"At their bounds, beyond which the fit may want to go: {', '.join(at_bound)}."] if at_bound else []
    departed = [row["parameter"] for row in discovery.get("departures") or ()]
    said += [f"Outside their prior (95 %): {', '.join(departed)}."] if departed else []
    for row in discovery.get("undetermined") or ():
        together = ", ".join(f"{name} {change:+.0%}" for name, change in row["changes"].items())
        said.append(
            f"The data say less than the prior about {together}{' together' if len(row['changes']) > 1 else ''}."
        )
    return said


def called(alternative: Mapping[str, Any]) -> str:
    """Its name, with its channels where it is the effect that was found, at others."""
    name, at = str(alternative["name"]), ", ".join(alternative.get("acts_at") or ())
    return f"{name} at {at}" if at and name == alternative.get("instead_of") else name


def quantities(effect: Mapping[str, Any]) -> list[Quantity]:
    """The numbers of an effect; lists are spelled out, by joint or channel, matrices by both of theirs. Those that were
    taken out, at channels at which the effect does not act, zero without a deviation or at infinity, are left out."""
    rows = []
    for name, parameter in (effect.get("parameters") or {}).items():
        values = _array(parameter.get("value"))
        stds, at_bound = (
            np.broadcast_to(_array(parameter.get(key)), values.shape).ravel() for key in ("std", "at_bound")
        )
        symbol, unit = parameter.get("symbol") or name, parameter.get("unit") or ""
        places: list[str] = _places(effect, values.shape)
        several: Sequence[str] = effect.get("channel_names") or ()
        elsewhere = set(several) - set(effect.get("acts_at") or several)
        units = [unit_at(unit, index, values.shape) for index in np.ndindex(values.shape)]
        rows += [
            Quantity(f"{symbol}, {place}" if place else str(symbol), float(v), float(s), of, b == 1.0)
            for place, of, v, s, b in zip(places, units, values.flat, stds, at_bound, strict=True)
            if place not in elsewhere and ((v and np.isfinite(v)) or s or b == 1.0)
        ]
    return rows


def _array(listed: Any) -> np.ndarray:
    """Numbers as nested lists, what is missing as NaN."""
    return np.asarray(listed, object).astype(np.float64)


def _places(effect: Mapping[str, Any], shape: tuple[int, ...]) -> list[str]:
    joints, channels = effect.get("joints") or (), str(effect.get("channels") or "channel")
    if (len(joints),) == shape:
        return [f"joint {joint}" for joint in joints]
    if (len(names := effect.get("channel_names") or ()),) == shape:
        return [str(name) for name in names] if len(names) > 1 else [""]
    axes = channels.split(", ")
    of_axes = [*axes, *["channel"] * (len(shape) - len(axes))]
    return [", ".join(f"{of_axes[d]} {k + 1}" for d, k in enumerate(index)) for index in np.ndindex(shape)]


def intervals(row: Mapping[str, Any]) -> str:
    """Spans of time in words, the first few of many; of another sequence than the first, which one."""
    listed: Sequence[Sequence[Number]] | None = row.get("intervals_s")
    sequence = f" of sequence {row['sequence']}" if row.get("sequence", 1) > 1 and listed else ""
    spans = [f"{start:g} to {stop:g} s" for start, stop in (listed or ())]
    more = f" and {len(spans) - SHOWN_INTERVALS} more" if len(spans) > SHOWN_INTERVALS else ""
    return ", ".join(spans[:SHOWN_INTERVALS]) + more + sequence
