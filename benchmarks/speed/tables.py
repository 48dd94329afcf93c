"""What was measured as tables: for the terminal, and as Markdown between two marks of a page."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from .goals import GOALS, Measured

_BEGIN, _END = "<!-- measured: begin -->", "<!-- measured: end -->"
Rows = list[tuple[str, ...]]


def tables(found: Mapping[str, Any]) -> Iterator[tuple[str, Rows]]:
    """Title and rows, the first of which is the head; ratios first, bare times second."""
    measured = found["measured"]
    machines = ", ".join(dict.fromkeys(one["cpu"] for one in measured.values()))
    yield f"Ratios, each from one run on {machines}", ratios(measured)
    yield "The roof; *reached* is the longest of the three bounds over the time measured", roofs(measured)
    yield "The machine, measured", rates(measured)
    for part, one in measured.items():
        yield f"{part} (peak memory {one['peak_memory_mb']:.0f} MB)", times(one["figures"])


def ratios(measured: Measured) -> Rows:
    rows: Rows = [("what", "measured", "goal")]
    for goal in GOALS:
        ratio = goal.ratio(measured)
        if ratio is not None:
            met = "" if goal.reached(ratio) else ", missed"
            wanted = "" if goal.goal is None else f"{'≥' if goal.more else '≤'} {goal.goal:g}{met}"
            rows.append((goal.what, number(ratio), wanted))
    return rows


def roofs(measured: Measured) -> Rows:
    rows: Rows = [("case", "GFLOP", "products, ms", "memory, ms", "chain, ms", "measured, ms", "reached", "bound")]
    for part, one in measured.items():
        for name, figures in one["figures"].items():
            if (roof := figures.get("roof")) and not part.startswith(("grid", "mappings")):
                bounds = [number(roof[bound]) for bound in ("products", "memory", "chain")]
                reached = f"{100 * roof['reached']:.0f} %"
                ms = number(figures["ms"][0])
                rows.append((f"{part}: {name}", number(roof["gflop"]), *bounds, ms, reached, roof["bound"]))
    return rows


def rates(measured: Measured) -> Rows:
    """Of the first part that ran on one core, and on two."""
    columns = {}
    for one in measured.values():
        if one.get("machine"):
            columns.setdefault(one["cores"], one["machine"])
    names = list(dict.fromkeys(name for rate in columns.values() for name in rate))
    head = ("rate", *(f"{cores} core{'s' if cores > 1 else ''}" for cores in columns))
    return [head, *((name, *(number(rate[name]) for rate in columns.values())) for name in names)]


def times(figures: Mapping[str, Any]) -> Rows:
    rows: Rows = [("case", "median", "quartiles", "compiled in, s", "programs", "memory, MB")]
    for name, found in figures.items():
        if "ms" not in found:
            rows.append((name, "not run", "", "", "", number(found["memory_mb"])))
            continue
        unit, factor = next((u, f) for u, f, most in _UNITS if found["ms"][0] < most)
        median, low, high = (number(factor * ms) for ms in found["ms"])
        more = (number(found[key]) if key in found else "" for key in ("compile_s", "compilations", "memory_mb"))
        rows.append((name, f"{median} {unit}", f"{low} to {high}", *more))
    return rows


_UNITS = (("µs", 1e3, 1.0), ("ms", 1.0, 1e4), ("s", 1e-3, float("inf")))


def number(value: float) -> str:
    """Three digits that count."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def show(found: Mapping[str, Any]) -> None:
    console = Console(width=150)
    for title, (head, *rows) in tables(found):
        if rows:
            table = Table(title=title, title_justify="left")
            for i, column in enumerate(head):
                table.add_column(column, justify="right" if i else "left")
            for row in rows:
                table.add_row(*row)
            console.print(table)


def write(found: Mapping[str, Any], page: Path) -> None:
    """Ratios, roof and machine into a page, between its marks. Raises `ValueError` where it has none."""
    replace_between(page, _BEGIN, _END, f"\n\n{page_text(found)}\n\n")


def page_text(found: Mapping[str, Any]) -> str:
    return "\n\n".join(markdown(title, rows) for title, rows in list(tables(found))[:3] if len(rows) > 1)


def replace_between(page: Path, begin: str, end: str, text: str) -> None:
    """The part of a page between two lines becomes `text`. Raises `ValueError` for a page without these lines."""
    before, first, rest = page.read_text(encoding="utf-8").partition(begin)
    _, last, after = rest.partition(end)
    if not first or not last:
        raise ValueError(f"{page}: expected the lines {begin} and {end}, found none")
    page.write_text(f"{before}{begin}{text}{end}{after}", encoding="utf-8")


def markdown(title: str, rows: Rows) -> str:
    head, *rest = rows
    lines = [head, ("---", *("---:" for _ in head[1:])), *rest]
    return f"{title}:\n\n" + "\n".join("| " + " | ".join(line) + " |" for line in lines)
