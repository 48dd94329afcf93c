"""A table before it is printed: one object that a terminal, a notebook, a page and a Markdown file show.

Each row is a look and its cells. Looks: headline (the row to read first), failed, partial (some members failed),
quoted, and gap, which parts the rows around it and may say why.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from pgrssnn_jax.reports.content import Content, shown
from pgrssnn_jax.reports.markup import Markup, folded, html, tag

STYLES = {"headline": "bold", "failed": "red", "partial": "yellow", "quoted": "italic"}
WORDS = ("status", "reason", "output", "unit", "variant", "folder", "state")  # at the left of a page's column

Row = tuple[str, Sequence[Content]]


class Table(NamedTuple):
    """footer: lines below it in the terminal; left: the columns that stand at the left there; wrap: where the terminal
    is too narrow, cells are broken rather than cut."""

    header: Sequence[str]
    rows: Sequence[Row]
    title: str = ""
    footer: Sequence[str] = ()
    left: Sequence[str] = ("status", "output", "unit")
    wrap: bool = False

    def only(self, names: Sequence[str]) -> "Table":
        """The table with these columns."""
        kept = [list(self.header).index(name) for name in names]
        return self._replace(header=names, rows=[(look, [cells[k] for k in kept]) for look, cells in self.rows])

    def __rich__(self) -> RichTable:
        """The table for the terminal; square brackets are no markup."""
        title, footer = Text(self.title, "bold"), Text("\n".join(self.footer))
        table = RichTable(title=title, caption=footer, box=box.SIMPLE_HEAD, collapse_padding=True)
        table.title_justify = table.caption_justify = "left"
        for name in self.header:
            side, overflow = "left" if name in self.left else "right", "fold" if self.wrap else "ellipsis"
            table.add_column(Text(name), justify=side, no_wrap=not self.wrap, overflow=overflow)
        for look, cells in self.rows:
            if look == "gap":
                table.add_section()
            else:
                table.add_row(*(Text(shown(cell)) for cell in cells), style=STYLES.get(look, ""))
        return table

    def html(self) -> Markup:
        """The table for a page, where it scrolls by itself if it is wider; title and footer stand elsewhere."""
        head = tag("tr", *(_cell("th", name, name) for name in self.header))
        body = [self._html_row(look, cells) for look, cells in self.rows if cells]
        return tag("div", tag("table", tag("thead", head), tag("tbody", Markup("\n".join(body)))), look="scroll")

    def _repr_html_(self) -> Markup:
        """The table in a notebook, with its title and footer."""
        return html((tag("p", tag("strong", self.title)), self.html(), *(tag("p", line) for line in self.footer)))

    def _html_row(self, look: str, cells: Sequence[Content]) -> Markup:
        if look == "gap":
            return tag("tr", tag("td", *cells, colspan=str(len(self.header))), look=look)
        return tag("tr", *(_cell("td", cell, name) for cell, name in zip(cells, self.header, strict=True)), look=look)

    def markdown(self, escaped: Callable[[str], str]) -> str:
        lines = [_pipes(map(escaped, self.header)), "|:---|" + "---:|" * (len(self.header) - 1)]
        for look, cells in self.rows:
            name, *rest = (escaped(shown(cell)) for cell in cells)
            lines.append(_pipes([f"*{name}*" if look == "quoted" else name, *rest]))
        return "\n".join(lines)


def folded_table(table: Table, most: int) -> Content:
    """A table that shows its first rows alone where it has more than `most`, and all of them folded away."""
    if len(table.rows) <= most:
        return table.html()
    return table._replace(rows=table.rows[:most]).html(), folded(f"All {len(table.rows)} rows", table.html())


def _cell(name: str, content: Content, column: str) -> Markup:
    return tag(name, content, look="words" if column in WORDS else "")


def _pipes(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"
