"""The tables of many runs for LaTeX: floats with booktabs rules, and nothing that needs another package.

\\usepackage{booktabs}   in the preamble,   \\input{tables.tex}   in the document
"""

import re
from collections.abc import Iterable, Sequence

from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable
from pgrssnn_jax.paper.tables import one_line, problems, rule, table_of
from pgrssnn_jax.reports.content import MISSING, shown

_LEFT_OUT = ("failed", "time")  # members says as much, and the cost stands elsewhere
_SIGNS = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"$<$", ">": r"$>$", "|": r"$|$", "±": r"$\pm$",
    "²": r"$^2$", "·": r"$\cdot$", "†": r"$^\dagger$", "–": r"\textendash{}", "…": r"\dots{}", "−": r"$-$", '"': "''",
    "[": "{[}", "*": "{*}",
}  # fmt: skip


def latex(tables: Sequence[EvidenceTable], paper: Paper) -> str:
    head = "% \\usepackage{booktabs} in the preamble, \\input{tables.tex} in the document\n"
    return head + "\n".join(_float(table, paper) for table in tables)


def _float(table: EvidenceTable, paper: Paper) -> str:
    whole = table_of(table)
    made = whole.only([name for name in whole.header if name not in _LEFT_OUT])
    rows = []
    for look, cells in made.rows:
        name, *figures = (_figure(shown(cell)) for cell in cells)
        rows.append([rf"\textit{{{name}}}" if look == "quoted" else name, *figures])
    quoted = ["† quoted from the literature."] if any(look == "quoted" for look, _ in made.rows) else []
    below = map(escaped, [*quoted, *rule(table, paper), *problems(table)])
    caption = f"{table.title}: {table.heading}, beside the figures of {paper.source}."
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering\scriptsize\setlength{\tabcolsep}{2.5pt}",
            f"  \\caption{{{escaped(caption)}}}\\label{{tab:{table.slug}}}",
            f"  \\makebox[\\linewidth][c]{{\\begin{{tabular}}{{l{'r' * (len(made.header) - 1)}}}",
            r"    \toprule",
            _line(map(escaped, made.header)),
            r"    \midrule",
            *map(_line, rows),
            r"    \bottomrule",
            r"  \end{tabular}}",
            *(f"  \\par\\smallskip\\parbox{{\\linewidth}}{{\\scriptsize {text}}}" for text in below),
            r"\end{table}",
            "",
        ]
    )


def _line(texts: Iterable[str]) -> str:
    return "    " + " & ".join(texts) + r" \\"


def _figure(cell: str) -> str:
    """A cell; a bare number becomes one of LaTeX's, whose minus is a minus."""
    return f"${cell}$" if cell != MISSING and re.fullmatch(r"[+-]?[\d.]+(e[+-]\d+)?", cell) else escaped(cell)


def escaped(text: str) -> str:
    """Text as it stands; a letter that plain LaTeX has no glyph for becomes a question mark."""
    known = "".join(_SIGNS.get(c) or (c if c.isascii() or "À" <= c <= "ÿ" else "?") for c in one_line(text))
    return known.replace("--", "-{}-")  # two hyphens would become a dash
