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

from pgrssnn_jax.discovery.inverse.evidence import Samples, Torques, fastest_of, judged, samples_of, torques
from pgrssnn_jax.discovery.inverse.judge import chances, changed_friction, deviations
from pgrssnn_jax.discovery.inverse.motion import Motion, filters, motion_of, spectrum_of, thinned
from pgrssnn_jax.discovery.inverse.select import Active, Chosen, Search, finalists, own_places, select, with_everything
from pgrssnn_jax.discovery.inverse.structures import Structure, Tried, best_structures, near, wrapped
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.systems import system_of
from pgrssnn_jax.records.record import Record

NOISIEST = 0.1  # standard deviation of accelerations over that of their noise: above, runs are simulated instead
FRICTION = {"viscous_friction": "B", "coulomb_friction": "Tc"}
_SAMPLES, _COARSE = 2000, 500  # of each joint: on which effects are fitted, and on which structures are compared
_SHIFTS = (0.0, 0.5, 1.0)  # samples between a torque and the motion that belongs to it
_OCTAVES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)  # of cut-offs above that of the spectrum
_IMITATE = ("torque_gain", "stribeck_friction", "wrist_coupling")
_FAST = 0.2  # of a joint's highest speed
_RESAMPLED = 400


class Reading(NamedTuple):
    """How records are read: sample time, s; cut-off, Hz; samples between a torque and the motion that belongs to it;
    samples left out at the ends."""

    dt: float
    cutoff: float
    shift: float
    at_rest: bool
    edge: int

    def of(self, record: Record) -> Motion:
        return motion_of(record, self.dt, at_rest=self.at_rest, shift=self.shift, cutoff=self.cutoff, edge=self.edge)

    @property
    def words(self) -> str:
        return f"positions low-pass filtered at {self.cutoff:.2g} Hz" if self.cutoff < 1.0 / self.dt else "no filter"


class Stage(NamedTuple):
    """Torques of a record as one model asks for them, motor Nm `[seq, time, n]`; nrmse: RMS error over the standard
    deviation of the measured torque, of all, of moving and of resting samples, per joint; interval: 95 % of the mean
    over joints."""

    torque: Float[np.ndarray, "seq time n"]
    nrmse: Float[np.ndarray, "regime n"]
    interval: tuple[float, float]

    @property
    def error(self) -> float:
        return float(self.nrmse[0].mean())


class Compared(NamedTuple):
    """The models on one record. improvement: 95 % interval of the fall of the error from recalibrated to after."""

    motion: Motion
    models: Mapping[str, Stage]
    improvement: tuple[float, float]


class Found(NamedTuple):
    """theta: nominal, recalibrated and final numbers, by stage; active: places of the effects in θ; friction: places of
    own numbers that left their prior, by the effect that has their law; std: of the last two stages; p_values; without:
    test error without each effect; shift: samples between a torque and its motion; floor: what noise alone leaves;
    freedom: degrees of it, of the deviations."""

    problem: Problem
    verdict: Verdict
    chosen: Chosen
    theta: Mapping[str, Float[np.ndarray, " p"]]
    std: Mapping[str, Float[np.ndarray, " p"]]
    active: Active
    friction: Active
    p_values: Mapping[str, float]
    without: Mapping[str, float]
    shift: float
    train: Compared
    test: Compared
    floor: float
    freedom: float
    seconds: Mapping[str, float]


def motion_evidence(setup: Setup) -> Motion | None:
    """The motion of the estimation record, where inverse dynamics can be the evidence: of an arm all of whose positions
    were measured, with accelerations that stand out of their noise. None where they cannot."""
    wanted = setup.settings.evidence
    if system_of(setup.physics) != "arm" or wanted == "free_run" or not np.asarray(setup.estimation.mask).all():
        return None
    motion = motion_of(setup.estimation, setup.physics.dt, at_rest=_at_rest(setup))
    return motion if wanted == "inverse_dynamics" or (motion.noise < NOISIEST).all() else None


