"""How models are fitted and scored: on whole records, or on segments of them that grow longer the more is known."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from pgrssnn_jax.discovery.candidates import Model, Screening, score_candidates
from pgrssnn_jax.discovery.estimate import Guess, Settings, fit_all
from pgrssnn_jax.discovery.linear import score_linearised, segment_model
from pgrssnn_jax.discovery.problem import Problem, Signals, weighted_signals
from pgrssnn_jax.discovery.select import Selection
from pgrssnn_jax.discovery.settings import Criteria, DiscoverySettings
from pgrssnn_jax.discovery.setup import Start
from pgrssnn_jax.discovery.stretches import stretches
from pgrssnn_jax.records.record import Record, take

_SEARCHED = (12, 24)  # sequences in which effects are looked for, first and beside others; their numbers see all
_STEPS = 12  # of a fit to segments: they are nearly linear
_ROUGH, _FINE = 1e-3, 1e-6  # tolerance: candidates differ by far more, the final numbers are fitted to the end
_LANES = 4  # fits to segments at a time, on as many devices
_SPARE = 14  # numbers that such fits have places for: compiling takes longer than the places that stay empty

Screen = Callable[[Guess | Model], Screening]


class Scoring(NamedTuple):
    """segmented: on segments; signals: of a problem, as fits with so many `effects` see them; uncut: sequences in which
    effects are looked for, in one piece; screen: of a problem, without the effects named; finish: the final numbers."""

    segmented: bool
    settings: Settings
    signals: Callable[..., Signals]
    uncut: Signals
    screen: Callable[[Problem, Sequence[str], Criteria], Screen]
    finish: Callable[[Problem, Selection], Selection]


def scoring(
    problem: Problem, estimation: Record, chosen: DiscoverySettings, start: Start, rng: np.random.Generator
) -> Scoring:
    return (_on_segments if chosen.stretches else _on_whole_records)(problem, estimation, chosen, start, rng)


def _on_whole_records(
    problem: Problem, estimation: Record, chosen: DiscoverySettings, start: Start, rng: np.random.Generator
) -> Scoring:
    settings = Settings(steps=chosen.steps, devices=jax.device_count())

    def signals(problem: Problem, effects: int) -> Signals:
        return weighted_signals(problem, estimation, folds=chosen.folds, block=chosen.block)

    def screen(problem: Problem, without: Sequence[str], criteria: Criteria) -> Screen:
        common = {"settings": settings, "criteria": criteria, "rng": rng, "without": without}
        return partial(score_candidates, problem, signals(problem, 0), **common)

    return Scoring(False, settings, signals, signals(problem, 0), screen, lambda problem, selection: selection)


def _on_segments(
    problem: Problem, estimation: Record, chosen: DiscoverySettings, start: Start, rng: np.random.Generator
) -> Scoring:
    lanes = min(_LANES, jax.device_count())
    settings = Settings(_SPARE, lanes, min(chosen.steps, _STEPS), tolerance=_ROUGH, devices=lanes)
    longest = len(chosen.stretches) - 1

    def signals(problem: Problem, effects: int, *, every: bool = False) -> Signals:
        stage = min(effects, longest)
        count = len(estimation.u) if every else _SEARCHED[min(stage, len(_SEARCHED) - 1)]
        record = take(estimation, np.arange(min(len(estimation.u), count)))
        return stretches(problem, record, chosen.stretches[stage], chosen.folds, at_rest=start is Start.AT_REST)

    def whole(problem: Problem) -> Signals:
        record = take(estimation, np.arange(min(len(estimation.u), _SEARCHED[0])))
        return stretches(problem, record, estimation.u.shape[1], chosen.folds, at_rest=start is Start.AT_REST)

    def screen(problem: Problem, without: Sequence[str], criteria: Criteria) -> Screen:
        segments = [signals(problem, stage) for stage in range(longest + 1)]
        common = {"settings": settings, "criteria": criteria, "rng": rng, "without": without}
        return partial(score_linearised, problem, segments, whole=whole(problem), **common)

    def finish(problem: Problem, selection: Selection) -> Selection:
        """Fitted to ever longer segments of all sequences. Deviations are those on the shortest: of the longest a few
        whose sensitivities grow without limit decide, and would make them far too small."""
        final = selection.final
        theta, deviation = final.estimate.theta, final.deviation
        for stage in range(longest + 1):
            every = signals(problem, stage, every=True)
            guess = Guess(final.estimate.active, theta, every.start)
            ((fitted, _),) = fit_all(problem, every, [guess], settings._replace(tolerance=_FINE))
            theta = fitted.theta
            if stage == 0:
                places = np.concatenate([problem.of(name) for name in (None, *final.estimate.active)])
                places = places[np.isfinite(theta[places])]
                deviation = segment_model(problem, every, fitted, places, whole(problem)).deviation
        estimate = final.estimate._replace(theta=theta)
        return selection._replace(final=final._replace(estimate=estimate, deviation=deviation))

    return Scoring(True, settings, signals, whole(problem), screen, finish)
