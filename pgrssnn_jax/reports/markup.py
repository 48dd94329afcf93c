"""Pieces of HTML: numbers that carry their exact value, tables, embedded images. All text is escaped here."""

import base64
import struct
from collections.abc import Sequence
from html import escape
from pathlib import Path

from pgrssnn_jax.reports import content, tables
from pgrssnn_jax.reports.content import MISSING, MemberRow, Metrics, Number, SummaryRow, rounded
from pgrssnn_jax.reports.tables import OutputRow

WORDS = ("status", "reason", "output", "unit", "variant", "folder", "state")  # columns that stand at the left
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def number(value: Number | None, shown: str | None = None) -> str:
    """A number for people that carries its unrounded value; a dash for what is not a number."""
    text = str(value) if isinstance(value, int) else rounded(value)
    exact = value if value is None or isinstance(value, int) else float(value)
    return text if text == MISSING else f'<data value="{exact!r}">{escape(shown or text)}</data>'


def value(mean: float, std: float) -> str:
    """A number ± its deviation."""
    spread = content.plus_minus(mean, std).partition(" ± ")[2]
    return number(mean) + (f" ± {number(std, spread)}" if spread else "")


def table(header: Sequence[str], rows: Sequence[str]) -> str:
    """A table that scrolls by itself where it is wider than the page; `rows` as `row` makes them."""
    head = "".join(_cell("th", escape(name), name) for name in header)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>\n'


def row(header: Sequence[str], cells: Sequence[str], look: str = "") -> str:
    """One table row; `cells` are markup already."""
    inner = "".join(_cell("td", cell, name) for name, cell in zip(header, cells, strict=True))
    return f'<tr class="{look}">{inner}</tr>\n' if look else f"<tr>{inner}</tr>\n"


def summary_table(metrics: Metrics) -> str:
    """All members together, one row per n_init."""

    def one(r: SummaryRow) -> str:
        cells = [str(r.n_init), *map(number, (r.mean, r.std, r.median, r.best, r.ensemble, r.nrmse))]
        return row(tables.SUMMARY_HEADER, cells, "headline" if r.headline else "")

    return table(tables.SUMMARY_HEADER, [one(r) for r in content.summary_rows(metrics)])


def member_table(metrics: Metrics, limit: int) -> str:
    """Members from best to worst, then failed ones; of more than `limit` a selection, and all of them folded away."""

    def one(r: MemberRow) -> str:
        words = [escape(cell) for cell in tables.member_cells(r)]
        cells = [*words[:4], *map(number, (r.rmse, r.nrmse, r.fit_percent, r.cc)), words[-1]]
        return row(header, cells, "failed" if r.failed else "")

    header, rows = tables.MEMBER_HEADER, content.member_rows(metrics)
    shown = tables.select(rows, limit)
    if not shown.left_out:
        return table(header, [one(r) for r in (*shown.best, *shown.worst, *shown.failed)])
    text = f"{shown.left_out} of {len(rows)} members left out here ({shown.left_out_failed} of them failed)"
    gap = f'<tr class="gap"><td colspan="{len(header)}">{text}</td></tr>\n'
    short = [*map(one, shown.best), gap, *map(one, (*shown.worst, *shown.failed))]
    finished, failed = content.ranked(rows)
    whole = table(header, [one(r) for r in (*finished, *failed)])
    return f"{table(header, short)}<details><summary>All {len(rows)} members</summary>{whole}</details>\n"


def output_table(metrics: Metrics) -> str:
    """One row per output."""
    header = tables.OUTPUT_HEADER

    def one(r: OutputRow) -> str:
        words = [escape(cell) for cell in tables.output_cells(r)]
        return row(header, [*words[:2], *map(number, (r.rmse, r.nrmse, r.fit_percent, r.cc))])

    return table(header, [one(r) for r in tables.output_rows(metrics)])


def image(path: Path, alt: str) -> str:
    """A PNG file as an element that holds the file itself."""
    raw = path.read_bytes() if path.is_file() else b""
    if not raw.startswith(PNG_SIGNATURE) or len(raw) < 24:
        raise ValueError(f"write_page: figures: expected a PNG file, found {path}")
    width, height = struct.unpack(">II", raw[16:24])
    source = f"data:image/png;base64,{base64.b64encode(raw).decode('ascii')}"
    return f'<img alt="{escape(alt)}" width="{width}" height="{height}" src="{source}">'


def folded(title: str, text: str) -> str:
    """Preformatted text behind a heading that opens it."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>\n"


def _cell(tag: str, inner: str, name: str) -> str:
    words = ' class="words"' if name in WORDS else ""
    return f"<{tag}{words}>{inner}</{tag}>"
