"""The tables of many runs for LaTeX: floats with booktabs rules, and nothing that needs another package.

\\usepackage{booktabs}   in the preamble,   \\input{tables.tex}   in the document
"""

import re
from collections.abc import Sequence

from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import EvidenceTable, Row
from pgrssnn_jax.paper.tables import cells, header, problems, rule
from pgrssnn_jax.reports.content import MISSING
from pgrssnn_jax.reports.tables import one_line

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
    names = header(table)
    shown = [k for k, name in enumerate(names) if name not in _LEFT_OUT]

    def line(texts: Sequence[str]) -> str:
        return "    " + " & ".join(texts[k] for k in shown) + r" \\"

    def shown_row(row: Row) -> str:
        name, *figures = map(_figure, cells(row, table))
        return line([rf"\textit{{{name}}}" if row.state == "quoted" else name, *figures])

    rows = [shown_row(row) for row in table.rows]
    below = [escaped(text) for text in [*rule(table, paper), *problems(table)]]
    quoted = [escaped("† quoted from the literature.")] if any(row.state == "quoted" for row in table.rows) else []
    caption = f"{table.title}: {table.heading}, beside the figures of {paper.source}."
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering\scriptsize\setlength{\tabcolsep}{2.5pt}",
            f"  \\caption{{{escaped(caption)}}}\\label{{tab:{table.slug}}}",
            f"  \\makebox[\\linewidth][c]{{\\begin{{tabular}}{{l{'r' * (len(shown) - 1)}}}",
            r"    \toprule",
            line([escaped(name) for name in names]),
            r"    \midrule",
            *rows,
            r"    \bottomrule",
            r"  \end{tabular}}",
            *(f"  \\par\\smallskip\\parbox{{\\linewidth}}{{\\scriptsize {text}}}" for text in [*quoted, *below]),
            r"\end{table}",
            "",
        ]
    )


def _figure(cell: str) -> str:
    """A cell; a bare number becomes one of LaTeX's, whose minus is a minus."""
    return f"${cell}$" if cell != MISSING and re.fullmatch(r"[+-]?[\d.]+(e[+-]\d+)?", cell) else escaped(cell)


def escaped(text: str) -> str:
    """Text as it stands; a letter that plain LaTeX has no glyph for becomes a question mark."""
    known = "".join(_SIGNS.get(c) or (c if c.isascii() or "À" <= c <= "ÿ" else "?") for c in one_line(text))
    return known.replace("--", "-{}-")  # two hyphens would become a dash
