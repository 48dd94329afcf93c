"""The tables of a run, for the terminal (rich) and for Markdown; planned, finished and failed members stand below."""

from collections import Counter
from collections.abc import Collection, Sequence
from typing import NamedTuple

from rich import box
from rich.table import Table
from rich.text import Text

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import MISSING, MemberRow, Metrics, SummaryRow, rounded


class Selection(NamedTuple):
    """The members that a short table shows: failed ones, the best and the worst; and how many it leaves out."""

    best: list[MemberRow]
    worst: list[MemberRow]
    failed: list[MemberRow]
    left_out: int
    left_out_failed: int


class OutputRow(NamedTuple):
    """One output on the test record: means over finished members, NaN where there is none."""

    name: str
    unit: str
    rmse: float
    nrmse: float
    fit_percent: float
    cc: float


SUMMARY_HEADER = ("n_init", "mean", "std", "median", "best", "ensemble", "NRMSE mean")
MEMBER_HEADER = ("seed", "dataset", "status", "best epoch", "RMSE", "NRMSE", "fit %", "CC", "reason")
WORDS = ("status", "output", "unit")
OUTPUT_TITLE = "test record, means over finished members"
OUTPUT_HEADER = ("output", "unit", "RMSE", "NRMSE", "fit %", "CC")


def summary_title(metrics: Metrics) -> str:
    return f"test {content.merit(metrics)}{_in_unit(metrics)}"


def member_title(metrics: Metrics) -> str:
    return f"members, best first; test {content.merit(metrics)}{_in_unit(metrics)}"


def summary_cells(row: SummaryRow) -> list[str]:
    figures = (row.mean, row.std, row.median, row.best, row.ensemble, row.nrmse)
    return [str(row.n_init), *(rounded(value) for value in figures)]


def member_cells(row: MemberRow) -> list[str]:
    figures = (rounded(value) for value in (row.rmse, row.nrmse, row.fit_percent, row.cc))
    epoch = MISSING if row.best_epoch is None else str(row.best_epoch)
    return [str(row.seed), str(row.dataset), "failed" if row.failed else "ok", epoch, *figures, row.reason]


def output_rows(metrics: Metrics) -> list[OutputRow]:
    """The outputs in the order of `metrics.json`."""
    tests = [member["test"] for member in metrics["members"] if member.get("test")]

    def row(k: int, output: Metrics) -> OutputRow:
        merits = (content.over_outputs([test[name][k] for test in tests]) for name in OutputRow._fields[2:])
        return OutputRow(output["name"], output.get("unit", ""), *merits)

    return [row(k, output) for k, output in enumerate(metrics["outputs"])]


def output_cells(row: OutputRow) -> list[str]:
    return [row.name, row.unit or MISSING, *(rounded(value) for value in row[2:])]


def select(rows: Sequence[MemberRow], limit: int) -> Selection:
    """At most `limit` members: failed ones get a third of the places, or what the finished ones leave."""
    if limit < 1:
        raise ValueError(f"member_table: limit: expected at least 1, found {limit}")
    finished, failed = content.ranked(rows)
    shown_failed = min(len(failed), max(limit // 3, limit - len(finished)))
    places = min(len(finished), limit - shown_failed)
    worst = places // 2 if places < len(finished) else 0
    return Selection(
        finished[: places - worst],
        finished[len(finished) - worst :],
        failed[:shown_failed],
        len(rows) - places - shown_failed,
        len(failed) - shown_failed,
    )


def summary_table(metrics: Metrics) -> Table:
    """One row per n_init, RMSE over members and of the ensemble; the n_init of the run is bold."""
    table = rich_table(
        f"{content.heading(metrics)} · {summary_title(metrics)}", SUMMARY_HEADER, "\n".join(_footer(metrics))
    )
    for row in content.summary_rows(metrics):
        table.add_row(*map(Text, summary_cells(row)), style="bold" if row.headline else "")
    return table


def member_table(metrics: Metrics, limit: int = 12) -> Table:
    """One row per member; of more than `limit` members the best, the worst and failed ones, and how many are left out.

    Reasons are numbered and spelled out below the table, with the number of members of each.
    """
    rows = content.member_rows(metrics)
    shown = select(rows, limit)
    left = ""
    if shown.left_out:
        left = f"{shown.left_out} of {len(rows)} members left out ({shown.left_out_failed} of them failed)\n"
    reasons = Counter(row.reason for row in rows if row.reason)
    number = {reason: str(k) for k, reason in enumerate(reasons, 1)}
    spelled = "".join(
        f"reason {number[reason]}: {reason} ({count} of {len(rows)})\n" for reason, count in reasons.items()
    )
    title = f"{content.heading(metrics)} · {member_title(metrics)}"
    table = rich_table(title, MEMBER_HEADER, left + spelled + "\n".join(_footer(metrics)))
    for group, style in ((shown.best, ""), (shown.worst, ""), (shown.failed, "red")):
        for row in group:
            table.add_row(*map(Text, member_cells(row)[:-1]), number.get(row.reason, MISSING), style=style)
        table.add_section()
    return table


def output_table(metrics: Metrics) -> Table:
    """One row per output; of one output alone the other tables say as much."""
    footer = f"members: {content.counts(metrics)}\n{content.source(metrics)}"
    table = rich_table(f"{content.heading(metrics)} · outputs; {OUTPUT_TITLE}", OUTPUT_HEADER, footer)
    for row in output_rows(metrics):
        table.add_row(*map(Text, output_cells(row)))
    return table


def markdown_summary(metrics: Metrics) -> str:
    """The summary table as Markdown, with the counts of members and the source of the data below it."""
    lines = [f"### {one_line(content.heading(metrics))}: {summary_title(metrics)}", "", pipes(SUMMARY_HEADER)]
    lines.append("|" + "---:|" * len(SUMMARY_HEADER))
    lines += [pipes(summary_cells(row)) for row in content.summary_rows(metrics)]
    lines += ["", *(f"- {one_line(line)}" for line in _footer(metrics)), ""]
    return "\n".join(lines)


def _footer(metrics: Metrics) -> list[str]:
    outputs = ", ".join(output["name"] for output in metrics["outputs"])
    lines = [f"members: {content.counts(metrics)}", content.source(metrics)]
    if len(metrics["outputs"]) > 1:
        lines.append(f"figures are means over the outputs {outputs}")
    return lines


def rich_table(
    title: str, header: Sequence[str], footer: str, *, words: Collection[str] = WORDS, no_wrap: bool = True
) -> Table:
    """An empty table for the terminal. words: the columns that stand at the left.

    Where the terminal is too narrow, cells are broken, or with `no_wrap` cut.
    """
    table = Table(title=Text(title, "bold"), caption=Text(footer), box=box.SIMPLE_HEAD, collapse_padding=True)
    table.title_justify = table.caption_justify = "left"
    for name in header:
        table.add_column(
            Text(name),
            justify="left" if name in words else "right",
            no_wrap=no_wrap,
            overflow="ellipsis" if no_wrap else "fold",
        )
    return table


def _in_unit(metrics: Metrics) -> str:
    unit = content.unit(metrics)
    return f" in {unit}" if unit else ""


def pipes(cells: Sequence[str]) -> str:
    """One row of a Markdown table."""
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def one_line(text: str) -> str:
    return " ".join(text.split())
