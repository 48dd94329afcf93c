"""What the test record leaves of a judgement: final numbers, validation, and what they refute."""

from typing import NamedTuple

from pgrssnn_jax.discovery.correction_on_test import improvement_by_correction
from pgrssnn_jax.discovery.identify import Numbers, final_numbers
from pgrssnn_jax.discovery.judged import Judged, with_judgement, without_names
from pgrssnn_jax.discovery.noise import above_white_noise, longest_memory
from pgrssnn_jax.discovery.null import LEAST_GAIN
from pgrssnn_jax.discovery.search import Named, timed
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.discovery.validate import Proved, train_validations, validations_on_test
from pgrssnn_jax.discovery.verdict import (
    Verdict,
    as_good_as_names,
    clear_of_noise,
    judge,
    refuted_names,
    without_correction,
)

_FOUND = (Verdict.UNKNOWN_EFFECT, Verdict.UNEXPLAINED)  # something is missing, whatever its name


class Tested(NamedTuple):
    """refuted: names of effects, or of a correction, that are left out."""

    named: Named
    judged: Judged
    numbers: Numbers
    proved: Proved
    refuted: tuple[str, ...]


def tested(named: Named, judged: Judged, setup: Setup, seconds: dict[str, float]) -> Tested:
    """Effects or a correction that the test record refutes are left out, where something is missing without them, too:
    a finding of theirs alone is not confirmed."""
    numbers, proved = _proved(named, setup, seconds)
    with timed(seconds, "prove"):
        criteria, correction = setup.settings.criteria, ()
        names = _refuted_names(named, judged, proved, criteria)
        if not names:
            judged, correction = _without_refuted_correction(named, judged, setup)
            judged, names = _with_better_correction(named, judged, setup, proved)
            names = names or _refuted_names(named, judged, proved, criteria)
        if not names:
            return Tested(named, judged, numbers, proved, correction)
        bare, alone = without_names(named, judged, setup.settings)
        alone, further = _without_refuted_correction(bare, alone, setup)
    if alone.judgement.verdict not in _FOUND:
        return Tested(named, judged, numbers, proved, correction)
    refuted = tuple(dict.fromkeys((*names, *correction, *further)))  # a correction may be refuted twice
    return Tested(bare, alone, *_proved(bare, setup, seconds), refuted)


def _refuted_names(named: Named, judged: Judged, proved: Proved, criteria: Criteria) -> tuple[str, ...]:
    """Where corrections in the place of the names were looked for."""
    if judged.nameless.alone is None:
        return ()
    test, clear = proved.test, clear_of_noise(named.selection, proved.least_error, proved.floor, criteria).test
    return refuted_names(judged.judgement, test.improvement, test.relative, clear=clear)


def _with_better_correction(
    named: Named, judged: Judged, setup: Setup, proved: Proved
) -> tuple[Judged, tuple[str, ...]]:
    """Named effects that predict the estimation record no better than a correction in their place, and the test record
    worse, stand for an unknown effect. The judgement that says so, and their names. Where errors have a memory and do
    not follow the signals, one record holds too few independent ones to compare."""
    selection, criteria = named.selection, setup.settings.criteria
    rival, final = as_good_as_names(judged.judgement, selection, judged.nameless, criteria), selection.final.estimate
    weight, maybe_noise = named.how.signals(named.problem).weight, judged.judgement.verdict is Verdict.EFFECT_FOUND
    if rival is None or (maybe_noise and above_white_noise(final.error, weight, criteria.clear)):
        return judged, ()
    low, _ = improvement_by_correction(judged.corrections, rival[1], named.nominal, final.guess, setup)
    if low <= criteria.exact * max(proved.test.recalibrated.error - proved.floor, 0.0):
        return judged, ()
    judgement = judged.judgement._replace(verdict=Verdict.UNKNOWN_EFFECT, unnamed=rival)
    return with_judgement(named, judged, judgement), tuple(judgement.alternatives)


def _without_refuted_correction(named: Named, judged: Judged, setup: Setup) -> tuple[Judged, tuple[str, ...]]:
    """The judgement, if its correction without a name predicts the test record better, or there is none; else without
    it, and its name. Of several corrections that say the same on the estimation record (a curve of the input, or in the
    only equation with that input) and go on differently beyond it, the first that does."""
    if judged.judgement.unnamed is None or named.how.segmented:
        return judged, ()
    (screening, chosen), final = judged.judgement.unnamed, named.selection.final.estimate.guess
    fitted = [one for one in screening.candidates if one.model and one is not chosen]
    for one in (chosen, *(other for other in fitted if abs(other.score - chosen.score) <= LEAST_GAIN)):
        low, _ = improvement_by_correction(judged.corrections, one, named.nominal, final, setup)
        if low > 0.0:
            return with_judgement(named, judged, judged.judgement._replace(unnamed=(screening, one))), ()
    rest = judged.nameless.without_corrections(), judged.rms, setup.settings.criteria, judged.convention
    again = without_correction(judge(named.problem, named.selection, *rest))
    return with_judgement(named, judged, again), (chosen.name,)


def _proved(named: Named, setup: Setup, seconds: dict[str, float]) -> tuple[Numbers, Proved]:
    """Final numbers, and all models on the estimation record uncut and on the test record."""
    problem, how, selection, chosen = named.problem, named.how, named.selection, setup.settings
    with timed(seconds, "numbers"):
        numbers = final_numbers(problem, how, selection, chosen.tolerance, chosen.criteria)
    with timed(seconds, "prove"):
        guesses = (named.nominal, numbers.recalibrated.estimate.guess, numbers.final.estimate.guess)
        whole = setup.estimation._replace(u=how.uncut.u, y=how.uncut.y, mask=how.uncut.weight > 0)
        memory = longest_memory(numbers.final.estimate.error)
        train = train_validations(problem, whole, guesses, how.uncut.start if how.segmented else None)
        test = validations_on_test(problem, setup, guesses, numbers.without, how.settings, memory)
    return numbers, Proved(whole, train, test)
