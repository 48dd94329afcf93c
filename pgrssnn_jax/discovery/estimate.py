"""A model in the making: which effects it has, its numbers, and the errors of its free run."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.least_squares import Lanes, fit, simulate
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.spectrum import spectral_line
from pgrssnn_jax.effects.base import SignalRange

_FEW = 2  # guesses per device, up to which a program of few lanes is the faster one
_FEW_COMPILED = 8  # lanes of the small program of compiled free runs: vectors of 4 or 8 numbers on every device


class Settings(NamedTuple):
    """spare: free numbers that a program has places for beside those of the physics; lanes: fits in one program; steps:
    of Levenberg-Marquardt, at most; tolerance: relative fall of the cost at which fits end; rough, rough_tolerance:
    the same of fits that are only compared (of 1000 samples, 0.005 of log-likelihood a step); devices: JAX devices that
    share the lanes."""

    spare: int = 6
    lanes: int = 24
    steps: int = 30
    tolerance: float = 1e-6
    rough: int = 10
    rough_tolerance: float = 1e-5
    devices: int = 1

    @property
    def roughly(self) -> "Settings":
        return self._replace(steps=self.rough, tolerance=self.rough_tolerance)

    def at_once(self, problem: Problem, signals: Signals, count: int) -> int:
        """Lanes of the program for so many fits. Compiled lanes cost what they compute. By XLA one sequence is so
        little work that empty lanes cost less than a second program: 24 lanes take 25 ms a step, 2 take 12 (the
        tanks)."""
        if problem.code.compiled is not None:
            return min(_FEW_COMPILED, self.lanes) if count <= _FEW_COMPILED else self.lanes
        few = count <= _FEW * self.devices and len(signals.u) > 1
        return min(self.devices, self.lanes) if few else self.lanes


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
    *,
    only_start: bool = False,
) -> list[tuple[Guess, float]]:
    """Every guess fitted, with its cost; lanes are filled up so that two programs serve all calls, one of them for few
    guesses. only_start: θ stays, x_0 alone is fitted."""
    found: list[tuple[Guess, float]] = []
    at_once = settings.at_once(problem, signals, len(guesses))
    for i in range(0, len(guesses), at_once):
        part = list(guesses[i : i + at_once])
        count = len(part)
        part += [part[-1]] * (at_once - count)
        free = free_places(problem, part, settings)
        lanes = Lanes(
            np.stack([g.theta for g in part]),
            np.stack([g.x0 for g in part]),
            np.full_like(free, -1) if only_start else free,
        )
        rule = {"steps": settings.steps, "tolerance": settings.tolerance, "devices": settings.devices}
        done = fit(problem, signals, lanes, **rule)
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
    return Estimate(guess.active, guess.theta, guess.x0, _error(signals, y[0]))


def _error(signals: Signals, y: np.ndarray) -> np.ndarray:
    """Weighted, 0 where nothing was measured."""
    return np.where(signals.weight > 0, signals.weight * (signals.y - y), 0.0)


def signal_range_of(problem: Problem, signals: Signals, guess: Guess) -> SignalRange:
    """What the states, inputs and outputs span in the free run of a guess, and the line of its errors."""
    y, x = simulate(problem, signals.u, guess.theta[None], guess.x0[None])

    def span(a: np.ndarray) -> np.ndarray:
        return np.stack([a.min((0, 1)), a.max((0, 1))])

    line = spectral_line(_error(signals, y[0]), signals.u)
    lines = (1.0 / (line.period * problem.physics.dt),) if line else ()
    return SignalRange(span(x[0]), span(signals.u), span(y[0]), lines)
