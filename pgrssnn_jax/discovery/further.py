"""The second search: elaborate effects too, where the first search leaves errors for them to explain.

What the first search has fitted stays fitted: the same effects beside the same models are not fitted again.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.candidates import Candidate, Model, Screening
from pgrssnn_jax.discovery.estimate import Guess, signal_range_of
from pgrssnn_jax.discovery.problem import Problem, Signals, carried
from pgrssnn_jax.discovery.scoring import Scoring, Screen
from pgrssnn_jax.discovery.select import Screenings, Selection, active_in, counting
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.base import Effect


def further_effects(
    problem: Problem,
    signals: Signals,
    selection: Selection,
    effects: Sequence[Effect],
    criteria: Criteria,
    *,
    missing: bool = False,
) -> list[Effect]:
    """Elaborate effects whose fits have somewhere to begin, where there are errors for them to explain: more than the
    noise, or a line, which is seen well before it adds a tenth to the errors; missing: it is known that there are."""
    span = signal_range_of(problem, signals, selection.last.base.estimate.guess)
    if not missing and not span.lines and selection.last.rms(selection.final) <= criteria.above * selection.floor:
        return []
    return [effect for effect in effects if effect.elaborate and effect.guesses(span)]


class Carry(NamedTuple):
    """From the problem of the first search to that of the second; start `[seq, x]`: of states that only the second
    has."""

    first: Problem
    whole: Problem
    start: Float[np.ndarray, "seq x"]

    def guess(self, one: Guess) -> Guess:
        return Guess(one.active, *carried(self.first, self.whole, one.theta, one.x0, self.start))

    def model(self, one: Model) -> Model:
        estimate, deviation = one.estimate, np.zeros(len(self.whole.theta))
        _, theta, x0 = self.guess(estimate.guess)
        spread, _ = carried(self.first, self.whole, one.deviation, estimate.x0, self.start)
        free = np.concatenate([self.whole.of(name) for name in (None, *estimate.active)])
        deviation[free] = spread[free]
        return one._replace(estimate=estimate._replace(theta=theta, x0=x0), deviation=deviation)

    def candidate(self, one: Candidate) -> Candidate:
        return one._replace(guess=self.guess(one.guess), model=one.model and self.model(one.model))


def with_first_fits(screen: Screen, first: Screenings, carry: Carry) -> Screen:
    """The screening of the second search, which goes on from those of the first."""

    def screened(base: Guess | Model) -> Screening:
        same = first.get(tuple(sorted(active_in(base))))
        if same is None:
            return screen(base)
        return screen(carry.model(same.base), known=[carry.candidate(c) for c in same.candidates])

    return screened


def elaborate_counts(
    how: Scoring, whole: Problem, selection: Selection, carry: Carry, plain: Sequence[str], criteria: Criteria
) -> bool:
    """Is an elaborate effect selected beside the effects already found? whole: the problem with the entire catalogue;
    plain: names of the others. One screening takes seconds, a second search in segments minutes."""
    last = selection.last.base.estimate.guess
    screening = how.screen(whole, plain, criteria)(how.fitted(whole, carry.guess(last)))
    return counting(whole, criteria, selection.first, screening)
