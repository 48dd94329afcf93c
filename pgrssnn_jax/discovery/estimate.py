"""A model in the making: which effects it has, its numbers, its errors, and how well it predicts blocks left out.

gap            Σ (w e)² above what the noise alone would give
CV             Σ over folds f of Σ_{t in f} (w_t e_t)²,   e from a fit to the other folds
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.least_squares import Lanes, fit, simulate
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.effects.base import SignalRange

_FEW = 2  # guesses per device, up to which a program of few lanes is the faster one


class Settings(NamedTuple):
    """spare: free numbers that a program has places for beside those of the physics; lanes: fits in one program; steps:
    of Levenberg-Marquardt, tolerance: relative fall of the cost at which they end; devices: JAX devices that share the
    lanes."""

    spare: int = 6
    lanes: int = 48
    steps: int = 30
    tolerance: float = 1e-6
    devices: int = 1

    @property
    def screening(self) -> int:
        """Steps after which the best of many are chosen; these then take the rest."""
        return max(1, self.steps // 2)

    @property
    def rest(self) -> int:
        return max(1, self.steps - self.screening)


class Estimate(NamedTuple):
    """active: names of the effects, in the order found; theta `[p]`; x0 `[seq, x]`; error `[seq, time, y]`: weighted
    errors of the free run, 0 where nothing was measured."""

    active: tuple[str, ...]
    theta: Float[np.ndarray, " p"]
    x0: Float[np.ndarray, "seq x"]
    error: Float[np.ndarray, "seq time y"]

    @property
    def cost(self) -> float:
        return float((self.error**2).sum())

    @property
    def guess(self) -> "Guess":
        return Guess(self.active, self.theta, self.x0)


class Validated(NamedTuple):
    """held_out `[seq, time, y]`: weighted errors on samples that the fit had not seen; folds: θ of every fold."""

    estimate: Estimate
    held_out: Float[np.ndarray, "seq time y"]
    folds: Float[np.ndarray, "fold p"]

    @property
    def cost(self) -> float:
        return float((self.held_out**2).sum())

    @property
    def guess(self) -> "Guess":
        return self.estimate.guess


class Guess(NamedTuple):
    """Where one fit starts: the effects it has, θ, x_0."""

    active: tuple[str, ...]
    theta: Float[np.ndarray, " p"]
    x0: Float[np.ndarray, "seq x"]


def fit_all(
    problem: Problem,
    signals: Signals,
    guesses: Sequence[Guess],
    settings: Settings,
    left_out: Sequence[int] | None = None,
    steps: int | None = None,
    only_start: bool = False,
) -> list[tuple[Guess, float]]:
    """Every guess fitted, with its cost; lanes are filled up so that two programs serve all calls, one of them for few
    guesses. only_start: θ stays, x_0 alone is fitted."""
    found: list[tuple[Guess, float]] = []
    left = [-1] * len(guesses) if left_out is None else list(left_out)
    lanes_at_once = settings.devices if len(guesses) <= _FEW * settings.devices else settings.lanes
    for i in range(0, len(guesses), lanes_at_once):
        part, part_left = list(guesses[i : i + lanes_at_once]), left[i : i + lanes_at_once]
        count = len(part)
        part += [part[-1]] * (lanes_at_once - count)
        part_left += [part_left[-1]] * (lanes_at_once - count)
        free = free_places(problem, part, settings)
        lanes = Lanes(
            np.stack([g.theta for g in part]),
            np.stack([g.x0 for g in part]),
            np.full_like(free, -1) if only_start else free,
            np.array(part_left),
        )
        done = fit(
            problem,
            signals,
            lanes,
            steps=settings.steps if steps is None else steps,
            tolerance=settings.tolerance,
            devices=settings.devices,
        )
        theta, x0 = np.asarray(done.theta), np.asarray(done.x0)
        found += [(Guess(part[j].active, theta[j], x0[j]), float(done.cost[j])) for j in range(count)]
    return found


def free_places(problem: Problem, guesses: Sequence[Guess], settings: Settings) -> np.ndarray:
    """Positions in θ `[guess, k]` that fits of these guesses move, -1 for places left over.

    A number at infinity is a limit that is not there, and stays. k grows in steps, so that few programs are compiled.
    """
    free = [np.concatenate([problem.of(name) for name in (None, *guess.active)]) for guess in guesses]
    free = [f[np.isfinite(g.theta[f])] for f, g in zip(free, guesses, strict=True)]
    most = max(map(len, free))
    places = len(problem.of(None)) + settings.spare
    while places < most:
        places += settings.spare
    return np.stack([np.pad(f, (0, places - len(f)), constant_values=-1) for f in free])


def evaluate(problem: Problem, signals: Signals, guess: Guess) -> Estimate:
    y, _ = simulate(problem, signals.u, guess.theta[None], guess.x0[None])
    error = np.where(signals.weight > 0, signals.weight * (signals.y - y[0]), 0.0)
    return Estimate(guess.active, guess.theta, guess.x0, error)


def cross_validate(
    problem: Problem, signals: Signals, guesses: Sequence[Guess], settings: Settings
) -> list[tuple[Validated, float]]:
    """Fits of every guess without each fold in turn, beside the rest of the fit to all of the record and its cost."""
    folds = int(signals.block.max()) + 1
    lanes = [guess for guess in guesses for _ in range(folds + 1)]
    left = [*range(folds), -1] * len(guesses)
    fitted = fit_all(problem, signals, lanes, settings, left_out=left, steps=settings.rest)
    found = []
    for i in range(0, len(fitted), folds + 1):
        own = [g for g, _ in fitted[i : i + folds]]
        whole, cost = fitted[i + folds]
        theta, x0 = np.stack([g.theta for g in own]), np.stack([g.x0 for g in own])
        y, _ = simulate(problem, signals.u, theta, x0)
        chosen = np.take_along_axis(y, np.maximum(signals.block, 0)[None, :, :, None], 0)[0]
        counts = (signals.weight > 0) & (signals.block[..., None] >= 0)
        held_out = np.where(counts, signals.weight * (signals.y - chosen), 0.0)
        found.append((Validated(evaluate(problem, signals, whole), held_out, theta), cost))
    return found


def block_sums(values: Float[np.ndarray, "seq time y"], block: int = 32) -> Float[np.ndarray, " blocks"]:
    """Sums over outputs and over consecutive blocks of samples of every sequence."""
    per_sample = values.sum(-1)
    edges = np.arange(0, per_sample.shape[1], block)
    return np.add.reduceat(per_sample, edges, axis=1).ravel()


def signal_range_of(problem: Problem, signals: Signals, guess: Guess) -> SignalRange:
    """What the states, inputs and outputs span in the free run of a guess."""
    y, x = simulate(problem, signals.u, guess.theta[None], guess.x0[None])

    def span(a: np.ndarray) -> np.ndarray:
        return np.stack([a.min((0, 1)), a.max((0, 1))])

    return SignalRange(span(x[0]), span(signals.u), span(y[0]))
