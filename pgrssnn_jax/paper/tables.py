"""The tables of many runs as text: what stands in each cell, the notes below, the terminal, Markdown, LaTeX and CSV."""

import math
import re
from collections.abc import Sequence
from typing import Any

import pandas as pd

from pgrssnn_jax.paper.order import order_lines
from pgrssnn_jax.paper.published import Paper, Value
from pgrssnn_jax.paper.rows import EvidenceTable, Row, failures
from pgrssnn_jax.reports.content import MISSING, MemberRow, duration, number
from pgrssnn_jax.reports.tables import Table

QUOTED = "†"
SHOWN_SEEDS = 12
IN_TERMINAL = ("variant", "mean ± std", "members", "published", "difference")  # the page has all
_NOT_IN_LATEX = ["failed", "time"]  # members says as much, and the cost stands elsewhere
_SIGNS = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"$<$", ">": r"$>$", "|": r"$|$", "±": r"$\pm$",
    "²": r"$^2$", "·": r"$\cdot$", "†": r"$^\dagger$", "–": r"\textendash{}", "…": r"\dots{}", "−": r"$-$", '"': "''",
    "[": "{[}", "*": "{*}",
}  # fmt: skip


def table_of(table: EvidenceTable) -> Table:
    """One row per variant; a row without figures says in their place why."""
    cc = ("CC",) if table.sizes else ()
    figures = ("mean ± std", "median", "best", "ensemble", *cc)
    header = ("variant", *figures, "members", "failed", "published", "difference", "time")
    rows = [(_look(row), _cells(row, table)) for row in table.rows]
    return Table(header, rows, f"{table.title}: {table.heading}", left=header[:1], wrap=True)


def _look(row: Row) -> str:
    missing = "" if math.isfinite(row.figures.mean) else "failed"
    return "quoted" if row.state == "quoted" else missing or ("partial" if row.failed else "")


def _cells(row: Row, table: EvidenceTable) -> list[str]:
    f, quoted = row.figures, row.state == "quoted"
    mean = MISSING if row.state in ("finished", "quoted") else row.state
    members = f"{len(row.finished)} / {MISSING if row.planned is None else row.planned}"
    return [
        f"{row.label} {QUOTED}" if quoted else row.label,
        number(f.mean, std=f.std) if math.isfinite(f.mean) else mean,
        *map(number, [f.median, f.best, f.ensemble, *([f.cc] if table.sizes else [])]),
        MISSING if quoted else members,
        MISSING if row.metrics is None else str(len(row.failed)),
        published(row.published),
        f"{row.difference:+.1f}" if math.isfinite(row.difference) else MISSING,
        duration(row.seconds),
    ]


def published(value: Value | None) -> str:
    """As the paper prints it: two decimals, the runs that finished where some failed, the best where it is given."""
    if value is None:
        return MISSING
    runs = f" ({value.finished}/{value.runs})" if value.finished < value.runs else ""
    best = f", best {value.best:.2f}" if value.best is not None else ""
    return (MISSING if value.mean is None else f"{value.mean:.2f}") + runs + best


def problems(table: EvidenceTable) -> list[str]:
    """Everything that is not as it should be: runs that are missing, unfinished or failed, members that failed."""
    lines = [f"{r.label}: {r.state}: {r.reason}" for r in table.rows if r.state in ("failed", "unfinished", "damaged")]
    missing = [row.label for row in table.rows if row.state == "missing"]
    lines += [f"missing, no run folder: {', '.join(missing)}"] if missing else []
    for row in table.rows:
        lines += [
            f"{row.label}: {len(members)} of {row.planned} members failed: {reason} ({who(row, members)})"
            for reason, members in failures(row)
        ]
        lost = (row.planned or 0) - len(row.finished) - len(row.failed)
        if row.state == "finished" and lost:
            lines.append(f"{row.label}: {lost} of {row.planned} members without a result")
        if row.state == "finished" and row.reason:
            lines.append(f"{row.label}: {row.reason}")
    simulated = [row.label for row in table.rows if row.simulated]
    return lines + ([f"SIMULATED DATA, generated here: {', '.join(simulated)}"] if simulated else [])


def who(row: Row, members: Sequence[MemberRow]) -> str:
    """Members by seed, and by data set where there are several; the first few of many."""
    several = len({member.dataset for member in (*row.finished, *row.failed)}) > 1
    names = [f"{member.seed}/{member.dataset}" if several else str(member.seed) for member in members]
    more = f" and {len(names) - SHOWN_SEEDS} more" if len(names) > SHOWN_SEEDS else ""
    return f"seed{'/dataset' if several else ''} {', '.join(names[:SHOWN_SEEDS])}{more}"


def rule(table: EvidenceTable, paper: Paper) -> list[str]:
    """How the differences were found; empty where there is nothing published to differ from."""
    if not any(row.published and row.published.runs for row in table.rows):
        return []
    runs = paper.systems[table.system].runs
    return [
        "difference: (mean - published) / sqrt(std² (1/n + 1/n_p) + d²/12), in combined standard errors, for n finished"
        f" members and n_p finished runs of the paper ({runs} unless some failed). The paper prints no deviations and"
        f" rounds to d = {paper.rounding:g}: the measured std stands for both, d²/12 for the rounding. None with fewer"
        " than two finished members."
    ]


