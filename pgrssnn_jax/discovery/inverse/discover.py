"""Discovery on an arm by its torques: motion, structure, effects, judgement, and the test record, once.

records ──> q, q̇, q̈ ──> torque errors ──> structure and effects ──> p-values, deviations ──> torques of the test record
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from pgrssnn_jax.discovery.inverse.compare import Compared, compared, error_of, spreads
from pgrssnn_jax.discovery.inverse.evidence import SMOOTHED, Torques, fastest_of, judged, samples_of, torques
from pgrssnn_jax.discovery.inverse.fit import Gain
from pgrssnn_jax.discovery.inverse.floor import floor_of
from pgrssnn_jax.discovery.inverse.free_run import FreeRun, free_runs
from pgrssnn_jax.discovery.inverse.hum import hum_of
from pgrssnn_jax.discovery.inverse.judge import chances, changed_friction, deviations
from pgrssnn_jax.discovery.inverse.motion import Motion, few, motion_of
from pgrssnn_jax.discovery.inverse.reading import COARSE, FAST, Reading, best_reading
from pgrssnn_jax.discovery.inverse.select import Active, Chosen, Search, finalists, own_places, select
from pgrssnn_jax.discovery.inverse.structures import STRUCTURE, Structure, Tried, best_structures, near, wrapped
from pgrssnn_jax.discovery.inverse.unnamed import Unnamed, unnamed
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.discovery.spectrum import Line
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.systems import system_of

NOISIEST = 0.1  # standard deviation of accelerations over that of their noise: above, runs are simulated instead
FRICTION = {"viscous_friction": "B", "coulomb_friction": "Tc"}
_SAMPLES, _FINAL = 2000, 1000  # of each joint: for effects, for the best structures
# Standard deviation of a gain from 1, and of a link's mass from the described one over it, before any data: weaker than
# any data sheet. Where a description has neither friction nor motor inertia, all torques of a joint could grow with its
# gain. 0.25 to 1 give the measured arms alike.
_SHARE = 0.5
_SHARES = (("torque_gain", "gain"), ("link_mass", "share"))
_CONFIRMED = 1.96  # standard errors of a gain on the test record: 95 %
_SHORTEST = 50  # samples: what a filter forwards and backwards takes at its ends, several times
_ENDS = 4  # of the samples that a filter loses at the ends


class Found(NamedTuple):
    """theta: nominal, recalibrated and final numbers, by stage; active: places of the effects in θ; friction: places of
    own numbers that left their prior, by the effect that has their law; nameless: joints whose torques follow the
    motion by no effect's law; line: a hum, motor Nm; std: of the last two stages; p_values; without: test error without
    each effect; shift: samples between a torque and its motion; gain: in the log-likelihood of the test record over the
    recalibrated physics, or over the nominal one where friction alone has left its prior; floor: error of noise alone;
    freedom: degrees of it, of the deviations; free_run: of the models of `theta`, on the test record."""

    problem: Problem
    verdict: Verdict
    chosen: Chosen
    theta: Mapping[str, Float[np.ndarray, " p"]]
    std: Mapping[str, Float[np.ndarray, " p"]]
    active: Active
    friction: Active
    nameless: Unnamed | None
    line: Line | None
    p_values: Mapping[str, float]
    without: Mapping[str, float]
    shift: float
    train: Compared
    test: Compared
    free_run: Sequence[FreeRun]
    gain: Gain
    floor: float
    freedom: float
    seconds: Mapping[str, float]


def motion_evidence(setup: Setup, notify: Callable[[str], None]) -> Motion | None:
    """The motion of the estimation record, where inverse dynamics can be the evidence: of an arm all of whose positions
    were measured, in records much longer than what a filter cannot see at their ends, with accelerations that stand out
    of their noise. Otherwise None; for an arm `notify` gets the reason."""
    wanted = setup.settings.evidence
    if setup.physics.settings.get("form") == "filter":
        raise ValueError("physics.form: expected forward in a discovery, found filter")
    if wanted == "free_run" or (wanted == "auto" and system_of(setup.physics) != "arm"):
        return None
    motion, reason = None, _unfit(setup)
    if reason is None:
        motion = motion_of(setup.estimation, setup.physics.dt, at_rest=_at_rest(setup))
        lost = setup.estimation.y.shape[1] - motion.v.shape[1]
        if min(record.y.shape[1] for record in (setup.estimation, setup.test)) < _ENDS * lost:
            reason = f"records much longer than the {lost} samples that a filter loses at their ends"
        elif wanted == "auto" and not (motion.noise < NOISIEST).all():
            joints = ", ".join(str(joint + 1) for joint in np.flatnonzero(~(motion.noise < NOISIEST)))
            reason = f"accelerations ten times their noise (joints {joints} have less)"
    if reason is None:
        return motion
    if wanted != "auto":
        raise ValueError(f"discovery.evidence: inverse_dynamics: expected {reason}, found other data")
    notify(f"evidence: simulated runs, because torques need {reason}")
    return None


def _unfit(setup: Setup) -> str | None:
    """What inverse dynamics would need and do not have."""
    if system_of(setup.physics) != "arm":
        return "an arm"
    for record in (setup.estimation, setup.test):
        if not np.asarray(record.mask).all():
            return "all positions measured"
        if record.y.shape[1] < _SHORTEST:
            return f"sequences of at least {_SHORTEST} samples"
    return None


def discover_by_torques(setup: Setup, motion: Motion, notify: Callable[[str], None]) -> Found:
    """motion: of the estimation record, from `motion_evidence`."""
    started, fastest = time.perf_counter(), fastest_of(motion)
    # Thousands of small products: threads of BLAS wait for each other longer than they compute where cores are busy.
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        problem = build_problem(setup.physics, judged(setup.physics, setup.candidates), accelerate=False)
        problem = _plausible(_held(problem, setup.settings.tolerance), fastest)
        model = torques(problem)
        reading, search, tried = _search(model, setup, motion, notify)
        chosen = select(search, tried, notify)
        named = time.perf_counter()
        (last, active), samples = chosen.final, search.samples
        fits = {"recalibrated": chosen.recalibrated, "after": last}
        std = {name: deviations(problem, fit, samples) for name, fit in fits.items()}
        friction = changed_friction(search._replace(kappa=chosen.kappa), chosen.final, std["after"], FRICTION)
        nameless = unnamed(search, chosen)
        p_values = chances(problem, samples, chosen, setup.settings.seed)
        told = time.perf_counter()
        theta = {"before": problem.theta} | {name: wrapped(problem, fit.theta) for name, fit in fits.items()}
        read = {"train": reading.of(setup.estimation), "test": reading.of(setup.test)}
        scale = spreads(setup)
        train, test = (
            compared(model, motion, fastest, theta, scale[part], chosen.kappa) for part, motion in read.items()
        )
        runs = free_runs(problem, reading._replace(shift=1.0).of(setup.test), theta)
        without = {name: error_of(model, test, fastest, fit.theta) for name, fit in chosen.without.items()}
        line = hum_of(model, reading, setup.estimation, theta["after"])
        gain = test.gains["recalibrated" if active else "before"]
        least = min(one.models["after"].error for one in (train, test))
        floor = min(floor_of(model, reading, setup.estimation, train, samples, last.theta), least)
    seconds = {"name": named - started, "judge": told - named, "prove": time.perf_counter() - told}
    return Found(
        problem=problem,
        verdict=_verdict(setup, chosen, active, friction, nameless or line, train, test, gain, floor),
        chosen=chosen,
        theta=theta,
        std=std,
        active=active,
        friction=friction,
        nameless=nameless,
        line=line,
        p_values=p_values,
        without=without,
        shift=reading.shift,
        train=train,
        test=test,
        free_run=runs,
        gain=gain,
        floor=floor,
        freedom=samples.blocks - 1.0,
        seconds=seconds,
    )


def _search(
    model: Torques, setup: Setup, motion: Motion, notify: Callable[[str], None]
) -> tuple[Reading, Search, list[Tried]]:
    """How the records are read, and the structures among whose neighbours effects are looked for."""
    chosen, problem, fastest = setup.settings, model.problem, fastest_of(motion)
    coarse = samples_of(few(motion, COARSE), fastest)
    search = Search(model, coarse, own_places(problem), np.ones(len(fastest)), chosen.folds, chosen.criteria)
    tried = best_structures(model, coarse, search.own, search.kappa, chosen.folds)
    reading = best_reading(search, tried[0], setup.estimation, motion, at_rest=_at_rest(setup))
    notify(f"evidence: inverse dynamics, {reading.words}")
    motion = reading.of(setup.estimation)
    tried = finalists(search._replace(samples=samples_of(few(motion, _FINAL), fastest)), tried)
    # Where the smoothed friction of effects is not yet whole they would make good for it, one in place of another.
    search = search._replace(samples=samples_of(few(motion, _SAMPLES), fastest, SMOOTHED))
    inside = near(problem, tried[0].structure)
    return reading, search._replace(torques=replace(model, problem=inside)), tried


def _plausible(problem: Problem, fastest: Float[np.ndarray, " n"]) -> Problem:
    """A lubricant's film builds up while a joint is slow: a Stribeck speed beyond that is other friction."""
    high = problem.high.copy()
    speed = [slot.path == ("stribeck_friction", "speed") for slot in problem.slots]
    high[speed] = np.maximum(problem.low[speed], FAST * fastest.max())
    return replace(problem, high=high)