def discover_by_torques(setup: Setup, motion: Motion, notify: Callable[[str], None]) -> Found:
    """motion: of the estimation record, from `motion_evidence`."""
    started, fastest = time.perf_counter(), fastest_of(motion)
    with jax.enable_x64(True):
        problem = build_problem(setup.physics, judged(setup.physics, setup.effects), accelerate=False)
        problem = _held(problem, setup.settings.tolerance)
        model = torques(problem)
        reading, search, tried = _search(model, setup, motion, notify)
        chosen = select(search, tried, notify)
        named = time.perf_counter()
        (last, active), samples = chosen.final, search.samples
        fits = {"recalibrated": chosen.recalibrated, "after": last}
        std = {name: deviations(problem, fit, samples) for name, fit in fits.items()}
        friction = changed_friction(problem, last, std["after"], FRICTION)
        p_values = chances(problem, samples, chosen, setup.settings.seed)
        told = time.perf_counter()
        theta = {"before": problem.theta} | {name: wrapped(problem, fit.theta) for name, fit in fits.items()}
        train, test = (_compared(model, reading.of(one), fastest, theta) for one in (setup.estimation, setup.test))
        without = {name: _error(model, test.motion, fastest, fit.theta) for name, fit in chosen.without.items()}
        floor = _floor(model, setup, train.motion, samples, last.theta)
    seconds = {"name": named - started, "judge": told - named, "prove": time.perf_counter() - told}
    return Found(
        problem=problem,
        verdict=_verdict(setup, chosen, {**active, **friction}, train, test, floor),
        chosen=chosen,
        theta=theta,
        std=std,
        active=active,
        friction=friction,
        p_values=p_values,
        without=without,
        shift=reading.shift,
        train=train,
        test=test,
        floor=floor,
        freedom=samples.blocks - 1.0,
        seconds=seconds,
    )


def _search(
    model: Torques, setup: Setup, motion: Motion, notify: Callable[[str], None]
) -> tuple[Reading, Search, list[Tried]]:
    """How the records are read, and the structures among whose neighbours effects are looked for."""
    chosen, problem, fastest = setup.settings, model.problem, fastest_of(motion)
    coarse = samples_of(_few(motion, _COARSE), fastest)
    search = Search(model, coarse, own_places(problem), np.ones(len(fastest)), chosen.folds, chosen.criteria)
    tried = best_structures(model, coarse, search.own, search.kappa, chosen.folds)
    reading = _reading(search, tried[0], setup, motion)
    notify(f"evidence: inverse dynamics, {reading.words}")
    search = search._replace(samples=samples_of(_few(reading.of(setup.estimation), _SAMPLES), fastest))
    tried = finalists(search, tried)
    return reading, search._replace(torques=replace(model, problem=near(problem, tried[0]))), tried


def _held(problem: Problem, tolerance: float | None) -> Problem:
    """Every number of the physics is known relative to itself, joint by joint; None: as well as not."""
    if tolerance is None:
        return problem
    own, precision = own_places(problem), np.zeros(len(problem.theta))
    precision[own] = 1.0 / (tolerance * problem.theta[own]) ** 2
    return replace(problem, precision=precision)


def _at_rest(setup: Setup) -> bool:
    return setup.start is Start.AT_REST


