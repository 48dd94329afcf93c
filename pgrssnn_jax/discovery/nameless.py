"""Is there more than the named effects, or something better than they? Nonparametric corrections, a spectral line, and
whether the errors depend on the signals at all.

Whole records: corrections beside what was found and in its place. Segments: beside it, because one of a single joint
does not take the place of an effect on all of them.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.discovery.candidates import Model, Screening
from pgrssnn_jax.discovery.estimate import Guess
from pgrssnn_jax.discovery.follows import Follows, follows
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.problem import Problem, Signals, carried
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.unknown import Line, spectral_line


class Nameless(NamedTuple):
    """Screenings of the nonparametric corrections beside the named effects and beside nothing; a line in the spectrum
    of the errors; how far errors clearly above the noise depend on the signals."""

    beside: Screening
    alone: Screening | None
    line: Line | None
    follows: Follows | None


def look_beyond(
    problem: Problem,
    flexible: Problem,
    signals: Signals,
    wide: Signals,
    selection: Selection,
    criteria: Criteria,
    rng: np.random.Generator,
    screen: Callable[[Guess], Screening],
    *,
    segments: bool,
) -> Nameless:
    """flexible: the problem with the corrections; signals, wide: the record of both; screen: of the corrections."""

    def guess(model: Model) -> Guess:
        theta, x0 = carried(problem, flexible, model.estimate.theta, model.estimate.x0, wide.start)
        return Guess(model.estimate.active, theta, x0)

    final = selection.final
    beside = screen(guess(final))
    if segments:
        return Nameless(beside, None, None, None)
    alone = screen(guess(selection.recalibrated)) if final.estimate.active else None
    if selection.last.rms() <= criteria.clear * selection.floor:
        return Nameless(beside, alone, None, None)
    _, x = simulate(problem, signals.u, final.estimate.theta[None], final.estimate.x0[None])
    driven = follows(signals, x[0][..., : len(problem.physics.states)], final.estimate.error, rng)
    return Nameless(beside, alone, spectral_line(signals, final.estimate.error, problem.physics.dt), driven)