def _held(problem: Problem, tolerance: float | None) -> Problem:
    """Every number of the physics is known relative to itself, joint by joint; None: as well as not. So are gains and
    masses."""
    precision = np.zeros(len(problem.theta))
    precision[[slot.path in _SHARES for slot in problem.slots]] = 1.0 / _SHARE**2
    if tolerance is not None:
        own = own_places(problem)
        precision[own] = 1.0 / (tolerance * problem.theta[own]) ** 2
    return replace(problem, precision=precision)


def _at_rest(setup: Setup) -> bool:
    return setup.start is Start.AT_REST


def _verdict(
    setup: Setup,
    selection: Chosen,
    active: Active,
    friction: Active,
    nameless: Unnamed | Line | None,
    train: Compared,
    test: Compared,
    gain: Gain,
    floor: float,
) -> Verdict:
    criteria = setup.settings.criteria
    if nameless is not None:
        return Verdict.UNKNOWN_EFFECT
    before, recalibrated, after = (test.models[name].error for name in ("before", "recalibrated", "after"))
    if active or friction:  # friction that the physics knows is refitted in the recalibrated model as well
        if not gain.clear(_CONFIRMED) or after >= 1.0:
            return Verdict.NOT_CONFIRMED
        ambiguous = set(active) & STRUCTURE and rival_structures(selection)
        return Verdict.AMBIGUOUS if ambiguous else Verdict.EFFECT_FOUND
    if train.models["recalibrated"].moving > criteria.clear * floor:
        return Verdict.UNEXPLAINED
    return Verdict.MISCALIBRATED if before > criteria.shifted * recalibrated else Verdict.NO_DISCREPANCY


def rival_structures(selection: Chosen) -> list[Structure]:
    """Structures that predict as well and change no more."""
    return [one.structure for one in selection.rivals if 0 < one.structure.changes <= selection.structure.changes]
