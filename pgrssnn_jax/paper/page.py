"""The page of many runs: every table with its notes and figures, and every run with how it ended."""

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
    header = ("folder", "state", "members", "time", "commit", "reason")
    orders = [order_held(table, paper) for table in tables]
    commands = [(run.name, run.environment.get("command")) for run in runs]
    return rendered(
        "runs.html.j2",
        paper=paper,
        tables=tables,
        rows=[row for table in tables for row in table.rows],
        order=[sum(counts) for counts in zip(*orders, strict=True)],
        found=runs,
        table_of=table_of,
        problems=problems,
        notes=notes,
        pictures=pictures,
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
