"""A table before it is printed: one object that a terminal, a notebook, a page and a Markdown file show.

Each row is a look and its cells. Looks: headline (the row to read first), failed, partial (some members failed),
quoted.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from pgrssnn_jax.reports.markup import Markup, bullets, folded, html, tag

STYLES = {"headline": "bold", "failed": "red", "partial": "yellow", "quoted": "italic"}
#: at the left of a page's column
WORDS = ("status", "reason", "output", "unit", "variant", "folder", "state", "candidate")

Row = tuple[str, Sequence[str]]


class Table(NamedTuple):
    """footer: lines below it; left: the columns that stand at the left in a terminal; wrap: where the terminal is too
    narrow, cells are broken rather than cut; most: rows to show at first, all if None."""

    header: Sequence[str]
    rows: Sequence[Row]
    title: str = ""
    footer: Sequence[str] = ()
    left: Sequence[str] = ("status", "output", "unit")
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
            table.add_row(*(Text(cell) for cell in cells), style=STYLES.get(look, ""))
        return table

    def html(self) -> Markup:
        """Title, table and footer for a page; of a long table all rows are folded away."""
        parts = [tag("h3", self.title)] if self.title else []
        parts.append(self._html_rows(self.rows[: self.most]))
        if len(self.rows) > len(self.rows[: self.most]):
            parts.append(folded(f"All {len(self.rows)} rows", self._html_rows(self.rows)))
        return html((*parts, bullets(self.footer, look="notes") if self.footer else ""))

    _repr_html_ = html

    def _html_rows(self, rows: Sequence[Row]) -> Markup:
        looks = ["words" if name in WORDS else "" for name in self.header]

        def line(kind: str, cells: Sequence[str], look: str = "") -> Markup:
            return tag("tr", *(tag(kind, cell, look=of) for cell, of in zip(cells, looks, strict=True)), look=look)

        body = "\n".join(line("td", cells, look) for look, cells in rows)
        return tag(
            "div", tag("table", tag("thead", line("th", self.header)), tag("tbody", Markup(body))), look="scroll"
        )

    def markdown(self, escaped: Callable[[str], str]) -> str:
        lines = [_pipes(map(escaped, self.header)), "|:---|" + "---:|" * (len(self.header) - 1)]
        for look, cells in self.rows:
            name, *rest = map(escaped, cells)
            lines.append(_pipes([f"*{name}*" if look == "quoted" else name, *rest]))
        return "\n".join(lines)


def _pipes(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"
