"""The whole of a discovery: recalibrate, locate, name, judge, add, prove. Nothing here writes a file.

record, physics ──> recalibrated ──> correction signal ──> search ──> verdict ──> test record, once
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.acceleration.background import ahead
from pgrssnn_jax.discovery.beyond import Beyond, for_corrections, look_beyond
from pgrssnn_jax.discovery.cuts import cut, in_one
from pgrssnn_jax.discovery.estimate import Guess, Settings, evaluate, fit_all
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.linear import left_out, look_linear
from pgrssnn_jax.discovery.look import look_at
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.precompile import compile_look
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem
from pgrssnn_jax.discovery.prove import (
    Merit,
    Proof,
    fitted_nominal,
    fitted_start,
    merit_for,
    prove,
    recalibrated_from_spread,
)
from pgrssnn_jax.discovery.search import Found, search
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.discovery.smoother import Correction, smoothed_correction
from pgrssnn_jax.discovery.stretches import end_to_end
from pgrssnn_jax.discovery.unknown import Formula, flexible_problem, formula
from pgrssnn_jax.discovery.verdict import Judged, judge
from pgrssnn_jax.records.record import Record

_STEPS = 12  # of a fit to stretches: they are nearly linear
_ROUGH, _FINE = 1e-3, 1e-6  # tolerance: candidates differ by far more, the final numbers are fitted to the end
_LANES = 4  # fits to stretches at a time, on as many devices
_SPARE = 14  # numbers that such fits have places for: compiling takes longer than the places that stay empty
_LOCATED = 24  # sequences or stretches whose correction is estimated


class Proofs(NamedTuple):
    """The same record by the nominal physics, recalibrated, and with what was found."""

    before: Proof
    recalibrated: Proof
    after: Proof


class Discovery(NamedTuple):
    """Everything that was found out.

    signals and estimation: sequences of the record, uncut; located: its sequences whose correction was
    estimated; correction: of the recalibrated physics; x: its states there; without: test proofs of the final model
    without each effect in turn.
    """

    problem: Problem
    signals: Signals
    estimation: Record
    found: Found
    beyond: Beyond
    judged: Judged
    formula: Formula | None
    located: Signals
    correction: Correction
    x: Float[np.ndarray, "seq time x"]
    train: Proofs
    test: Proofs
    without: dict[str, Proof]
    merit: Merit
    seconds: dict[str, float]


def discover(setup: Setup, notify: Callable[[str], None]) -> Discovery:
    """Of a physics whose free run over the record stays finite (`check_free_run`)."""
    chosen = setup.settings
    problem = build_problem(setup.physics, setup.effects, fixed=chosen.fixed, accelerate=chosen.accelerate)
    return discover_in(problem, setup.estimation, setup.test, setup.settings, notify, start=setup.start)


def discover_in(
    problem: Problem,
    estimation: Record,
    test: Record,
    chosen: DiscoverySettings,
    notify: Callable[[str], None],
    *,
    start: Start,
    flexible: Problem | None = None,
) -> Discovery:
    """flexible: that of `flexible_problem(problem)` where many records are examined with one physics."""
    seconds: dict[str, float] = {}
    rng = np.random.default_rng(chosen.seed)
    in_stretches = bool(chosen.stretches)
    settings = Settings(steps=chosen.steps, devices=jax.device_count())
    if in_stretches:
        lanes = min(_LANES, settings.devices)
        settings = Settings(_SPARE, lanes, min(chosen.steps, _STEPS), _ROUGH, lanes)
    with jax.enable_x64(True), ExitStack() as stack:
        cuts = [cut(problem, estimation, chosen, stage, start) for stage in range(max(1, len(chosen.stretches)))]
        record, uncut = cuts[0], in_one(problem, estimation, chosen, start)
        whole = estimation._replace(u=uncut.u, y=uncut.y, mask=uncut.weight > 0)
        with _timed(seconds, "recalibrate"):
            looks: dict[str, Callable[[], None]] = {}
            if flexible is None and not in_stretches and chosen.accelerate:
                looks["name"] = partial(compile_look, problem, record, settings)
                flexible = flexible_problem(problem)
                wide = cut(flexible, estimation, chosen, 0, start)
                looks["judge"] = partial(compile_look, flexible, wide, for_corrections(settings))
            compiled = stack.enter_context(ahead(looks))
            given = fitted_nominal(problem, record, settings)
            begun = given
            if len(problem.of(None)):
                begun = recalibrated_from_spread(problem, record, given, settings, rng, chosen.starts)
            hold = _as_known(problem, record, begun, None if in_stretches else chosen.tolerance)
            problem = hold(problem)
        with _timed(seconds, "name"):
            compiled("name")
            common = {"settings": settings, "rules": chosen.rules, "rng": rng, "without": chosen.without}
            if in_stretches:
                examine = partial(look_linear, problem, cuts, whole=uncut, **common)
                found = search(problem, begun, chosen.rules._replace(beam=0), notify, examine)
                found = _polished(problem, estimation, chosen, found, settings, start)
            else:
                found = search(problem, begun, chosen.rules, notify, partial(look_at, problem, record, **common))
        with _timed(seconds, "locate"):
            located, x, correction = _located(problem, record, found, len(record.u) // len(uncut.u))
        with _timed(seconds, "judge"):
            compiled("judge")
            flexible = hold(flexible or flexible_problem(problem))
            beyond, wide = look_beyond(problem, flexible, estimation, found, chosen, settings, rng, start)
            before = evaluate(problem, record, given).cost
            judged = judge(problem, found, beyond, before, chosen.rules, chosen.seed)
            told = None
            if judged.unexplained is not None:
                stage, best = judged.unexplained
                _, states = simulate(flexible, wide.u, best.guess.theta[None], best.guess.x0[None])
                told = formula(flexible, wide, stage, best, states[0])
        with _timed(seconds, "prove"):
            merit = merit_for(test, 0 if start is not Start.UNKNOWN else chosen.n_init)
            guesses = [given, found.recalibrated.guess, found.final.guess]
            train = Proofs(
                *(prove(problem, whole, g, uncut.start if in_stretches else g.x0, merit_for(whole, 0)) for g in guesses)
            )

            def on_test(guess: Guess) -> Proof:
                return prove(problem, test, guess, _test_start(problem, test, guess, chosen, settings, start), merit)

            tested = Proofs(*map(on_test, guesses))
            without = {name: on_test(stage.base.guess) for name, stage in found.stages.items()}
    return Discovery(
        problem,
        uncut,
        whole,
        found,
        beyond,
        judged,
        told,
        located,
        correction,
        x,
        train,
        tested,
        without,
        merit,
        seconds,
    )


def _polished(
    problem: Problem, estimation: Record, chosen: DiscoverySettings, found: Found, settings: Settings, start: Start
) -> Found:
    """The final numbers fitted to ever longer stretches of all sequences. Their spread over folds is that on the
    shortest: of the longest a few whose sensitivities grow without limit decide, and would make it far too small."""
    active, theta = found.final.estimate.active, found.final.estimate.theta
    places = np.concatenate([problem.of(name) for name in (None, *active)])
    places = places[np.isfinite(theta[places])]
    spread = np.zeros((1, len(theta)))
    for stage in range(len(chosen.stretches)):
        every = cut(problem, estimation, chosen, stage, start, searched=False)
        ((fitted, _),) = fit_all(
            problem, every, [Guess(active, theta, every.start)], settings._replace(tolerance=_FINE)
        )
        theta = fitted.theta
        if stage == 0:
            folds = left_out(problem, every, fitted, places).folds
            spread = np.where(np.isfinite(theta), folds - np.where(np.isfinite(theta), folds, 0.0).mean(0), 0.0)
    estimate = found.final.estimate._replace(theta=theta)
    return found._replace(final=found.final._replace(estimate=estimate, folds=theta + spread))


def _located(problem: Problem, record: Signals, found: Found, pieces: int) -> tuple[Signals, np.ndarray, Correction]:
    """The correction signal of the recalibrated physics on the first sequences; pieces: stretches of each."""
    count = pieces * max(1, _LOCATED // pieces)
    few = Signals(*(a[:count] for a in record))
    base = found.recalibrated.estimate
    x0, error = base.x0[:count], base.error[:count]
    _, x = simulate(problem, few.u, base.theta[None], x0[None])
    correction = smoothed_correction(problem, few, base.theta, x[0], x0, error, found.noise**0.5)
    correction = correction._replace(mean=end_to_end(correction.mean, pieces), std=end_to_end(correction.std, pieces))
    u, y, weight, block = (end_to_end(a, pieces, axis=0) for a in few[:4])
    whole = Signals(u, y, weight, block, few.start[::pieces], few.precision[::pieces])
    return whole, end_to_end(x[0], pieces, axis=0), correction


def _test_start(
    problem: Problem, test: Record, guess: Guess, chosen: DiscoverySettings, settings: Settings, start: Start
) -> Float[np.ndarray, "seq x"]:
    if start is Start.AT_REST:
        return np.zeros((len(test.u), guess.x0.shape[1]))
    if start is Start.SHARED:
        return np.broadcast_to(guess.x0[:1], (len(test.u), guess.x0.shape[1]))
    return fitted_start(problem, test, guess, chosen.n_init, settings)


def _as_known(problem: Problem, record: Signals, begun: Guess, tolerance: float | None) -> Callable[[Problem], Problem]:
    """Problems whose physics has a prior; the noise is what a free refit leaves."""
    if tolerance is None:
        return lambda same: same
    noise = noise_floor(evaluate(problem, record, begun).error, record.weight) / max(1, int((record.weight > 0).sum()))
    return lambda other: other.held(tolerance, noise)


def check_free_run(setup: Setup) -> None:
    """Raises `ValueError` when the nominal physics cannot be simulated over the record."""
    with jax.enable_x64(True):
        problem = build_problem(setup.physics, ())
        record = cut(problem, setup.estimation, setup.settings, 0, setup.start)
        _, x = simulate(problem, record.u, problem.theta[None], record.start[None])
    finite = np.isfinite(x[0]).all((0, 2))
    if not finite.all():
        raise ValueError(
            f"physics {setup.physics.name!r}: expected a free run that stays finite over the record, found states "
            f"beyond the floating-point range from sample {int(np.argmin(finite))} on"
        )


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started
