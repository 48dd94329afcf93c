"""The search for effects: the physics recalibrated, effects selected, and once more with elaborate ones."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.estimate import Guess, evaluate
from pgrssnn_jax.discovery.further import Carry, elaborate_counts, further_effects, with_first_fits
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.recalibrate import nominal_guess, recalibrated_guess
from pgrssnn_jax.discovery.scoring import Scoring, scoring
from pgrssnn_jax.discovery.select import Screenings, Selection, remembered, select
from pgrssnn_jax.discovery.settings import Criteria, DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.effects.base import Effect

Notify = Callable[[str], None]


class Named(NamedTuple):
    """A problem with its record and the effects selected in it. known: puts the prior of the physics on problems;
    nominal, recalibrated: the physics without effects; screenings: of this search, by the effects of their base."""

    problem: Problem
    how: Scoring
    known: Callable[[Problem], Problem]
    nominal: Guess
    recalibrated: Guess
    screenings: Screenings
    selection: Selection


def search(problem: Problem, setup: Setup, notify: Notify, seconds: dict[str, float]) -> Named:
    """The physics recalibrated, and the effects of the problem that are missing."""
    chosen = setup.settings
    how = scoring(problem, setup.estimation, chosen, setup.start, np.random.default_rng(chosen.seed))
    with timed(seconds, "recalibrate"):
        nominal = nominal_guess(problem, how.signals(problem), how.settings)
        recalibrated = recalibrated_guess(problem, how.signals(problem), nominal, how.settings, chosen)
        known = _as_known(problem, how, recalibrated, chosen)
    problem = known(problem)
    criteria, screenings = _criteria(how, chosen), Screenings()
    screened = remembered(how.screen(problem, chosen.without, criteria), screenings, notify)
    with timed(seconds, "name"):
        selection = select(problem, recalibrated, criteria, screened)
    return Named(problem, how, known, nominal, recalibrated, screenings, selection)


def with_elaborate_effects(
    first: Named,
    setup: Setup,
    corrected: Corrected,
    notify: Notify,
    seconds: dict[str, float],
    *,
    missing: bool = False,
) -> Named:
    """A second search, with the elaborate effects, where the first one leaves errors above the noise, or a correction
    without a name shows that something is missing. It is repeated where its errors show a spectral line for the first
    time: of a disturbance behind a backlash, say."""
    named, tried = first, {effect.name for effect in first.problem.effects if effect.elaborate}
    while further := [effect for effect in _further(named, setup, missing) if effect.name not in tried]:
        why = "no effect explains the errors" if missing else "errors stay above the noise"
        notify(f"{why}: looking for {', '.join(effect.name for effect in further)} too")
        tried |= {effect.name for effect in further}
        wanted = [effect for effect in setup.effects if not effect.elaborate or effect.name in tried]
        whole = named.known(corrected.with_catalogue(named.problem, tuple(wanted)))
        again = _on_segments if named.how.segmented else _going_on
        named = again(named, whole, setup, notify, seconds)
    return named


def _further(named: Named, setup: Setup, missing: bool) -> list[Effect]:
    problem, selection, criteria = named.problem, named.selection, setup.settings.criteria
    return further_effects(problem, named.how.signals(problem), selection, setup.effects, criteria, missing=missing)


def _going_on(first: Named, whole: Problem, setup: Setup, notify: Notify, seconds: dict[str, float]) -> Named:
    """The second search of whole records, from the fits of the first."""
    how, chosen = first.how, setup.settings
    carry, criteria = Carry(first.problem, whole, how.signals(whole).start), _criteria(how, chosen)
    screen, screenings = how.screen(whole, chosen.without, criteria), Screenings()
    screened = remembered(with_first_fits(screen, first.screenings, carry), screenings, notify)
    nominal, recalibrated = carry.guess(first.nominal), carry.guess(first.recalibrated)
    with timed(seconds, "name"):
        selection = select(whole, recalibrated, criteria, screened)
    return Named(whole, how, first.known, nominal, recalibrated, screenings, selection)


def _on_segments(first: Named, whole: Problem, setup: Setup, notify: Notify, seconds: dict[str, float]) -> Named:
    """Searched anew, where an elaborate effect counts beside those found."""
    how, plain = first.how, [effect.name for effect in setup.first_effects]
    carry, criteria = Carry(first.problem, whole, how.signals(whole).start), _criteria(how, setup.settings)
    counts = elaborate_counts(how, whole, first.selection, carry, plain, criteria)
    return search(whole, setup, notify, seconds) if counts else first


def finished(named: Named, seconds: dict[str, float]) -> Named:
    """With what a selection still needs before it is judged (`Scoring.finish`)."""
    with timed(seconds, "numbers"):
        return named._replace(selection=named.how.finish(named.problem, named.selection))


def _criteria(how: Scoring, chosen: DiscoverySettings) -> Criteria:
    return chosen.criteria._replace(beam=0) if how.segmented else chosen.criteria


def _as_known(problem: Problem, how: Scoring, begun: Guess, chosen: DiscoverySettings) -> Callable[[Problem], Problem]:
    """Problems whose physics has a prior; the noise is what a free refit leaves."""
    if chosen.tolerance is None or how.segmented:
        return lambda same: same
    tolerance, record = chosen.tolerance, how.signals(problem)
    noise = noise_floor(evaluate(problem, record, begun).error, record.weight) / record.size
    return lambda other: other.held(tolerance, noise)


@contextmanager
def timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started
