"""The tables of a run; planned, finished and failed members stand below each."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import MISSING, Content, MemberRow, Metrics, number
from pgrssnn_jax.reports.tabular import Row, Table


class Selection(NamedTuple):
    """The members that a short table shows: failed ones, the best and the worst; and how many it leaves out."""

    best: list[MemberRow]
    worst: list[MemberRow]
    failed: list[MemberRow]
    left_out: int
    left_out_failed: int


SUMMARY_HEADER = ("n_init", "mean", "std", "median", "best", "ensemble", "NRMSE mean")
MEMBER_HEADER = ("seed", "dataset", "status", "best epoch", "RMSE", "NRMSE", "fit %", "CC", "reason")
OUTPUT_TITLE = "test record, means over finished members"
OUTPUT_HEADER = ("output", "unit", "RMSE", "NRMSE", "fit %", "CC")


def summary_title(metrics: Metrics) -> str:
    return f"test {content.merit(metrics)}{content.in_unit(content.unit(metrics))}"


def member_title(metrics: Metrics) -> str:
    return f"members, best first; {summary_title(metrics)}"


def summary_table(metrics: Metrics) -> Table:
    """One row per n_init, RMSE over members and of the ensemble; the n_init of the run is bold."""
    rows: list[Row] = [
        ("headline" if row.headline else "", [str(row.n_init), *map(number, row[2:])])
        for row in content.summary_rows(metrics)
    ]
    return Table(SUMMARY_HEADER, rows, f"{content.heading(metrics)} · {summary_title(metrics)}", _footer(metrics))


def member_table(metrics: Metrics, limit: int = 12, *, numbered: bool = True) -> Table:
    """One row per member; of more than `limit` members the best, the worst and failed ones, and how many are left out.

    numbered: reasons are numbers, spelled out below the table with the number of members of each.
    """
    rows = content.member_rows(metrics)
    shown = select(rows, limit)
    reasons = Counter(row.reason for row in rows if row.reason)
    numbers = {reason: str(k) for k, reason in enumerate(reasons, 1)}
    left, of_them = f"{shown.left_out} of {len(rows)} members left out", f"({shown.left_out_failed} of them failed)"
    footer = [f"{left} {of_them}"] if shown.left_out else []
    footer += [f"reason {numbers[reason]}: {reason} ({count} of {len(rows)})" for reason, count in reasons.items()]
    gap = ("gap", [f"{left} here {of_them}"] if shown.left_out else [])
    best, worst, failed = (
        [_member(row, numbers if numbered else {}) for row in group]
        for group in (shown.best, shown.worst, shown.failed)
    )
    title = f"{content.heading(metrics)} · {member_title(metrics)}"
    return Table(MEMBER_HEADER, [*best, gap, *worst, ("gap", []), *failed], title, [*footer, *_footer(metrics)])


def _member(row: MemberRow, numbers: Mapping[str, str]) -> Row:
    epoch = MISSING if row.best_epoch is None else str(row.best_epoch)
    reason = numbers.get(row.reason, MISSING) if numbers else row.reason
    cells = [str(row.seed), str(row.dataset), "failed" if row.failed else "ok", epoch, *map(number, row[-4:]), reason]
    return "failed" if row.failed else "", cells


def output_table(metrics: Metrics) -> Table:
    """One row per output, in the order of `metrics.json`; of one output alone the other tables say as much."""
    tests = [member["test"] for member in metrics["members"] if member.get("test")]

    def cells(k: int, output: Metrics) -> list[Content]:
        merits = (content.over_outputs([test[name][k] for test in tests]) for name in content.MERITS)
        return [output["name"], output.get("unit") or MISSING, *map(number, merits)]

    rows = [("", cells(k, output)) for k, output in enumerate(metrics["outputs"])]
    title = f"{content.heading(metrics)} · outputs; {OUTPUT_TITLE}"
    return Table(OUTPUT_HEADER, rows, title, _footer(metrics)[:2])


def select(rows: Sequence[MemberRow], limit: int) -> Selection:
    """At most `limit` members: failed ones get a third of the places, or what the finished ones leave."""
    if limit < 1:
        raise ValueError(f"member_table: limit: expected at least 1, found {limit}")
    finished, failed = content.ranked(rows)
    shown_failed = min(len(failed), max(limit // 3, limit - len(finished)))
    places = min(len(finished), limit - shown_failed)
    worst = places // 2 if places < len(finished) else 0
    best, last = finished[: places - worst], finished[len(finished) - worst :]
    left_out = len(rows) - places - shown_failed
    return Selection(best, last, failed[:shown_failed], left_out, len(failed) - shown_failed)


def _footer(metrics: Metrics) -> list[str]:
    outputs = ", ".join(output["name"] for output in metrics["outputs"])
    lines = [f"members: {content.counts(metrics)}", content.source(metrics)]
    return [*lines, f"figures are means over the outputs {outputs}"] if len(metrics["outputs"]) > 1 else lines
