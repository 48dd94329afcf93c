"""Does the order of the paper's variants hold here?

Two variants are told apart by the paper where their published means differ by more than 2 standard errors of the
measured means, 2 sqrt(s_a²/n_a + s_b²/n_b). Such a pair holds where the measured means stand in the same order. The
physics alone draws nothing at random: its one member has s = 0.
"""

import math
from itertools import combinations

from pgrssnn_jax.paper.published import Paper
from pgrssnn_jax.paper.rows import NOTABLE, EvidenceTable, Row


def order_held(table: EvidenceTable, paper: Paper) -> tuple[int, int]:
    """How many pairs hold, and how many the paper tells apart; without those that too few members have finished of."""
    rows = [(row, row.published.mean) for row in table.measured if row.published and row.published.mean is not None]
    held = told_apart = 0
    for (a, published_a), (b, published_b) in combinations(rows, 2):
        error = math.hypot(_standard_error(a, paper), _standard_error(b, paper))
        if a.variant != b.variant and abs(published_a - published_b) > NOTABLE * error:
            told_apart += 1
            held += (published_a - published_b) * (a.figures.mean - b.figures.mean) > 0
    return held, told_apart


def _standard_error(row: Row, paper: Paper) -> float:
    """NaN for fewer than two members, unless the physics is alone."""
    known = paper.models.get(row.variant.model)
    if known and known.kind == "physics" and len(row.finished) == 1:
        return 0.0
    return row.figures.std / math.sqrt(len(row.finished))


def order_lines(table: EvidenceTable, paper: Paper) -> list[str]:
    """How far the order of the paper holds, in one sentence; none where it tells no two rows apart."""
    held, told_apart = order_held(table, paper)
    return [
        f"Order of the paper: {told_apart} pairs of rows differ there by more than {NOTABLE:g} standard errors of the "
        f"measured means; {held} of these stand in the same order here."
    ] * bool(told_apart)
