"""The page of many runs: every table with its notes and figures, and every run with how it ended.

Like the page of a single run it is one file that loads nothing, all text is escaped, and every figure stands in a
`<data>` element whose `value` is the unrounded number.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from pgrssnn_jax.paper.collect import FoundRun
from pgrssnn_jax.paper.order import ordering
from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable, Row
from pgrssnn_jax.paper.tables import cells, header, notes, problems
from pgrssnn_jax.reports import markup
from pgrssnn_jax.reports.content import MISSING, duration
from pgrssnn_jax.reports.frame import cards, document, index, shown_figure
from pgrssnn_jax.reports.markup import number

EVIDENCE_STYLESHEET = """
.quoted td { font-style: italic; color: var(--quiet); }
.notes { color: var(--quiet); font-size: 0.9rem; padding-left: 1.2rem; margin: 0.6rem 0 1.4rem; }
td, th { padding-inline: 0.55rem; }
td.words { white-space: normal; min-width: 7.5rem; }
"""
TITLE = "Measured and published"
RUN_HEADER = ("folder", "state", "members", "time", "commit", "reason")

Pictures = Mapping[str, Sequence[tuple[str, str, Path]]]
"""By the slug of a table: title, caption and PNG file of its figures."""


def evidence_page(
    tables: Sequence[EvidenceTable], runs: Sequence[FoundRun], paper: Paper, pictures: Pictures, command: str
) -> str:
    """The HTML of the page; raises `ValueError` where a picture is no PNG file."""
    links = {table.slug: table.title for table in tables} | {"runs": "Runs", "reproduce": "Reproduce"}
    sections = [_header(tables, runs, paper), _banner(tables), _cards(tables, runs, paper), index(links)]
    figures = 0
    for table in tables:
        sections.append(_section(table, paper))
        for title, caption, path in pictures.get(table.slug, ()):
            figures += 1
            picture = markup.image(path, title)
            sections.append(shown_figure(f"figure-{figures}", "", picture, f"Figure {figures}. {title}", caption))
    footer = "Made by pgrssnn_jax from metrics.json and predictions.npz of the run folders named above."
    return document(TITLE, [*sections, _runs(runs), _reproduce(runs, command)], footer, EVIDENCE_STYLESHEET)


def _header(tables: Sequence[EvidenceTable], runs: Sequence[FoundRun], paper: Paper) -> str:
    finished = sum(run.state == "finished" for run in runs)
    lead = f"{finished} of {len(runs)} runs finished, in {len(tables)} table{'s'[: len(tables) - 1]}"
    absent = sum(row.state == "missing" for table in tables for row in table.rows)
    lead += f"; without any run: {absent} variant{'s'[: absent - 1]}." if absent else "; no variant is without a run."
    facts = f"published figures: {paper.source}; all errors are those of free runs over the test record"
    return (
        f'<header><p class="eyebrow">Report of many runs</p><h1>{TITLE}</h1>'
        f'<p class="lead">{escape(lead)}</p><p class="facts">{escape(facts)}</p></header>\n'
    )


def _banner(tables: Sequence[EvidenceTable]) -> str:
    metrics = [row.run.metrics for table in tables for row in table.rows if row.run and row.run.metrics]
    simulated = sum(found["source"] == "simulated" for found in metrics)
    capped = [table.title for table in tables if table.budget]
    text = f"<strong>SIMULATED DATA.</strong> In {simulated} of {len(metrics)} runs nothing was measured."
    banners = f'<div class="banner" role="alert">{text}</div>\n' if simulated else ""
    text = f"<strong>CAPPED RUNS.</strong> {escape(', '.join(capped))}: no match for the published figures."
    return banners + (f'<div class="banner" role="alert">{text}</div>\n' if capped else "")


def _cards(tables: Sequence[EvidenceTable], runs: Sequence[FoundRun], paper: Paper) -> str:
    rows = [row for table in tables for row in table.rows]
    planned = sum(row.planned or 0 for row in rows)
    finished, failed = sum(len(row.finished) for row in rows), sum(len(row.failed) for row in rows)
    orders = [ordering(table, paper) for table in tables]
    held, turned = sum(len(order.held) for order in orders), sum(len(order.turned) for order in orders)
    ended = sum(run.state == "finished" for run in runs)
    seconds = math.fsum(table.seconds for table in tables)
    return cards(
        [
            ("runs finished", f"{number(ended)} / {number(len(runs))}", "DONE stands in their folder"),
            ("members finished", f"{number(finished)} / {number(planned)}", f"{failed} failed"),
            ("order of the paper", f"{number(held)} / {number(held + turned)}", "pairs that it tells apart hold here"),
            ("time", number(seconds, duration(seconds)), "of all finished runs together"),
        ]
    )


def _section(table: EvidenceTable, paper: Paper) -> str:
    head = header(table)
    body = markup.table(head, [_row(row, table, head) for row in table.rows])
    wrong = "".join(f"<li>{escape(line)}</li>" for line in problems(table))
    banner = f'<div class="banner" role="note"><ul>{wrong}</ul></div>\n' if wrong else ""
    below = "".join(f"<li>{escape(line)}</li>" for line in notes(table, paper))
    return (
        f'<h2 id="{table.slug}">{escape(f"{table.title}: {table.heading}")}</h2>\n'
        f'{body}{banner}<ul class="notes">{below}</ul>\n'
    )


def _row(row: Row, table: EvidenceTable, head: Sequence[str]) -> str:
    """The cells as text, but for the figures, which carry their exact values."""
    f, texts = row.figures, dict(zip(head, cells(row, table), strict=True))
    exact = {"median": f.median, "best": f.best, "ensemble": f.ensemble, "CC": f.cc, "difference": row.difference}
    found = {name: number(exact[name], texts[name]) if name in exact else escape(texts[name]) for name in head}
    if math.isfinite(f.mean):
        found["mean ± std"] = markup.value(f.mean, f.std)
    if row.published and row.published.mean is not None:
        mean = f"{row.published.mean:.2f}"
        found["published"] = number(row.published.mean, mean) + escape(texts["published"].removeprefix(mean))
    found["time"] = number(row.seconds, texts["time"])
    look = "quoted" if row.state == "quoted" else "" if math.isfinite(f.mean) else "failed"
    return markup.row(head, [found[name] for name in head], look)


def _runs(runs: Sequence[FoundRun]) -> str:
    def one(run: FoundRun) -> str:
        planned = MISSING if run.planned is None else str(run.planned)
        done, seconds = "0", None
        if run.metrics:
            done = str(sum(member["status"] == "ok" for member in run.metrics["members"]))
            seconds = run.metrics["seconds"].get("total")
        texts = [run.name, run.state, f"{done} / {planned}", "", str(run.environment.get("commit") or MISSING)]
        found = [*map(escape, texts), escape(run.reason)]
        found[3] = number(seconds, duration(seconds))
        return markup.row(RUN_HEADER, found, "" if run.state == "finished" else "failed")

    return f'<h2 id="runs">Runs</h2>\n{markup.table(RUN_HEADER, [one(run) for run in runs])}'


def _reproduce(runs: Sequence[FoundRun], command: str) -> str:
    said = [(run.name, run.environment.get("command")) for run in runs]
    lines = "\n".join(f"# {name}\n{words}" for name, words in said if words)
    return (
        f'<h2 id="reproduce">Reproduce</h2>\n<pre>{escape(command)}</pre>\n'
        f"{markup.folded('Commands of the runs', lines)}"
    )
