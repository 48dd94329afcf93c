"""One table for a terminal, a notebook and a page, and the tables of a run in this form.

Planned, finished and failed members stand below each table of a run.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports.content import MISSING, MemberRow, Metrics, number
from pgrssnn_jax.reports.rendering import rendered

STYLES = {"headline": "bold", "failed": "red", "partial": "yellow", "quoted": "italic"}
SHOWN_MEMBERS = 20

Row = tuple[str, Sequence[str]]
"""A look and the cells. Looks: headline (the row to read first), failed, partial (some members failed), quoted."""


class Table(NamedTuple):
    """footer: lines below it; left: the columns whose cells stand at the left; wrap: where there is too little room,
    cells are broken rather than cut; most: rows to show at first, all if None."""

    header: Sequence[str]
    rows: Sequence[Row]
    title: str = ""
    footer: Sequence[str] = ()
    left: Sequence[str] = ()
    wrap: bool = False
    most: int | None = None

    def only(self, names: Sequence[str]) -> "Table":
        """The table with these columns."""
        kept = [list(self.header).index(name) for name in names]
        return self._replace(header=names, rows=[(look, [cells[k] for k in kept]) for look, cells in self.rows])

    def __rich__(self) -> RichTable:
        """The table for the terminal; square brackets are no markup."""
        more = len(self.rows) - len(self.rows[: self.most])
        footer = [*([f"{more} of {len(self.rows)} rows left out, all are on the page"] if more else []), *self.footer]
        table = RichTable(title=Text(self.title, "bold"), caption=Text("\n".join(footer)), box=box.SIMPLE_HEAD)
        table.title_justify = table.caption_justify = "left"
        table.collapse_padding = True
        for name in self.header:
            side, overflow = "left" if name in self.left else "right", "fold" if self.wrap else "ellipsis"
            table.add_column(Text(name), justify=side, no_wrap=not self.wrap, overflow=overflow)
        for look, cells in self.rows[: self.most]:
            table.add_row(*map(Text, cells), style=STYLES.get(look, ""))
        return table

    def html(self) -> str:
        """The table for a page or a notebook, escaped."""
        return rendered("table.html.j2", table=self)

    __html__ = _repr_html_ = html


def summary_table(metrics: Metrics) -> Table:
    """One row per n_init, RMSE over members and of the ensemble; the n_init of the run is bold."""
    header = ("n_init", "mean", "std", "median", "best", "ensemble", "NRMSE mean")
    rows: list[Row] = [
        ("headline" if row.headline else "", [str(row.n_init), *map(number, row[2:])])
        for row in content.summary_rows(metrics)
    ]
    return Table(header, rows, _title(metrics, "all members"), _footer(metrics))


def member_table(metrics: Metrics) -> Table:
    """One row per member, the best first and failed ones last; below it how many ended for which reason."""

    def row(member: MemberRow) -> Row:
        epoch = MISSING if member.best_epoch is None else str(member.best_epoch)
        status = "failed" if member.failed else "ok"
        cells = [str(member.seed), str(member.dataset), status, epoch, *map(number, member[-4:])]
        return "failed" if member.failed else "", cells

    header = ("seed", "dataset", "status", "best epoch", "RMSE", "NRMSE", "fit %", "CC")
    members = content.member_rows(metrics)
    finished, failed = content.ranked(members)
    reasons = Counter(member.reason for member in members if member.reason)
    footer = [f"{reason} ({count} of {len(members)})" for reason, count in reasons.items()]
    rows, title = [row(member) for member in (*finished, *failed)], _title(metrics, "members, best first")
    return Table(header, rows, title, [*footer, *_footer(metrics)], left=["status"], most=SHOWN_MEMBERS)


def output_table(metrics: Metrics) -> Table:
    """One row per output, in the order of `metrics.json`; of one output alone the other tables say as much."""
    tests = [member["test"] for member in metrics["members"] if member.get("test")]

    def cells(k: int, output: Metrics) -> list[str]:
        merits = (content.over_outputs([test[name][k] for test in tests]) for name in content.MERITS)
        return [output["name"], output.get("unit") or MISSING, *map(number, merits)]

    header = ("output", "unit", "RMSE", "NRMSE", "fit %", "CC")
    rows = [("", cells(k, output)) for k, output in enumerate(metrics["outputs"])]
    title = f"{content.heading(metrics)} · outputs; test record, means over finished members"
    return Table(header, rows, title, _footer(metrics)[:2], left=header[:2])


def choice_table(recipe: Mapping[str, Any], title: str) -> Table:
    """The candidates of `recipe=auto`, the chosen one first."""
    rows = [
        ("" if k else "headline", [number(one["left_out_nrmse"]), str(one["epochs"]), one["settings"]])
        for k, one in enumerate(recipe["tried"])
    ]
    footer = ["left-out NRMSE: geometric mean over members, each at the epoch that is best for the others"]
    # runs of an earlier version hold seeds alone
    alone = [one if isinstance(one, dict) else {"seed": one, "dataset": 0} for one in recipe.get("fell_back") or ()]
    if alone:
        several = any(one["dataset"] for one in alone)
        names = (f"{one['seed']}" + (f" of dataset {one['dataset']}" if several else "") for one in alone)
        footer.append(
            f"seeds that do not beat the physics on what they leave out, and are the physics alone: {', '.join(names)}"
        )
    header = ("left-out NRMSE", "epochs", "candidate")
    return Table(header, rows, f"{title} · recipe=auto", footer, left=["candidate"])


def _title(metrics: Metrics, what: str) -> str:
    unit = content.in_unit(content.unit(metrics))
    return f"{content.heading(metrics)} · {what}; test {content.merit(metrics)}{unit}"


def _footer(metrics: Metrics) -> list[str]:
    outputs = ", ".join(output["name"] for output in metrics["outputs"])
    lines = [f"members: {content.counts(metrics)}", content.source(metrics)]
    return [*lines, f"figures are means over the outputs {outputs}"] if len(metrics["outputs"]) > 1 else lines
