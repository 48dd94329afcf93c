"""The page of many runs: every table with its notes and figures, and every run with how it ended."""

import math
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path

from pgrssnn_jax.paper.collect import FoundRun
from pgrssnn_jax.paper.order import order_held
from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable
from pgrssnn_jax.paper.tables import notes, problems, table_of
from pgrssnn_jax.reports.content import MISSING, duration
from pgrssnn_jax.reports.markup import Markup, banner, bullets, card, document, folded, numbered_figure, tag
from pgrssnn_jax.reports.tabular import Row, Table

TITLE = "Measured and published"

Pictures = Mapping[str, Sequence[tuple[str, str, Path]]]
"""By the slug of a table: title, caption and PNG file of its figures."""


def evidence_page(
    tables: Sequence[EvidenceTable], runs: Sequence[FoundRun], paper: Paper, pictures: Pictures, command: str
) -> str:
    """The HTML of the page; raises `ValueError` where a picture is no PNG file."""
    sections, numbers = [], count(1)
    for table in tables:
        sections += _section(table, paper)
        for title, caption, path in pictures.get(table.slug, ()):
            sections.append(numbered_figure(next(numbers), path, title, caption))
    said = [(run.name, run.environment.get("command")) for run in runs]
    commands = "\n".join(f"# {name}\n{words}" for name, words in said if words)
    facts = f"published figures: {paper.source}", "all errors are those of free runs over the test record"
    return document(
        kind="Report of many runs",
        title=TITLE,
        heading=TITLE,
        facts=["; ".join(facts)],
        banners=_banners(tables),
        cards=_cards(tables, runs, paper),
        links={table.slug: table.title for table in tables} | {"runs": "Runs", "reproduce": "Reproduce"},
        sections=[
            *sections,
            tag("h2", "Runs", id="runs"),
            Table(("folder", "state", "members", "time", "commit", "reason"), [_run(run) for run in runs]).html(),
            tag("h2", "Reproduce", id="reproduce"),
            tag("pre", command),
            folded("Commands of the runs", commands),
        ],
        footer="Made by pgrssnn_jax from metrics.json and predictions.npz of the run folders named above.",
        look="evidence",
    )


def _banners(tables: Sequence[EvidenceTable]) -> list[Markup]:
    metrics = [row.run.metrics for table in tables for row in table.rows if row.run and row.run.metrics]
    simulated = sum(found["source"] == "simulated" for found in metrics)
    capped = ", ".join(table.title for table in tables if table.budget)
    text = f"In {simulated} of {len(metrics)} runs nothing was measured."
    banners = [banner("SIMULATED DATA", text)] if simulated else []
    return [*banners, *([banner("CAPPED RUNS", f"{capped}: no match for the published figures.")] if capped else [])]


def _cards(tables: Sequence[EvidenceTable], runs: Sequence[FoundRun], paper: Paper) -> list[Markup]:
    rows = [row for table in tables for row in table.rows]
    finished, planned = sum(len(row.finished) for row in rows), sum(row.planned or 0 for row in rows)
    orders = [order_held(table, paper) for table in tables]
    judged = f"{sum(held for held, _ in orders)} / {sum(pairs for _, pairs in orders)}"
    ended, absent = sum(run.state == "finished" for run in runs), sum(row.state == "missing" for row in rows)
    spent = math.fsum(table.seconds for table in tables)
    failed = f"{sum(len(row.failed) for row in rows)} failed"
    return [
        card("runs finished", f"{ended} / {len(runs)}", f"{absent} variants without any run"),
        card("members finished", f"{finished} / {planned}", failed),
        card("order of the paper", judged, "pairs that it tells apart hold here"),
        card("time", duration(spent), "of all finished runs together"),
    ]


def _section(table: EvidenceTable, paper: Paper) -> list[Markup]:
    found, wrong = table_of(table), problems(table)
    return [
        tag("h2", found.title, id=table.slug),
        found._replace(title="").html(),
        *([tag("div", bullets(wrong), look="banner", role="note")] if wrong else []),
        bullets(notes(table, paper), look="notes"),
    ]


def _run(run: FoundRun) -> Row:
    planned = MISSING if run.planned is None else str(run.planned)
    members, time = run.metrics["members"] if run.metrics else (), run.metrics["seconds"] if run.metrics else {}
    done = sum(member["status"] == "ok" for member in members)
    cells = [f"{done} / {planned}", duration(time.get("total")), str(run.environment.get("commit") or MISSING)]
    return "" if run.state == "finished" else "failed", [run.name, run.state, *cells, run.reason]