def _few(motion: Motion, samples: int) -> Motion:
    return thinned(motion, max(1, motion.v.shape[0] * motion.v.shape[1] // samples))


def _reading(search: Search, best: Tried, setup: Setup, motion: Motion) -> Reading:
    """The shift and the cut-off at which effects predict the torque of fast joints best: it is the torque as it was
    measured, whatever the motion was filtered by. A gain is left out, because it imitates a shift,
    and so are slow samples: where a joint turns round, a controller's torque is late by itself."""
    fastest, dt = fastest_of(motion), setup.physics.dt

    def missed(reading: Reading) -> float:
        samples = samples_of(_few(reading.of(setup.estimation), _COARSE), fastest)
        error = with_everything(search._replace(samples=samples), best, without=_IMITATE).fit.error
        fast = np.abs(samples.v) > _FAST * fastest[:, None]
        return float(np.mean([np.log(np.mean(e[among] ** 2)) for e, among in zip(error, fast, strict=True)]))

    unfiltered = 1.0 / dt
    first = motion.cutoff or unfiltered
    cutoffs = {cutoff if filters(cutoff, dt) else unfiltered for cutoff in (first * 2.0**k for k in _OCTAVES)}
    at_rest, edge = _at_rest(setup), setup.estimation.u.shape[1] - motion.v.shape[1]
    edge = edge if at_rest else edge // 2
    return min((Reading(dt, c, shift, at_rest, edge) for c in sorted(cutoffs) for shift in _SHIFTS), key=missed)


def _compared(
    model: Torques, motion: Motion, fastest: Float[np.ndarray, " n"], numbers: Mapping[str, Float[np.ndarray, " p"]]
) -> Compared:
    samples = samples_of(motion, fastest)
    stages = {name: _stage(model, samples, motion, theta) for name, theta in numbers.items()}
    drawn = _resampled(samples, motion, [stage.torque for stage in stages.values()])
    stages = {
        name: stage._replace(interval=_interval(errors))
        for (name, stage), errors in zip(stages.items(), drawn, strict=True)
    }
    return Compared(motion, stages, _interval(drawn[1] - drawn[2]))


def _error(model: Torques, motion: Motion, fastest: Float[np.ndarray, " n"], theta: Float[np.ndarray, " p"]) -> float:
    return _stage(model, samples_of(motion, fastest), motion, theta).error


def _stage(model: Torques, samples: Samples, motion: Motion, theta: Float[np.ndarray, " p"]) -> Stage:
    error, spread = model.errors(theta, samples), motion.torque.std(axis=(0, 1))
    regimes = (np.ones_like(samples.moving), samples.moving, ~samples.moving)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = [np.sqrt((error**2 * among).sum(1) / among.sum(1)) / spread for among in regimes]
    asked = motion.torque - error.T.reshape(motion.torque.shape)
    return Stage(asked, np.stack(rms), (np.nan, np.nan))


def _resampled(
    samples: Samples, motion: Motion, asked: Sequence[Float[np.ndarray, "seq time n"]]
) -> list[Float[np.ndarray, " draw"]]:
    """The mean over joints of every model's error, over blocks that are drawn with replacement."""
    drawn = np.random.default_rng(0).integers(0, samples.blocks, (_RESAMPLED, samples.blocks))
    spread, count = motion.torque.std(axis=(0, 1)), np.bincount(samples.block, minlength=samples.blocks)
    found = []
    for one in asked:
        squares = ((motion.torque - one) ** 2).reshape(-1, len(spread))
        sums = np.stack([np.bincount(samples.block, joint, samples.blocks) for joint in squares.T], 1)
        found.append((np.sqrt(sums[drawn].sum(1) / count[drawn].sum(1)[:, None]) / spread).mean(1))
    return found


def _interval(drawn: Float[np.ndarray, " draw"]) -> tuple[float, float]:
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)


def _floor(model: Torques, setup: Setup, motion: Motion, samples: Samples, theta: Float[np.ndarray, " p"]) -> float:
    """What noise alone leaves, in the metric: of torques, and of accelerations by the inertia that they move."""
    _, floor = spectrum_of(np.asarray(setup.estimation.u, np.float64), setup.physics.dt)
    of_torque = floor * (motion.cutoff or 0.5 / setup.physics.dt)
    still = samples._replace(a=np.zeros_like(samples.a))
    inertial = ((model.errors(theta, samples) - model.errors(theta, still)) ** 2).mean(1)
    return float(np.mean(np.sqrt(of_torque + motion.noise**2 * inertial) / motion.torque.std(axis=(0, 1))))


def _verdict(setup: Setup, selection: Chosen, active: Active, train: Compared, test: Compared, floor: float) -> Verdict:
    criteria = setup.settings.criteria
    before, recalibrated, after = (test.models[name].error for name in ("before", "recalibrated", "after"))
    if active:
        if test.improvement[0] <= 0.0 or after >= 1.0:
            return Verdict.NOT_CONFIRMED
        return Verdict.AMBIGUOUS if rival_structures(selection) else Verdict.EFFECT_FOUND
    moving = float(np.nanmean(train.models["recalibrated"].nrmse[1]))
    if moving > criteria.clear * floor:  # at rest friction holds against any torque within its reach
        return Verdict.UNEXPLAINED
    return Verdict.MISCALIBRATED if before > criteria.shifted * recalibrated else Verdict.NO_DISCREPANCY


def rival_structures(selection: Chosen) -> list[Structure]:
    """Structures that predict as well and change no more."""
    return [one.structure for one in selection.rivals if 0 < one.structure.changes <= selection.structure.changes]
