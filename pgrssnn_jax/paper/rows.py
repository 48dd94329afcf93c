"""The rows of the tables of many runs: one per variant and system, the published figure beside the measured one."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from pgrssnn_jax.paper.collect import FoundRun
from pgrssnn_jax.paper.merits import NOTHING, Figures, difference, figures_of
from pgrssnn_jax.paper.published import Experiment, Paper, System, Value, Variant
from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import MemberRow, Metrics

State = Literal["finished", "failed", "unfinished", "damaged", "missing", "quoted"]
Name = tuple[str, str]  # size and series
NOTABLE = 2.0  # standard errors; what is nearer may be chance


class Row(NamedTuple):
    """One variant. size: its training samples in words, where the table has several; series: the rest of its name;
    planned: None where nothing says how many members there were to be; difference: of the measured mean from the
    published one in combined standard errors, NaN where there is none; why: what is known about it."""

    size: str
    series: str
    variant: Variant
    state: State
    published: Value | None
    reason: str = ""
    planned: int | None = None
    finished: tuple[MemberRow, ...] = ()
    failed: tuple[MemberRow, ...] = ()
    figures: Figures = NOTHING
    seconds: float = math.nan
    difference: float = math.nan
    why: str = ""
    run: FoundRun | None = None

    @property
    def label(self) -> str:
        return " · ".join(filter(None, (self.size, self.series)))

    @property
    def metrics(self) -> Metrics | None:
        return self.run.metrics if self.run else None

    @property
    def simulated(self) -> bool:
        return self.metrics is not None and content.simulated(self.metrics)

    def finite(self, merit: str) -> np.ndarray:
        found = np.array([getattr(member, merit) for member in self.finished], float)
        return found[np.isfinite(found)]


class EvidenceTable(NamedTuple):
    """The rows of one experiment. common: what all runs were asked for alike; budget: what capped them, if anything."""

    name: str
    title: str
    budget: str | None
    system: str
    merit: Literal["rmse", "nrmse"]
    unit: str
    rows: tuple[Row, ...]
    common: dict[str, str]

    @property
    def slug(self) -> str:
        """The table's name in names of files and anchors."""
        return re.sub(r"[^a-z0-9]+", "-", "-".join(filter(None, (self.name, self.budget))).lower()).strip("-")

    @property
    def heading(self) -> str:
        return f"test {self.merit.upper()}{f' in {self.unit}' if self.unit else ''}"

    @property
    def measured(self) -> list[Row]:
        """The rows that some finished member stands behind."""
        return [row for row in self.rows if math.isfinite(row.figures.mean)]

    @property
    def sizes(self) -> list[int]:
        """The numbers of training samples, where the table is about them."""
        found = sorted({row.variant.n_train for row in self.rows if row.variant.n_train is not None})
        return found if len(found) > 1 else []

    @property
    def seconds(self) -> float:
        return math.fsum(row.seconds for row in self.rows if math.isfinite(row.seconds))


def evidence_tables(runs: Sequence[FoundRun], paper: Paper) -> list[EvidenceTable]:
    """One table per experiment, system and budget: those of the paper in its order, then all others."""
    order = list(paper.experiments)

    def key(run: FoundRun) -> tuple[int, str, str, str]:
        rank = order.index(run.experiment) if run.experiment in order else len(order)
        return rank, run.experiment or "", run.budget or "", run.system

    return [_table(list(group), paper) for _, group in groupby(sorted(runs, key=key), key)]


def _table(runs: list[FoundRun], paper: Paper) -> EvidenceTable:
    first = runs[0]
    known = paper.experiments.get(first.experiment or "")
    known = known if known and known.system == first.system else None
    system = paper.systems.get(first.system) or _unknown_system(runs)
    differing, common = _differing(runs)
    names = [name for name in (first.experiment, None if known else first.system) if name]
    budget = f"budget {first.budget}" if first.budget else ""
    return EvidenceTable(
        "_".join(dict.fromkeys(names)) or "runs",
        " · ".join(filter(None, (known.title if known else first.experiment or "Runs", system.title, budget))),
        first.budget,
        first.system,
        system.merit,
        system.unit,
        (*_told_apart(_rows(runs, known, system, paper), differing), *_quoted(known)),
        common,
    )


