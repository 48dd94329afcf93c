"""What a suite of cases says: shares with Wilson's 95 % intervals, by system, kind and noise.

    share = (k + z²/2 ± z √(k (n - k) / n + z²/4)) / (n + z²),   z = 1.96

A false finding is effect_found, ambiguous or unknown_effect where nothing is missing. Unexplained is counted apart, and
not_confirmed is no finding. Source: Wilson, J. Am. Stat. Assoc. 22 (1927).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table

from .case import Case
from .noise import KINDS as NOISES
from .suite import KINDS

FINDINGS = ("effect_found", "ambiguous", "unknown_effect")
_Z = 1.96
Row = dict[str, Any]


def is_right(case: Case, kind: str, names: Sequence[str], verdict: str) -> bool:
    if kind == "unnamed":  # another method has to find its class: as strict
        return verdict == "unknown_effect" and not names
    if kind == "removed":
        return verdict in ("unknown_effect", "unexplained", "ambiguous")
    if kind == "none":
        return not names and verdict in ("no_discrepancy", "miscalibrated")
    matched = [any(name in accepted for name in names) for accepted in case.accepted]
    return all(matched) and len(names) == len(matched) and verdict in ("effect_found", "ambiguous")


def wilson(k: int, n: int) -> tuple[float, float]:
    """Lowest and highest share that k of n is compatible with."""
    half = _Z * (k * (n - k) / n + _Z**2 / 4) ** 0.5
    return (k + _Z**2 / 2 - half) / (n + _Z**2), (k + _Z**2 / 2 + half) / (n + _Z**2)


def share(k: int, n: int) -> str:
    if not n:
        return "–"
    low, high = wilson(k, n)
    return f"{k}/{n} ({100 * low:.0f}–{100 * high:.0f} %)"


def scores(rows: Sequence[Row]) -> Table:
    """Per system and kind all noises together, then each."""
    columns = ("system", "kind", "noise", "right", "right name first", "false findings", "not told")
    table = Table(*columns, "intervals that cover", "median s", title="95 % binomial intervals")
    for system in dict.fromkeys(row["system"] for row in rows):
        for kind in KINDS:
            own = [row for row in rows if row["system"] == system and row["kind"] == kind]
            there = [noise for noise in NOISES if any(row["noise_kind"] == noise for row in own)]
            for noise in ["all", *there] if len(there) > 1 else there:
                some = [row for row in own if noise in ("all", row["noise_kind"])]
                table.add_row(system, kind, noise, *_figures(some, kind))
        table.add_section()
    return table


def _right_model(row: Row) -> bool:
    """Where nothing is missing, any verdict without a name: `unexplained` is about the noise."""
    if row["kind"] == "none":
        return not row["names"]
    return row["right"] and row["kind"] != "removed"


def _figures(rows: Sequence[Row], kind: str) -> tuple[str, ...]:
    n, verdicts = len(rows), [row["verdict"] for row in rows]
    first = sum(row["first"] for row in rows)
    false = share(sum(verdict in FINDINGS for verdict in verdicts), n) if kind == "none" else ""
    apart = ("ambiguous", "unexplained", "not_confirmed")
    told = ", ".join(f"{verdicts.count(one)} {one}" for one in apart if one in verdicts)
    covered = [abs(d) <= 1 for row in rows if _right_model(row) for d in row["distances"].values()]
    return (
        share(sum(row["right"] for row in rows), n),
        share(first, n) if kind in ("single", "double") else "",
        false,
        told,
        share(sum(covered), len(covered)),
        f"{np.median([row['seconds'] for row in rows]):.1f}",
    )
