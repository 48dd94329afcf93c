"""Does what the paper says of its variants hold here: their order, and which beats which with little data?

Two variants are told apart by the paper where their published means differ by more than 2 standard errors of the
measured means, 2 sqrt(s_a²/n_a + s_b²/n_b). Such a pair holds where the measured means stand in the same order. The
physics alone draws nothing at random: its one member has s = 0.
"""

import math
from itertools import combinations
from typing import NamedTuple

from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import NOTABLE, EvidenceTable, Row
from pgrssnn_jax.reports.content import rounded


class Pair(NamedTuple):
    """Two variants of which `better` has the lower published mean; errors: their measured distance (worse - better) in
    standard errors, infinite where both have none."""

    better: Row
    worse: Row
    errors: float


class Ordering(NamedTuple):
    """Pairs of variants with a published mean. close: too near in the paper to be told apart; unknown: too few members
    have finished."""

    held: list[Pair]
    turned: list[Pair]
    close: int
    unknown: int


def ordering(table: EvidenceTable, paper: Paper) -> Ordering:
    rows = [row for row in table.rows if row.state != "quoted" and row.published and row.published.mean is not None]
    held, turned, close, unknown = [], [], 0, 0
    for a, b in combinations(rows, 2):
        if a.variant == b.variant:
            continue
        better, worse = (a, b) if _published(a) <= _published(b) else (b, a)
        error = math.hypot(_standard_error(a, paper), _standard_error(b, paper))
        distance = worse.figures.mean - better.figures.mean
        if not math.isfinite(error + distance):
            unknown += 1
        elif _published(worse) - _published(better) <= NOTABLE * error or _published(worse) == _published(better):
            close += 1
        else:
            errors = distance / error if error else math.copysign(math.inf, distance)
            (held if distance > 0 else turned).append(Pair(better, worse, errors))
    return Ordering(held, turned, close, unknown)


def _published(row: Row) -> float:
    assert row.published is not None
    assert row.published.mean is not None
    return row.published.mean


def _standard_error(row: Row, paper: Paper) -> float:
    known = paper.models.get(row.variant.model)
    if known and known.kind == "physics" and len(row.finished) == 1:
        return 0.0
    return row.figures.std / math.sqrt(len(row.finished)) if row.finished else math.nan


def order_lines(table: EvidenceTable, paper: Paper) -> list[str]:
    """How far the order of the paper holds, in sentences; the pairs that are turned round one by one."""
    found = ordering(table, paper)
    judged = len(found.held) + len(found.turned)
    pairs = judged + found.close + found.unknown
    if not pairs:
        return []
    unknown = f", {found.unknown} cannot be judged because too few members have finished" if found.unknown else ""
    lines = [
        f"Order of the paper: of {pairs} pairs of rows with a published mean, {judged} differ there by more than "
        f"{NOTABLE:g} standard errors of the measured means; {len(found.held)} of these stand in the same order here, "
        f"{len(found.turned)} are turned round. {found.close} are too close to tell{unknown}."
    ]
    lines += [
        f"Turned round: {pair.better.label} before {pair.worse.label} in the paper ({_published(pair.better):.2f}, "
        f"{_published(pair.worse):.2f}), here {rounded(pair.better.figures.mean)} against "
        f"{rounded(pair.worse.figures.mean)}, {abs(pair.errors):.1f} standard errors."
        for pair in found.turned
    ]
    return lines


def beats_lines(table: EvidenceTable, paper: Paper) -> list[str]:
    """What the paper says of its data-efficiency figure, and whether it holds."""
    if table.beats is None:
        return []
    model, others, size = table.beats
    small = {row.variant.model: row for row in table.rows if row.variant.n_train == size}
    lines = []
    for other in others:
        a, b = small.get(model), small.get(other)
        claim = f"With {size} samples {paper.title(model)} is better than {paper.title(other)} in the paper"
        if a is None or b is None or a not in table.measured or b not in table.measured:
            lines.append(f"{claim}; that cannot be judged here: a run is missing.")
            continue
        merits = ((table.merit.upper(), a.figures.mean, b.figures.mean, -1), ("CC", a.figures.cc, b.figures.cc, 1))
        found = (
            f"{'yes' if sign * (mine - its) > 0 else 'NO'} in {merit} ({rounded(mine)} against {rounded(its)})"
            for merit, mine, its, sign in merits
        )
        lines.append(f"{claim}; here {', '.join(found)}.")
    return lines