def _rows(runs: Sequence[FoundRun], known: Experiment | None, system: System, paper: Paper) -> list[Row]:
    """The variants of the paper's table, then those that were asked for besides."""
    ranks = {name: k for k, name in enumerate(paper.models)}
    asked = {run.variant: None for run in sorted(runs, key=lambda run: ranks.get(run.variant.model, len(ranks)))}
    variants = list(dict.fromkeys([*(known.variants if known else ()), *asked]))
    name_of = _namer(variants, system, paper)
    rows: list[Row] = []
    for variant in variants:
        published, mine = paper.values.get((runs[0].system, variant)), [run for run in runs if run.variant == variant]
        rows += [_measured(run, Row(*name_of(run), variant, run.state, published), system, paper) for run in mine]
        rows += [] if mine else [Row(*name_of(variant), variant, "missing", published)]
    return rows


def _quoted(known: Experiment | None) -> list[Row]:
    """Figures of others, which no run here stands behind."""
    quoted, nowhere = known.quoted if known else {}, Variant("", "", None)
    return [Row("", name, nowhere, "quoted", Value(mean, 0, 0, None)) for name, mean in quoted.items()]


def _unknown_system(runs: Iterable[FoundRun]) -> System:
    """A system that the paper has not: NRMSE where there are several outputs."""
    metrics = next((run.metrics for run in runs if run.metrics), None)
    name = next((run.system for run in runs if run.system), "data unknown")
    several = metrics is not None and len(metrics["outputs"]) > 1
    unit = content.unit(metrics) if metrics and not several else ""
    return System(name, "nrmse" if several else "rmse", unit, 0, "", None)


def _differing(runs: Sequence[FoundRun]) -> tuple[set[str], dict[str, str]]:
    """The overrides in which the runs differ, and those that all share."""
    keys = {key for run in runs for key in run.overrides}
    found = {key: {run.overrides.get(key) for run in runs} for key in keys}
    common = {key: str(*values) for key, values in sorted(found.items()) if len(values) == 1}
    return keys - common.keys(), common


def _namer(variants: Sequence[Variant], system: System, paper: Paper) -> Callable[[FoundRun | Variant], Name]:
    """Samples and physics stand in the name of a row where the table has several."""
    several_sizes = len({variant.n_train for variant in variants}) > 1
    several_physics = len({variant.physics for variant in variants}) > 1

    def name(what: Any) -> Name:
        variant: Variant = what.variant if isinstance(what, FoundRun) else what
        size = ""
        if several_sizes and variant.n_train is not None:
            size = f"n_train {variant.n_train}" if system.n_train is None else f"{variant.n_train} samples"
        physics = paper.physics.get(variant.physics, variant.physics) if several_physics else ""
        series = " · ".join(filter(None, (physics, paper.title(variant.model)))) if variant.model else what.path.name
        return size, series

    return name


def _told_apart(rows: Sequence[Row], differing: set[str]) -> list[Row]:
    """Rows with what their runs were asked for besides, and with their folder where that is not enough."""
    named = []
    for row in rows:
        overrides = row.run.overrides if row.run else {}
        own = [f"{key}={value}" for key, value in overrides.items() if key in differing]
        named.append(row._replace(series=", ".join([row.series, *own])))
    for place in (lambda run: str(Path(run.name).parent), lambda run: Path(run.name).name):
        labels = [row.label for row in named]
        named = [
            row._replace(series=f"{row.series} [{place(row.run)}]") if row.run and labels.count(row.label) > 1 else row
            for row in named
        ]
    return named


def _measured(run: FoundRun, row: Row, system: System, paper: Paper) -> Row:
    row = row._replace(reason=run.reason, planned=run.planned, run=run)
    if run.metrics is None:
        return row
    finished, failed = content.ranked(content.member_rows(run.metrics))
    figures, problem = figures_of(run, finished, system.merit)
    away = difference(figures, len(finished), row.published, paper.rounding)
    total = run.metrics["seconds"].get("total")
    return row._replace(
        reason=problem,
        finished=tuple(finished),
        failed=tuple(failed),
        figures=figures,
        seconds=math.nan if total is None else float(total),
        difference=away,
        why=paper.reasons.get((run.system, run.variant), "") if abs(away) > NOTABLE else "",
    )


def failures(row: Row) -> Iterator[tuple[str, list[MemberRow]]]:
    """Failed members by reason, the most frequent first."""
    by_reason: dict[str, list[MemberRow]] = {}
    for member in row.failed:
        by_reason.setdefault(member.reason.removeprefix("failed: ") or "no reason given", []).append(member)
    yield from sorted(by_reason.items(), key=lambda item: -len(item[1]))
