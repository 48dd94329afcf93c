"""Is there more than the named effects, or something better than they? Nonparametric corrections, a spectral line, and
whether the errors depend on the signals at all.

Whole records: corrections beside what was found and in its place. Segments: beside it, because one of a single joint
does not take the place of an effect on all of them.
"""

from typing import NamedTuple

import numpy as np

from pgrssnn_jax.discovery.candidates import Screening
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.follows import Follows, errors_follow
from pgrssnn_jax.discovery.line import line_beside_noise
from pgrssnn_jax.discovery.nonparametric import CURVED, Corrections, score_corrections
from pgrssnn_jax.discovery.problem import Problem, carried
from pgrssnn_jax.discovery.scoring import Scoring
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.spectrum import Line


class Nameless(NamedTuple):
    """Screenings of the nonparametric corrections beside the named effects and beside nothing; a line in the spectrum
    of the errors; how far errors clearly above the noise depend on the signals."""

    beside: Screening
    alone: Screening | None
    line: Line | None
    follows: Follows | None

    def without_corrections(self) -> "Nameless":
        return self._replace(beside=self.beside._replace(candidates=()), alone=None)


def look_beyond(
    corrections: Corrections, how: Scoring, selection: Selection, criteria: Criteria, rng: np.random.Generator
) -> Nameless:
    if how.segmented:
        return Nameless(_on_segments(corrections, how, selection, criteria), None, None, None)
    final, active = selection.final, bool(selection.final.estimate.active)
    least = least_fall(selection, criteria, criteria.nameless if active else criteria.share)
    beside = score_corrections(corrections, final, criteria, least, rng)
    alone = None
    if active:  # in the place of the named effects it must do better than they
        least = selection.first.rms() - selection.last.rms() + least_fall(selection, criteria, criteria.share)
        alone = score_corrections(corrections, selection.recalibrated, criteria, least, rng)
    return Nameless(beside, alone, *line_and_dependence(corrections.problem, how, selection, criteria, rng))


def line_and_dependence(
    problem: Problem, how: Scoring, selection: Selection, criteria: Criteria, rng: np.random.Generator
) -> tuple[Line | None, Follows | None]:
    """A line in the spectrum of the errors of the final model, and how far they follow the signals."""
    estimate, signals = selection.final.estimate, how.uncut
    clear = selection.last.rms() > criteria.clear * selection.floor
    line = line_beside_noise(problem, signals, estimate, how.settings, criteria, clear=clear)
    return line, errors_follow(problem, signals, estimate, rng) if clear else None


def least_fall(selection: Selection, criteria: Criteria, share: float) -> float:
    """Fall of the weighted RMS error below that of the names, by which a correction shows that they miss something: a
    share of the gap, or most of the rest, as for an effect."""
    gap, left = (max(one.rms() - selection.floor, 0.0) for one in (selection.first, selection.last))
    if selection.final.free_run is not None:  # the free run over sequences has errors of its own scale
        return share * gap
    return max(min(share * gap, criteria.rest * left), criteria.exact * gap)


def _on_segments(corrections: Corrections, how: Scoring, selection: Selection, criteria: Criteria) -> Screening:
    problem, wide = corrections.problem, corrections.by_all()
    signals, last = corrections.signals(wide), selection.last.base.estimate
    theta, x0 = carried(problem, wide, last.theta, last.x0, signals.start)
    screen = how.screen(wide, [effect.name for effect in problem.effects], criteria)
    return screen(how.fitted(wide, Guess(last.active, theta, x0)), least=criteria.share / CURVED)
