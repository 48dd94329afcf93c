"""The verdict on the estimation record: names beside corrections without a name, and the same without the names."""

from typing import NamedTuple

import numpy as np

from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.estimate import evaluate
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.nameless import Nameless, line_and_dependence, look_beyond
from pgrssnn_jax.discovery.nonparametric import Corrections
from pgrssnn_jax.discovery.search import Named
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.unknown import Formula, formula
from pgrssnn_jax.discovery.verdict import Judgement, judge, reading_convention


class Judged(NamedTuple):
    """formula: of a correction without a name; convention: an effect that is none, but a way of reading; rms: weighted
    error of the nominal physics."""

    corrections: Corrections
    nameless: Nameless
    rms: float
    judgement: Judgement
    formula: Formula | None
    convention: str | None


def judged_on_estimation(named: Named, corrected: Corrected, chosen: DiscoverySettings) -> Judged:
    """Nonparametric corrections beside the names, and the verdict."""
    problem, how, selection = named.problem, named.how, named.selection
    active = tuple(sorted({*selection.final.estimate.active, *selection.last.base.estimate.active}))
    corrections = Corrections(problem, corrected, active, named.known, how.signals, how.settings)
    nameless = look_beyond(corrections, how, selection, chosen.criteria, np.random.default_rng(chosen.seed))
    before = evaluate(problem, how.signals(problem), named.nominal)
    rms = (before.cost / selection.first.size) ** 0.5
    convention = reading_convention(problem, selection.final)
    judgement = judge(problem, selection, nameless, rms, chosen.criteria, convention)
    return Judged(corrections, nameless, rms, judgement, _formula(corrections, named, judgement), convention)


def with_judgement(named: Named, judged: Judged, judgement: Judgement) -> Judged:
    """Another judgement, with the formula of its correction."""
    return judged._replace(judgement=judgement, formula=_formula(judged.corrections, named, judgement))


def without_names(named: Named, judged: Judged, chosen: DiscoverySettings) -> tuple[Named, Judged]:
    """The recalibrated physics alone. A correction that was found in the place of the names stays; else the verdict is
    given anew."""
    alone, selection = judged.nameless.alone, named.selection
    assert alone is not None
    selection = selection._replace(final=selection.recalibrated, screenings={}, last=selection.first)
    bare, rng = named._replace(selection=selection), np.random.default_rng(chosen.seed)
    left = line_and_dependence(named.problem, named.how, selection, chosen.criteria, rng)
    judged = judged._replace(nameless=Nameless(alone, None, *left), convention=None)
    unnamed = judged.judgement.unnamed
    if unnamed is not None and unnamed[0] is alone:
        return bare, judged._replace(judgement=judged.judgement._replace(alternatives={}))
    judgement = judge(named.problem, selection, judged.nameless, judged.rms, chosen.criteria)
    return bare, with_judgement(bare, judged, judgement)


def _formula(corrections: Corrections, named: Named, judgement: Judgement) -> Formula | None:
    """Of a correction without a name."""
    if judgement.unnamed is None:
        return None
    how, (screening, best) = named.how, judgement.unnamed
    flexible = corrections.by_all() if how.segmented else corrections.by(best.name)
    signals = how.signals(flexible)
    guess = best.model.estimate if best.model else best.guess
    _, x = simulate(flexible, signals.u, guess.theta[None], guess.x0[None])
    return formula(flexible, signals, screening, best, x[0])
