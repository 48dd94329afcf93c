"""The tables of a run; planned, finished and failed members stand below each."""

from collections import Counter

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import MISSING, MemberRow, Metrics, rounded
from pgrssnn_jax.reports.tabular import Row, Table

SUMMARY_HEADER = ("n_init", "mean", "std", "median", "best", "ensemble", "NRMSE mean")
MEMBER_HEADER = ("seed", "dataset", "status", "best epoch", "RMSE", "NRMSE", "fit %", "CC")
OUTPUT_HEADER = ("output", "unit", "RMSE", "NRMSE", "fit %", "CC")
SHOWN_MEMBERS = 20


def summary_table(metrics: Metrics) -> Table:
    """One row per n_init, RMSE over members and of the ensemble; the n_init of the run is bold."""
    rows: list[Row] = [
        ("headline" if row.headline else "", [str(row.n_init), *map(rounded, row[2:])])
        for row in content.summary_rows(metrics)
    ]
    return Table(SUMMARY_HEADER, rows, _title(metrics, "all members"), _footer(metrics))


def member_table(metrics: Metrics) -> Table:
    """One row per member, the best first and failed ones last; below it how many ended for which reason."""

    def row(member: MemberRow) -> Row:
        epoch = MISSING if member.best_epoch is None else str(member.best_epoch)
        status = "failed" if member.failed else "ok"
        cells = [str(member.seed), str(member.dataset), status, epoch, *map(rounded, member[-4:])]
        return "failed" if member.failed else "", cells

    members = content.member_rows(metrics)
    finished, failed = content.ranked(members)
    reasons = Counter(member.reason for member in members if member.reason)
    footer = [f"{reason} ({count} of {len(members)})" for reason, count in reasons.items()]
    rows = [row(member) for member in (*finished, *failed)]
    title = _title(metrics, "members, best first")
    return Table(MEMBER_HEADER, rows, title, [*footer, *_footer(metrics)], most=SHOWN_MEMBERS)


def output_table(metrics: Metrics) -> Table:
    """One row per output, in the order of `metrics.json`; of one output alone the other tables say as much."""
    tests = [member["test"] for member in metrics["members"] if member.get("test")]

    def cells(k: int, output: Metrics) -> list[str]:
        merits = (content.over_outputs([test[name][k] for test in tests]) for name in content.MERITS)
        return [output["name"], output.get("unit") or MISSING, *map(rounded, merits)]

    rows = [("", cells(k, output)) for k, output in enumerate(metrics["outputs"])]
    title = f"{content.heading(metrics)} · outputs; test record, means over finished members"
    return Table(OUTPUT_HEADER, rows, title, _footer(metrics)[:2])


def _title(metrics: Metrics, what: str) -> str:
    unit = content.in_unit(content.unit(metrics))
    return f"{content.heading(metrics)} · {what}; test {content.merit(metrics)}{unit}"


def _footer(metrics: Metrics) -> list[str]:
    outputs = ", ".join(output["name"] for output in metrics["outputs"])
    lines = [f"members: {content.counts(metrics)}", content.source(metrics)]
    return [*lines, f"figures are means over the outputs {outputs}"] if len(metrics["outputs"]) > 1 else lines
