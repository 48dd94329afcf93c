"""The whole of a discovery: recalibrate, locate, name, judge, add, prove. Nothing here writes a file.

record, physics ──> recalibrated ──> correction signal ──> search ──> verdict ──> test record, once
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.estimate import Guess, Settings
from pgrssnn_jax.discovery.least_squares import simulate
from pgrssnn_jax.discovery.noise import noise_floor
from pgrssnn_jax.discovery.problem import Problem, Signals, build_problem, signals
from pgrssnn_jax.discovery.prove import (
    Merit,
    Proof,
    fitted_as_given,
    fitted_start,
    merit_for,
    prove,
    recalibrated_from_spread,
)
from pgrssnn_jax.discovery.search import Found, search
from pgrssnn_jax.discovery.setup import DiscoverySettings, Setup
from pgrssnn_jax.discovery.smoother import Correction, smoothed_correction
from pgrssnn_jax.discovery.unknown import Formula, flexible_problem, formula, look_beyond, spectral_line
from pgrssnn_jax.discovery.verdict import Beyond, Judged, judge
from pgrssnn_jax.effects.catalogue import catalogue
from pgrssnn_jax.records import Record


class Proofs(NamedTuple):
    """The same record by the physics as given, recalibrated, and with what was found."""

    before: Proof
    recalibrated: Proof
    after: Proof


class Discovery(NamedTuple):
    """Everything that was found out. correction: of the recalibrated physics; x: its states on the estimation record;
    without: test proofs of the final model without each effect in turn."""

    problem: Problem
    signals: Signals
    found: Found
    beyond: Beyond
    judged: Judged
    formula: Formula | None
    correction: Correction
    x: Float[np.ndarray, "seq time x"]
    given: Guess
    train: Proofs
    test: Proofs
    without: dict[str, Proof]
    merit: Merit
    train_merit: Merit
    seconds: dict[str, float]


def discover(setup: Setup, notify: Callable[[str], None]) -> Discovery:
    """Raises `ValueError` when the physics as given cannot be simulated over the record."""
    problem = build_problem(setup.physics, catalogue(setup.physics))
    return discover_in(problem, setup.estimation, setup.test, setup.settings, notify, shared=setup.shared)


def discover_in(
    problem: Problem,
    estimation: Record,
    test: Record,
    chosen: DiscoverySettings,
    notify: Callable[[str], None],
    *,
    shared: bool,
    flexible: Problem | None = None,
) -> Discovery:
    """flexible: that of `flexible_problem(problem)` where many records are examined with one physics."""
    seconds: dict[str, float] = {}
    rng = np.random.default_rng(chosen.seed)
    settings = Settings(steps=chosen.steps, devices=jax.device_count())
    with jax.enable_x64(True):
        record = signals(problem, estimation, folds=chosen.folds, block=chosen.block)
        with _timed(seconds, "recalibrate"):
            _check_free_run(problem, record)
            given = fitted_as_given(problem, record, settings)
            start = recalibrated_from_spread(problem, record, given, settings, rng, chosen.starts)
        with _timed(seconds, "name"):
            found = search(problem, record, start, settings, chosen.rules, rng, notify, chosen.without)
        with _timed(seconds, "locate"):
            base = found.recalibrated.estimate
            _, x = simulate(problem, record.u, base.theta[None], base.x0[None])
            noise = (found.floor / max(1, int((record.weight > 0).sum()))) ** 0.5
            correction = smoothed_correction(problem, record, base.theta, x[0], base.x0, base.error, noise)
        with _timed(seconds, "judge"):
            flexible = flexible or flexible_problem(problem)
            wide = signals(flexible, estimation, folds=chosen.folds, block=chosen.block)
            beyond = _beyond(problem, flexible, wide, found, settings, chosen, rng)
            before = prove(problem, estimation, given, given.x0, merit_for(estimation, 0))
            energy = float(((record.weight * (record.y - before.y))[record.weight > 0] ** 2).sum())
            judged = judge(problem, found, beyond, energy, chosen.rules, chosen.seed)
            told = None
            if judged.unexplained is not None:
                stage, best = judged.unexplained
                _, states = simulate(flexible, wide.u, best.guess.theta[None], best.guess.x0[None])
                told = formula(flexible, wide, stage, best, states[0])
        with _timed(seconds, "prove"):
            merit = merit_for(test, 0 if shared else chosen.n_init)
            guesses = [given, found.recalibrated.guess, found.final.guess]
            train = Proofs(*(prove(problem, estimation, g, g.x0, merit_for(estimation, 0)) for g in guesses))

            def on_test(guess: Guess) -> Proof:
                x0 = guess.x0[:1] if shared else fitted_start(problem, test, guess, chosen.n_init, settings)
                return prove(problem, test, guess, np.broadcast_to(x0, (len(test.u), x0.shape[1])), merit)

            tested = Proofs(*map(on_test, guesses))
            without = {name: on_test(stage.base.guess) for name, stage in found.stages.items()}
    return Discovery(
        problem, record, found, beyond, judged, told, correction, x[0], given, train, tested, without, merit,
        merit_for(estimation, 0), seconds,
    )  # fmt: skip


def _check_free_run(problem: Problem, record: Signals) -> None:
    _, x = simulate(problem, record.u, problem.theta[None], record.start[None])
    finite = np.isfinite(x[0]).all((0, 2))
    if not finite.all():
        raise ValueError(
            f"physics {problem.physics.name!r}: expected a free run that stays finite over the record, found states "
            f"beyond the floating-point range from sample {int(np.argmin(finite))} on"
        )


def _beyond(
    problem: Problem,
    flexible: Problem,
    record: Signals,
    found: Found,
    settings: Settings,
    chosen: DiscoverySettings,
    rng: np.random.Generator,
) -> Beyond:
    """Is there more than the named effects, or something better than they?"""
    line = spectral_line(record, found.final.estimate.error, problem.physics.dt)
    beside = look_beyond(problem, flexible, record, found.final, settings, chosen.rules, rng)
    alone = None
    if found.final.estimate.active:
        alone = look_beyond(problem, flexible, record, found.recalibrated, settings, chosen.rules, rng)
    gap = noise_floor(found.final.estimate.error, record.weight)
    return Beyond(beside, alone, line if found.final.estimate.cost > 1.2 * gap else None)


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started
