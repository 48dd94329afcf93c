"""The tables of a discovery, which its page and the terminal share, and all of it as a summary for the terminal."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.text import Text

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports import discovery_facts as facts
from pgrssnn_jax.reports.content import MISSING, Number, number, percent
from pgrssnn_jax.reports.discovery_facts import Discovery, chance, real
from pgrssnn_jax.reports.tables import Row, Table

SHOWN_ROWS = 15


def finding_table(effect: Mapping[str, Any]) -> Table:
    """A missing effect: its equation and numbers, where and when it acts, how sure it is; without what is not known."""
    runner, p, active = effect.get("runner_up") or {}, effect.get("p_value"), effect.get("active_fraction")
    joints = ", ".join(map(str, effect.get("joints") or ()))
    gains = {"test": effect.get("gain_test"), "training data": effect.get("gain_train")}
    known: dict[str, str | None] = {
        "equation": effect.get("equation"),
        **{quantity.name: quantity.words for quantity in facts.quantities(effect)},
        "cause": effect.get("cause"),
        "acts on": ", joint ".join(filter(None, (str(effect.get("acts_on") or ""), joints))),
        "where": effect.get("region"),
        "active": None if active is None else f"in {percent(active)} of the samples",
        "when": facts.intervals(effect),
        "gap closed": ", ".join(f"{percent(share)} on {data}" for data, share in gains.items() if share is not None),
        "by chance": None if p is None else f"p = {chance(p)}",
        "runner-up": f"{runner.get('name')}, would close {percent(runner.get('gain'))}" if runner else None,
        "command": effect.get("command"),
    }
    rows = [[name, found] for name, found in known.items() if found]
    title = f"{effect.get('title') or effect['name']} · {effect['name']}"
    return _table(title, ("effect", "found"), rows, left=2)._replace(most=None)


def open_tables(discovery: Discovery) -> list[Table]:
    """What could not be told; none where there is nothing of the kind."""
    others = [
        [facts.called(row), _numbers(row), percent(row.get("gain")), str(row.get("experiment") or MISSING)]
        for row in discovery.get("alternatives") or ()
    ]
    silent = [[str(row["name"]), str(row.get("reason") or MISSING)] for row in discovery.get("untestable") or ()]
    header = ("effect", "numbers", "error energy taken away", "experiment that would tell")
    tables = [
        _table("Alternatives that these data cannot tell apart", header, others, left=4),
        _table("Effects that these data cannot test", ("effect", "why"), silent, left=2),
    ]
    return [table for table in tables if table.rows]


def _numbers(row: Mapping[str, Any]) -> str:
    """Of an alternative; files of earlier versions have none."""
    return ", ".join(f"{quantity.name} = {quantity.words}" for quantity in facts.quantities(row)) or MISSING


def discovery_summary(discovery: Discovery) -> Group:
    """The verdict in large, a table per finding, the gap, the largest shifts of parameters, the seconds."""
    colour = "green" if discovery["verdict"] in ("no_discrepancy", "miscalibrated", "effect_found") else "yellow"
    verdict = Text(f"{facts.heading(discovery).upper()}\n", f"bold {colour}").append(
        str(discovery.get("sentence") or ""), "not bold"
    )
    parts: list[RenderableType] = [Panel(verdict, box=box.HEAVY, border_style=colour, padding=(1, 2))]
    if facts.stand_ins(discovery):
        parts.append(Text(facts.STAND_INS))
    parts += [*map(finding_table, discovery.get("effects") or ()), *open_tables(discovery)]
    if discovery.get("formula"):
        parts.append(Text(f"best description of what is missing: {discovery['formula']}"))
    metrics = facts.as_metrics(discovery)
    source = Text(content.source(metrics), "bold red" if content.simulated(metrics) else "")
    found = joint_table(discovery), free_run_table(discovery), shift_table(discovery)
    numbers = [table for table in found if table.rows]
    parts += [gap_table(discovery), *numbers, source]
    spent = ", ".join(f"{name} {content.duration(s)}" for name, s in (discovery.get("seconds") or {}).items())
    return Group(*parts, *([Text(f"time: {spent}")] if spent else []))


def gap_table(discovery: Discovery) -> Table:
    """The error of every stage of the physics, with its interval on test data."""
    metric, unit = facts.gap_metric(discovery)
    closed = (discovery.get("gap") or {}).get("closed_fraction")
    rows: list[list[str]] = []
    for row in facts.gap_rows(discovery):
        span = f"{number(row.low)} .. {number(row.high)}" if row.interval else MISSING
        rows.append([f"{row.stage}: {row.words}", number(row.train), number(row.test), span])
    table = _table(f"The gap: {metric}{content.in_unit(unit)}", ("physics", "train", "test", "test interval"), rows)
    return table._replace(footer=[f"{percent(closed)} of the gap closed"] if closed is not None else [])


def joint_table(discovery: Discovery) -> Table:
    """Torque error of every joint over the standard deviation of its torque; empty for what is no arm."""
    rows = [
        [str(row["joint"]), number(row.get("std")), *(_change(row.get(r) or {}) for r in ("all", "moving", "at_rest"))]
        for row in discovery.get("joints") or ()
    ]
    header = ("joint", "std (Nm)", "all", "moving", "at rest")
    return _table("Torque errors by joint, nominal → with the missing effects", header, rows)


def free_run_table(discovery: Discovery) -> Table:
    """Errors of an arm that moves by the measured torques alone; empty for what is not judged by its torques."""
    rows = [
        [content.duration(row["horizon_s"]) if row["horizon_s"] else "whole sequences",
         *(number(row.get(stage)) for stage in ("before", "recalibrated", "after"))]
        for row in discovery.get("free_run") or ()
    ]  # fmt: skip
    header = ("simulated for", *(words for words in facts.STAGES.values()))
    return _table("Free run of the test record by its torques: position NRMSE, mean over joints", header, rows)


def shift_table(discovery: Discovery) -> Table:
    """The numbers of the physics, the largest relative shift first."""
    rows: list[list[str]] = []
    for row in facts.shifts(discovery):
        fits = number(row.recalibrated, std=row.recalibrated_std), number(row.final, std=row.final_std)
        rows.append([row.name, number(row.before), *fits, row.unit or MISSING, percent(row.size)])
    header = ("number", "before", "refitted ± std", "final ± std", "unit", "shift")
    table = _table("The numbers of the physics, largest shift first", header, rows)
    return table._replace(footer=facts.remarks(discovery))


def number_tables(discovery: Discovery) -> list[Table]:
    """Everything that was measured on the way; none that would be empty."""
    tried: list[Row] = []
    for row in discovery.get("ranking") or ():
        name = str(row["name"]) + ("" if row.get("cross_validated", True) else " (fitted only)")
        cells = [name, percent(row.get("gain")), chance(row.get("p_value")), "yes" if row.get("chosen") else "no"]
        tried.append(("headline" if row.get("chosen") else "", cells))
    network = discovery.get("network") or {}
    of = str(network.get("metric") or "RMSE")
    supplied: list[list[str]] = [
        [words, percent(network.get(f"share_{stage}")), number(network.get(f"{of.lower()}_{stage}"))]
        for stage, words in facts.STAGES.items()
        if f"share_{stage}" in network
    ]
    where: list[list[str]] = []
    for row in sorted(discovery.get("disagreement") or (), key=lambda row: -(row.get("share_of_error") or 0.0)):
        shares = percent(row.get("share_of_error")), percent(row.get("share_of_samples"))
        place = str(row.get("rule") or _region(row.get("region") or {}))
        where.append([str(row["equation"]), *shares, place, facts.intervals(row) or MISSING])
    where_header = ("equation", "share of the error", "share of the samples", "where", "when")
    tried_title = "Candidate effects, error energy taken away in cross-validation"
    network_header = ("physics", "share of the prediction", f"test {of}{content.in_unit(network.get('unit'))}")
    tables = [
        gap_table(discovery),
        joint_table(discovery),
        free_run_table(discovery),
        _table("Where physics and measurement disagree", where_header, where)._replace(
            left=("equation", "where", "when")
        ),
        _table(tried_title, ("effect", "error energy", "p", "chosen"), [])._replace(rows=tried),
        shift_table(discovery),
        _table("What the network of the PG-RSSNN has to supply", network_header, supplied),
    ]
    return [table for table in tables if table.rows]


def _change(errors: Mapping[str, Any]) -> str:
    return " → ".join(number(errors.get(stage)) for stage in ("before", "after"))


def _table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> Table:
    return Table(header, [("", row) for row in rows], title, left=header[:left], wrap=True, most=SHOWN_ROWS)


def _region(region: Mapping[str, Sequence[Number | None]]) -> str:
    """Bounds in words; an open one is left out."""
    bounds = ((name, *map(real, span)) for name, span in region.items())
    texts = [
        (f"{low:g} ≤ " if math.isfinite(low) else "") + name + (f" ≤ {high:g}" if math.isfinite(high) else "")
        for name, low, high in bounds
    ]
    return ", ".join(texts) or MISSING
