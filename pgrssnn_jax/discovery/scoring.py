"""How models are fitted and scored: on whole records, or on segments of them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from pgrssnn_jax.discovery.candidates import Model, Screening, fitted_models, score_candidates, settled
from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate, fit_all
from pgrssnn_jax.discovery.limits import without_idle_limits
from pgrssnn_jax.discovery.linear import score_linearised, segment_model, whole_runs
from pgrssnn_jax.discovery.problem import Problem, Signals, weighted_signals
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria, DiscoverySettings
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.stretches import stretches
from pgrssnn_jax.records.record import Record, take

_SEARCHED = 12  # sequences in which effects are looked for; their numbers see all
_STEPS = 12  # of a fit to segments: they are nearly linear
_TOLERANCE = 1e-3  # candidates differ by far more; dry friction makes the cost uneven below that
_SPARE = 30  # numbers that such fits have places for: compiling takes longer than the places that stay empty

Screen = Callable[..., Screening]  # of a guess or a model


class Scoring(NamedTuple):
    """segmented: on segments; signals: of a problem, while effects are looked for; uncut: sequences in which they are
    looked for, in one piece; screen: of a problem, without the effects named; finish: what a selection still needs
    (idle limits go, rivals are fitted to the end, segments are fitted anew); fitted: the model of a guess that is at
    its optimum."""

    segmented: bool
    settings: Settings
    signals: Callable[..., Signals]
    uncut: Signals
    screen: Callable[[Problem, Sequence[str], Criteria], Screen]
    finish: Callable[[Problem, Selection], Selection]
    fitted: Callable[[Problem, Guess], Model]


def scoring(
    problem: Problem, estimation: Record, chosen: DiscoverySettings, start: Start, rng: np.random.Generator
) -> Scoring:
    return (_on_segments if chosen.stretches else _on_whole_records)(problem, estimation, chosen, start, rng)


def _on_whole_records(
    problem: Problem, estimation: Record, chosen: DiscoverySettings, start: Start, rng: np.random.Generator
) -> Scoring:
    settings = Settings(steps=chosen.steps, devices=jax.device_count())

    def signals(problem: Problem) -> Signals:
        return weighted_signals(problem, estimation, folds=chosen.folds, block=chosen.block)

    def screen(problem: Problem, without: Sequence[str], criteria: Criteria) -> Screen:
        common = {"settings": settings, "criteria": criteria, "rng": rng, "without": without}
        return partial(score_candidates, problem, signals(problem), **common)

    def fitted(problem: Problem, guess: Guess) -> Model:
        (model,) = fitted_models(problem, signals(problem), [guess], settings, chosen.criteria.block)
        return model

    def finish(problem: Problem, selection: Selection) -> Selection:
        record, criteria = signals(problem), chosen.criteria
        selection = without_idle_limits(problem, record, selection, settings, criteria)
        done = {n: settled(problem, record, one, settings, criteria) for n, one in selection.screenings.items()}
        return _at_its_best(problem, selection._replace(screenings=done))

    return Scoring(False, settings, signals, signals(problem), screen, finish, fitted)


def _at_its_best(problem: Problem, selection: Selection) -> Selection:
    """The final model where it fits best: each of its effects was fitted anew beside the others."""

    def cost(model: Model) -> float:
        return model.estimate.cost + problem.penalty(model.estimate.theta)

    again = [
        c.model for name, one in selection.screenings.items() for c in one.candidates if c.name == name and c.model
    ]
    best = min([selection.final, *again], key=cost)
    return selection._replace(final=best, last=selection.last._replace(base=best))


def _on_segments(
    problem: Problem, estimation: Record, chosen: DiscoverySettings, start: Start, rng: np.random.Generator
) -> Scoring:
    devices = jax.device_count()  # which share the segments of one fit
    settings = Settings(_SPARE, 1, min(chosen.steps, _STEPS), tolerance=_TOLERANCE, devices=devices)
    searched, *more = chosen.stretches
    few, at_rest = take(estimation, np.arange(min(len(estimation.u), _SEARCHED))), start is Start.AT_REST

    def segments(problem: Problem, record: Record, length: int) -> Signals:
        return stretches(problem, record, length, chosen.folds, at_rest=at_rest)

    def signals(problem: Problem) -> Signals:
        return segments(problem, few, searched)

    def whole(problem: Problem) -> Signals:
        return segments(problem, few, estimation.u.shape[1])

    def screen(problem: Problem, without: Sequence[str], criteria: Criteria) -> Screen:
        common = {"settings": settings, "criteria": criteria, "rng": rng, "without": without}
        return partial(score_linearised, problem, signals(problem), whole=whole(problem), **common)

    def refitted(problem: Problem, signals: Signals, model: Model) -> Guess:
        """In a program of its own, whatever it has places for, because these segments have other lengths."""
        guess = Guess(model.estimate.active, model.estimate.theta, signals.start)
        ((found, _),) = fit_all(problem, signals, [guess], settings._replace(spare=Settings().spare))
        return found

    def finish(problem: Problem, selection: Selection) -> Selection:
        """Fitted to other segments, the last of all sequences. Over short ones dry friction leaves the error smooth and
        sensitivities bounded, so that a fit comes near and says how sure it is; long ones say more."""
        final = selection.final
        for length in more[:-1]:
            signals = segments(problem, few, length)
            final = segment_model(problem, signals, refitted(problem, signals, final), whole(problem))
        every = segments(problem, estimation, (more or [searched])[-1])
        guess = refitted(problem, every, final)
        runs = whole_runs(problem, whole(problem), guess)
        deviation = final.deviation * (len(few.u) / len(estimation.u)) ** 0.5
        final = final._replace(estimate=evaluate(problem, every, guess), deviation=deviation, free_run=runs)
        beside = selection.last.base._replace(free_run=runs)
        return selection._replace(final=final, last=selection.last._replace(base=beside))

    def fitted(problem: Problem, guess: Guess) -> Model:
        return segment_model(problem, signals(problem), guess, whole(problem))

    return Scoring(True, settings, signals, whole(problem), screen, finish, fitted)