def notes(table: EvidenceTable, paper: Paper) -> list[str]:
    """How the paper's order fares, why figures differ, where the data came from, what was asked for, what it cost."""
    lines = [*rule(table, paper), *order_lines(table, paper)]
    lines += [f"{row.label}: {row.why}" for row in table.rows if row.why]
    if any(row.state == "quoted" for row in table.rows):
        lines.append(f"{QUOTED} quoted by the paper from the literature, not measured here")
    if table.budget:
        lines.append(f"every run was capped by budget={table.budget}: the figures are no match for the published ones")
    if table.common:
        lines.append("all runs with " + " ".join(f"{key}={value}" for key, value in table.common.items()))
    sources = dict.fromkeys(str(row.metrics.get("origin")) for row in table.measured if row.metrics)
    lines += [f"data: {origin}" for origin in sources]
    timed = sum(math.isfinite(row.seconds) for row in table.rows)
    hours = f" ({table.seconds / 3600:.1f} h)" if table.seconds >= 3600 else ""
    return [*lines, f"cost: {duration(table.seconds)}{hours} in all, over {timed} runs that tell their time"]


def terminal_table(table: EvidenceTable, paper: Paper) -> Table:
    """The columns that a terminal has room for."""
    return table_of(table).only(IN_TERMINAL)._replace(footer=[*problems(table), *notes(table, paper)])


def markdown(tables: Sequence[EvidenceTable], paper: Paper) -> str:
    """All tables, each with its notes, for a file of their own."""
    lines = ["# Measured and published", "", f"Published figures: {_escaped(paper.source)}.", ""]
    for table in tables:
        made = table_of(table)
        rows = [[*map(_escaped, made.header)], [":---", *["---:"] * len(made.header[1:])]]
        for look, cells in made.rows:
            name, *figures = map(_escaped, cells)
            rows.append([f"*{name}*" if look == "quoted" else name, *figures])
        lines += [f"## {_escaped(made.title)}", "", *(f"| {' | '.join(cells)} |" for cells in rows), ""]
        lines += [*(f"- {_escaped(line)}" for line in [*problems(table), *notes(table, paper)]), ""]
    return "\n".join(lines)


def one_line(text: str) -> str:
    return " ".join(text.split())


def _escaped(text: str) -> str:
    """Text as it stands in Markdown, on one line."""
    return re.sub(r"([\\`*_\[\]<>#~|])", r"\\\1", one_line(text))


def latex(tables: Sequence[EvidenceTable], paper: Paper) -> str:
    """Floats with booktabs rules, and nothing that needs another package."""
    head = "% \\usepackage{booktabs} in the preamble, \\input{tables.tex} in the document\n"
    return head + "\n".join(_float(table, paper) for table in tables)


def _float(table: EvidenceTable, paper: Paper) -> str:
    made = table_of(table)
    cells = pd.DataFrame([row for _, row in made.rows], columns=list(made.header)).drop(columns=_NOT_IN_LATEX)
    cells = cells.map(_latex_cell).rename(columns=latex_escaped)
    quoted = [look == "quoted" for look, _ in made.rows]
    cells.loc[quoted, "variant"] = [rf"\textit{{{name}}}" for name in cells["variant"][quoted]]
    columns = "l" + "r" * len(cells.columns[1:])
    body = cells.to_latex(index=False, escape=False, column_format=columns).strip()
    below = ["† quoted from the literature."] * any(quoted) + [*rule(table, paper), *problems(table)]
    notes = (rf"  \par\smallskip\parbox{{\linewidth}}{{\scriptsize {latex_escaped(text)}}}" for text in below)
    caption = latex_escaped(f"{table.title}: {table.heading}, beside the figures of {paper.source}.")
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering\scriptsize\setlength{\tabcolsep}{2.5pt}",
            rf"  \caption{{{caption}}}\label{{tab:{table.slug}}}",
            rf"  \makebox[\linewidth][c]{{{body}}}",
            *notes,
            "\\end{table}\n",
        ]
    )


def _latex_cell(cell: str) -> str:
    """A cell; a bare number becomes one of LaTeX's, whose minus is a minus."""
    return f"${cell}$" if cell != MISSING and re.fullmatch(r"[+-]?[\d.]+(e[+-]\d+)?", cell) else latex_escaped(cell)


def latex_escaped(text: str) -> str:
    """Text as it stands; a letter that plain LaTeX has no glyph for becomes a question mark."""
    known = "".join(_SIGNS.get(c) or (c if c.isascii() or "À" <= c <= "ÿ" else "?") for c in one_line(text))
    return known.replace("--", "-{}-")  # two hyphens would become a dash


def frame(tables: Sequence[EvidenceTable]) -> pd.DataFrame:
    """One row per variant with unrounded figures; what does not exist is empty."""
    return pd.DataFrame([_record(row, table) for table in tables for row in table.rows]).convert_dtypes()


def _record(row: Row, table: EvidenceTable) -> dict[str, Any]:
    value, run = row.published, row.run
    paper = {"": None, "_best": None, "_runs": None, "_finished": None}
    if value:
        paper = {"": value.mean, "_best": value.best, "_runs": value.runs, "_finished": value.finished}
    return {
        "experiment": table.name,
        "budget": table.budget,
        "system": table.system,
        **row.variant._asdict(),
        "variant": row.label,
        "overrides": " ".join(f"{key}={v}" for key, v in run.overrides.items()) if run else "",
        "state": row.state,
        "reason": "; ".join(filter(None, [row.reason, *(reason for reason, _ in failures(row))])),
        "planned": row.planned,
        "finished": len(row.finished),
        "failed": len(row.failed),
        "merit": table.merit,
        "unit": table.unit,
        **row.figures._asdict(),
        **{f"published{end}": found for end, found in paper.items()},
        "difference": row.difference,
        "seconds": row.seconds,
        "source": row.metrics["source"] if row.metrics else None,
        "folder": run.name if run else None,
    }
