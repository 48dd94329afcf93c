"""A look at the catalogue by one linearisation, for systems in which a fit of every candidate would take hours.

    e ≈ e_0 - J δ       J: sensitivities of the stretches by the numbers of the model and of every candidate

The states at which stretches start are eliminated stretch by stretch; what remains are normal equations per stretch,
from which fits of every candidate, fits without each fold, and fits to noise are sums and small solves. The best are
then fitted properly, and the free run over whole sequences says whether they matter. What grows slowly is hidden by the
free start of a short stretch, and a long one of a wrong physics has no usable gradient.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from pgrssnn_jax.discovery.bounded import scaled_steps, step_within
from pgrssnn_jax.discovery.candidates import Candidate, Model, Screening, ranked, white_noise
from pgrssnn_jax.discovery.estimate import Estimate, Guess, Settings, fit_all, signal_range_of
from pgrssnn_jax.discovery.least_squares import Lanes, sensitivity, simulate
from pgrssnn_jax.discovery.noise import Surrogates, surrogates_of
from pgrssnn_jax.discovery.null import nats, null_of
from pgrssnn_jax.discovery.predictive import log_likelihood, with_standard_error
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.settings import Criteria

_PLACES = 32  # numbers in one run with sensitivities: three take half as long again as one of 96, which would be
# another program to compile
DRAWS = 200  # of the null, at most: every draw is a fit
_FINALISTS = 3  # candidates that are fitted properly
_BEYOND_REACH = 1.5  # times the best cost that was reached: candidates whose promise is above it are not fitted
_LOST = 10.0  # standard deviations: an error that a free run which has left the range counts
_RIDGE = 1e-9


class Sensitivities(NamedTuple):
    """Weighted errors of all segments, and their derivatives by the starts and by the numbers at `numbers` in θ."""

    numbers: Int[np.ndarray, " k"]
    error: Float[np.ndarray, "s n"]
    starts: Float[np.ndarray, "s n x"]
    columns: Float[np.ndarray, "s n k"]


class Promise(NamedTuple):
    """What one linear step promises of a candidate, or of the model itself: its cost, and the squared errors of every
    stretch left out."""

    guess: Guess
    cost: float
    squares: Float[np.ndarray, " s"]


class Reduced(NamedTuple):
    """Normal equations per stretch without its initial state: normal `[s, k, k]`, pull `[s, k]`, energy `[s]`, and the
    columns `[s, n, k]` themselves; places `[k]`: positions in θ."""

    normal: Float[np.ndarray, "s k k"]
    pull: Float[np.ndarray, "s k"]
    energy: Float[np.ndarray, " s"]
    columns: Float[np.ndarray, "s n k"]
    places: Int[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]


def score_linearised(
    problem: Problem,
    signals: Signals,
    base: Guess | Model,
    settings: Settings,
    criteria: Criteria,
    rng: np.random.Generator,
    without: Sequence[str],
    *,
    whole: Signals,
    least: float = 0.0,
) -> Screening:
    """As `candidates.score_candidates`: candidates are ranked by one linear step each, and the best are then fitted,
    where they promise to lower the RMS error by the share `least` and to predict left-out sequences better. An effect
    that lowers it little on segments may close the gap of whole sequences.

    signals: the segments; whole: sequences uncut, with their starts, for the free run that has the last word.
    """
    if isinstance(base, Guess):
        ((fitted, _),) = fit_all(problem, signals, [base], settings)
        base = segment_model(problem, signals, fitted, whole)
    guess = base.estimate.guess
    own = _free(problem, guess)
    noise = surrogates_of(base.estimate.error, min(criteria.draws, DRAWS), rng)
    size = signals.size
    alone, promised, falls = _promised(problem, signals, guess, own, without, noise)
    cost, null = alone.cost, null_of({name: nats(fall, size) for name, fall in falls.items()})
    promises = [Candidate(name, float(nats(1.0 - p.cost / cost, size)), p.guess) for name, p in promised.items()]
    hopeful = [c for c in promises[:_FINALISTS] if null.p_value(c.name, c.gain) <= criteria.hopeless]
    hopeful = [c for c in hopeful if 1.0 - np.exp(-c.gain / size) >= least]
    hopeful = [c for c in hopeful if _predicts_better(promised[c.name], alone, signals, criteria)]
    found = [c for c in promises if c.name not in {h.name for h in hopeful}]
    best = np.inf
    for candidate in hopeful:
        if np.exp(-2.0 * candidate.gain / size) * cost > _BEYOND_REACH * best:
            found.append(candidate)
            continue
        ((fitted, reached),) = fit_all(problem, signals, [candidate.guess], settings)
        best, model = min(best, reached), segment_model(problem, signals, fitted, whole)
        found.append(Candidate(candidate.name, float(nats(1.0 - reached / cost, size)), fitted, model))
    ordered = ranked(found)
    tried = [base, *(c.model for c in ordered if c.model)]
    return Screening(base, ordered, null, {}, size, white_noise(signals, tried))


def _promised(
    problem: Problem, signals: Signals, base: Guess, own: np.ndarray, without: Sequence[str], noise: Surrogates
) -> tuple[Promise, dict[str, Promise], dict[str, np.ndarray]]:
    """Of the base, of every candidate, the best first, and the fall that each brings in every draw of noise."""
    fold, energy = signals.block[:, 0], np.maximum(noise.energy(), 1e-300)
    best: dict[str, Promise] = {}
    falls: dict[str, np.ndarray] = {}
    (alone,) = _linearised(problem, signals, base, [own], own)
    for guess, reduced in _candidates(problem, signals, base, own, without):
        promise = Promise(guess, *_solve(reduced, fold)[:2])
        name, fall = guess.active[-1], _fall(reduced, noise, len(own)) / energy
        falls[name] = np.maximum(falls.get(name, 0.0), fall)
        if name not in best or promise.cost < best[name].cost:
            best[name] = promise
    ranked = sorted(best.items(), key=lambda item: item[1].cost)
    return Promise(base, *_solve(alone, fold)[:2]), dict(ranked), falls


def _predicts_better(one: Promise, base: Promise, signals: Signals, criteria: Criteria) -> bool:
    """Does a linear step predict left-out sequences better by as much as is asked of a fit?"""
    counts = np.full(len(one.squares), signals.y[0].size)
    better, error = with_standard_error(log_likelihood(one.squares, counts) - log_likelihood(base.squares, counts))
    return better > criteria.standard_errors * error


def segment_model(problem: Problem, signals: Signals, fitted: Guess, whole: Signals) -> Model:
    """A fitted model, scored by its own linearisation; sequences are its blocks, and standard errors are over them."""
    places = _free(problem, fitted)
    runs = _sensitivities(problem, signals, fitted, places)
    (reduced,) = _reduced(problem, signals, fitted, runs, places, [places])
    fold = signals.block[:, 0]
    _, held_out, _ = _solve(reduced, fold)
    normal = reduced.normal.sum(0)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / size / size[:, None], rcond=1e-10, hermitian=True) / size / size[:, None]
    pulls = np.stack([reduced.pull[fold == f].sum(0) for f in range(int(fold.max()) + 1)])
    meat = len(pulls) / max(len(pulls) - 1, 1) * pulls.T @ pulls
    deviation = np.zeros(len(fitted.theta))
    deviation[reduced.places] = np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0.0))
    counts = np.full(len(held_out), signals.y[0].size)
    free_run = whole_runs(problem, whole, fitted)
    estimate = Estimate(*fitted, runs.error.reshape(signals.y.shape))
    return Model(estimate, held_out, counts, deviation, max(len(pulls) - 1.0, 1.0), free_run)


def _free(problem: Problem, guess: Guess) -> np.ndarray:
    """Positions in θ of what a fit moves."""
    places = np.concatenate([problem.of(name) for name in (None, *guess.active)]).astype(int)
    return places[np.isfinite(guess.theta[places])]


def whole_runs(problem: Problem, whole: Signals, guess: Guess) -> Float[np.ndarray, " seq"]:
    """Mean squared weighted error of a run over each whole sequence."""
    y, _ = simulate(problem, whole.u, guess.theta[None], whole.start[None])
    error = np.where(np.isfinite(y[0]), whole.weight * (whole.y - y[0]), _LOST)
    return (np.minimum(np.abs(error), _LOST) ** 2).mean((1, 2))


def _candidates(
    problem: Problem, signals: Signals, base: Guess, own: np.ndarray, without: Sequence[str]
) -> list[tuple[Guess, Reduced]]:
    """Every effect at every start. Effects that begin at their neutral numbers share linearisations."""
    span = signal_range_of(problem, signals, base)
    shared = base.theta  # numbers that no fit moves, the reach of a signal say, may differ: neutral effects do nothing
    together: list[tuple[str, np.ndarray]] = []
    apart: list[tuple[Guess, np.ndarray]] = []
    for effect in problem.effects:
        if effect.name in (*base.active, *without):
            continue
        places = problem.of(effect.name)
        for numbers in effect.guesses(span):
            theta = problem.put(base.theta, effect.name, numbers)
            if np.array_equal(theta[places], base.theta[places]):
                shared = problem.put(shared, effect.name, numbers)
                together.append((effect.name, places))
            else:
                free = places[np.isfinite(theta[places])]
                apart.append((Guess((*base.active, effect.name), theta, base.x0), free))
    found = []
    neutral = base._replace(theta=shared)
    reduced = _linearised(problem, signals, neutral, [places for _, places in together], own)
    for (name, _), one in zip(together, reduced, strict=True):
        found.append((neutral._replace(active=(*base.active, name)), one))
    for guess, places in apart:
        (one,) = _linearised(problem, signals, guess, [places], own)
        found.append((guess, one))
    return found


def _linearised(
    problem: Problem, signals: Signals, guess: Guess, wanted: Sequence[np.ndarray], own: np.ndarray
) -> list[Reduced]:
    """Own numbers and those wanted, one `Reduced` for each of these, from as few sensitivities as hold them all."""
    runs = _sensitivities(problem, signals, guess, _each_once(own, *wanted))
    return _reduced(problem, signals, guess, runs, own, wanted)


def _sensitivities(problem: Problem, signals: Signals, guess: Guess, numbers: Int[np.ndarray, " k"]) -> Sensitivities:
    count = max(1, -(-len(numbers) // _PLACES))
    padded = np.pad(numbers, (0, count * _PLACES - len(numbers)), constant_values=-1).reshape(count, _PLACES)
    alone, devices = (guess.theta[None], guess.x0[None]), jax.device_count()
    runs = [sensitivity(problem, signals, Lanes(*alone, chunk[None]), devices) for chunk in padded]

    def weighted(found: np.ndarray) -> np.ndarray:
        values = np.where(np.isfinite(found), signals.weight[..., None] * found, 0.0)
        return values.reshape(len(found), signals.y[0].size, found.shape[-1])

    error = weighted((signals.y - runs[0][0][0])[..., None])[..., 0]
    starts = weighted(runs[0][1][0][..., _PLACES:])
    used = [min(_PLACES, len(numbers) - i * _PLACES) for i in range(count)]  # the places behind them are empty
    blocks = [weighted(dy[0][..., :k]) for (_, dy), k in zip(runs, used, strict=True)]
    return Sensitivities(numbers, error, starts, blocks[0] if count == 1 else np.concatenate(blocks, -1))


def _reduced(
    problem: Problem, signals: Signals, guess: Guess, runs: Sensitivities, own: np.ndarray, wanted: Sequence[np.ndarray]
) -> list[Reduced]:
    free = problem.code.free_start
    precision, off = signals.precision[:, free], (signals.start - guess.x0)[:, free]
    rest, pull, left = _without_starts(precision, off, runs.columns, runs.starts, runs.error)
    found = []
    for places in wanted:
        chosen = _each_once(own, places)
        every = np.array_equal(chosen, runs.numbers)
        at = (
            slice(None) if every else [runs.numbers.tolist().index(place) for place in chosen]
        )  # a slice copies nothing
        part = rest[..., at]
        normal = np.swapaxes(runs.columns[..., at], 1, 2) @ part
        now = guess.theta[chosen]
        room = problem.low[chosen] - now, problem.high[chosen] - now
        found.append(Reduced(normal, pull[:, at], left, part, chosen, *room))
    return found


def _each_once(*places: np.ndarray) -> Int[np.ndarray, " k"]:
    """In the order in which they come first."""
    return np.array(list(dict.fromkeys(np.concatenate(places).astype(int).tolist())), int)


def _without_starts(
    precision: np.ndarray, off: np.ndarray, columns: np.ndarray, starts: np.ndarray, error: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns without what the initial states of their stretch take up, and pull and energy of the errors without it.
    off: how far the start that is expected lies from the present one."""
    by_start = np.swapaxes(starts, 1, 2)
    local, across = by_start @ starts, by_start @ columns
    index = np.arange(local.shape[-1])
    local[:, index, index] += precision + _RIDGE * (1.0 + local[:, index, index])
    right = np.einsum("snx,sn->sx", starts, error) + precision * off
    taken = np.linalg.solve(local, np.concatenate([across, right[..., None]], -1))
    rest = starts @ taken[..., :-1]
    np.subtract(columns, rest, out=rest)
    pull = np.einsum("snk,sn->sk", columns, error) - np.einsum("sxk,sx->sk", across, taken[..., -1])
    energy = (error**2).sum(1) + (precision * off**2).sum(1) - (right * taken[..., -1]).sum(1)
    return rest, pull, np.maximum(energy, 0.0)


