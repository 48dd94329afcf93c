"""The page of many runs: every table with its notes and figures, and every run with how it ended."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from pgrssnn_jax.paper.collect import FoundRun
from pgrssnn_jax.paper.order import order_held
from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable
from pgrssnn_jax.paper.tables import notes, problems, table_of
from pgrssnn_jax.reports.content import MISSING, duration
from pgrssnn_jax.reports.rendering import rendered
from pgrssnn_jax.reports.tables import Row, Table

Pictures = Mapping[str, Sequence[tuple[str, str, Path]]]
"""By the slug of a table: title, caption and PNG file of its figures."""


def evidence_page(
    tables: Sequence[EvidenceTable], runs: Sequence[FoundRun], paper: Paper, pictures: Pictures, command: str
) -> str:
    """The HTML of the page; raises `ValueError` where a picture is no PNG file."""
    rows = [row for table in tables for row in table.rows]
    orders = [order_held(table, paper) for table in tables]
    commands = [(run.name, run.environment.get("command")) for run in runs]
    header = ("folder", "state", "members", "time", "commit", "reason")
    return rendered(
        "runs.html.j2",
        source=paper.source,
        simulated=sum(row.simulated for row in rows),
        measured=sum(row.metrics is not None for row in rows),
        capped=[table.title for table in tables if table.budget],
        counts={
            "ended": f"{sum(run.state == 'finished' for run in runs)} / {len(runs)}",
            "absent": sum(row.state == "missing" for row in rows),
            "finished": f"{sum(len(row.finished) for row in rows)} / {sum(row.planned or 0 for row in rows)}",
            "failed": sum(len(row.failed) for row in rows),
            "judged": f"{sum(held for held, _ in orders)} / {sum(pairs for _, pairs in orders)}",
            "seconds": math.fsum(table.seconds for table in tables),
        },
        sections=[
            {
                "slug": table.slug,
                "name": table.title,
                "title": (found := table_of(table)).title,
                "table": found._replace(title=""),
                "problems": problems(table),
                "notes": notes(table, paper),
                "pictures": pictures.get(table.slug, ()),
            }
            for table in tables
        ],
        runs=Table(header, [_run(run) for run in runs], left=("folder", "state", "reason"), wrap=True),
        command=command,
        commands="\n".join(f"# {name}\n{words}" for name, words in commands if words),
    )


def _run(run: FoundRun) -> Row:
    planned = MISSING if run.planned is None else str(run.planned)
    members, time = run.metrics["members"] if run.metrics else (), run.metrics["seconds"] if run.metrics else {}
    done = sum(member["status"] == "ok" for member in members)
    cells = [f"{done} / {planned}", duration(time.get("total")), str(run.environment.get("commit") or MISSING)]
    return "" if run.state == "finished" else "failed", [run.name, run.state, *cells, run.reason]