def _solve(reduced: Reduced, fold: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost of the fit to everything, cost of every stretch left out `[s]`, and the steps without each fold."""

    def costs(step: np.ndarray, at: np.ndarray) -> np.ndarray:
        curved = np.einsum("k,skl,l->s", step, reduced.normal[at], step)
        return np.maximum(reduced.energy[at] - 2.0 * reduced.pull[at] @ step + curved, 0.0)

    def fitted(at: np.ndarray) -> np.ndarray:
        return step_within(reduced.normal[at].sum(0), reduced.pull[at].sum(0), reduced.low, reduced.high)

    everything = np.ones(len(fold), bool)
    held_out, folds = np.zeros(len(fold)), []
    for f in range(int(fold.max()) + 1):
        folds.append(fitted(fold != f))
        held_out[fold == f] = costs(folds[-1], fold == f)
    return float(costs(fitted(everything), everything).sum()), held_out, np.stack(folds)


def _fall(reduced: Reduced, noise: Surrogates, own: int) -> Float[np.ndarray, " draw"]:
    """By how much the energy of noise falls with the candidate's numbers beyond what the model's own take."""
    shape = *noise.innovations.shape, len(reduced.places)
    pull, normal = noise.pull(reduced.columns.reshape(shape)), reduced.normal.sum(0)

    def taken(k: int) -> np.ndarray:
        return (pull[:, :k] * scaled_steps(normal[:k, :k], pull[:, :k])).sum(1)

    return taken(len(normal)) - taken(own)
