"""How much the best of the whole catalogue gains by luck alone.

Under the null the present model is right, and its innovations might as well have had the other sign:

    e*_t = A(z)⁻¹ s_t ε_t,  s_t = ±1        gain = ½ n log(‖e*‖² / ‖e* - Q Qᵀ e*‖²)

which keeps the colour of the noise and when it is large. Q: orthonormal basis of what a candidate adds to the free run
at one start (its displacement and the derivatives by its numbers) beside all that is free anyway. Slow noise looks like
slow effects, so every effect is measured by what it gains on average by luck; the largest ratio over all effects and
starts pays for every look. Sources: wild bootstrap, Wu, Annals of Statistics 14, 1986; maximum over
a catalogue, White, Econometrica 68, 2000; start at which a number means nothing, Davies, Biometrika 74, 1987.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.discovery.likelihood import Linearisation

_AT_ONCE = 1_000_000  # samples of noise held in memory
_WORK = 20_000_000  # samples of noise in all: of long records fewer draws are made
LEAST_GAIN = 0.05  # nats: fits end that near to their optimum, so less is no gain
_SAME = 1.1  # times the gain of a fit: another one gains more, and was found beside other effects
_NEGLIGIBLE = 1e-6  # of a column: what is left of it after a projection is rounding

Recoloured = Callable[[int, np.random.Generator], Float[np.ndarray, "draw seq time y"]]  # so many draws of the errors


class Known(NamedTuple):
    """p-value of an effect by another law, at the fit that gained so much."""

    gain: float
    p_value: float


class Null(NamedTuple):
    """Of the best effect by luck alone. law `[draw]`: least p-value of any effect, sorted; shape, scale: gamma
    distribution of the gain of every effect, nats; known: by the names of effects, for fits that gain a tenth more at
    most."""

    law: Float[np.ndarray, " draw"]
    shape: Mapping[str, float]
    scale: Mapping[str, float]
    known: Mapping[str, Known] = MappingProxyType({})

    def p_value(self, name: str, gain: float) -> float:
        """Probability that noise alone gives some effect of the catalogue a gain at least as improbable. A periodic
        effect has no gamma distribution where no spectral line gave its fit a starting value: the distribution with the
        largest mean gain is used for it."""
        if not self.shape:
            return 1.0
        like = name if name in self.shape else max(self.shape, key=lambda one: self.shape[one] * self.scale[one])
        alone = scipy.stats.gamma.logsf(max(gain, 0.0), self.shape[like], scale=self.scale[like])
        known = self.known.get(name)
        if known is not None and gain <= _SAME * known.gain + LEAST_GAIN:
            return known.p_value
        return float((1 + (self.law <= alone).sum()) / (1 + len(self.law)))

    def gains(self, name: str) -> Float[np.ndarray, " draw"]:
        """The law in the gains of one effect."""
        return np.asarray(scipy.stats.gamma.isf(np.exp(self.law), self.shape[name], scale=self.scale[name]))


def null_of(gains: Mapping[str, Float[np.ndarray, " draw"]]) -> Null:
    """From the gains of every effect by luck, in the same draws."""
    mean = {name: max(float(own.mean()), LEAST_GAIN) for name, own in gains.items()}
    shape = {name: mean[name] ** 2 / max(float(own.var()), LEAST_GAIN**2) for name, own in gains.items()}
    scale = {name: mean[name] / shape[name] for name in gains}
    alone = [scipy.stats.gamma.logsf(own, shape[name], scale=scale[name]) for name, own in gains.items()]
    return Null(np.sort(np.min(alone, 0)) if alone else np.zeros(1), shape, scale)


def null_distribution(
    at: Linearisation,
    recoloured: Recoloured,
    added: Sequence[tuple[str, Float[np.ndarray, "n _"]]],
    draws: int,
    least: int,
    rng: np.random.Generator,
) -> Null:
    """recoloured: draws of errors by the noise alone; added: name of an effect and its columns at one start, samples in
    one row; least: draws that are always made."""
    n, k = at.error.size, at.columns.shape[-1]
    measured = at.measured.ravel()
    prior = np.diag(np.sqrt(at.precision))
    nuisance = orthonormal(np.concatenate([at.columns.reshape(n, k) * measured[:, None], prior]))
    bases = []
    for _, columns in added:
        longer = np.concatenate([columns * measured[:, None], np.zeros((k, columns.shape[1]))])
        rest = beside(longer, nuisance)
        size = np.linalg.norm(longer, axis=0)
        bases.append(orthonormal(rest[:, np.linalg.norm(rest, axis=0) > _NEGLIGIBLE * size])[:n].astype(np.float32))
    nuisance = nuisance[:n].astype(np.float32)
    draws = max(min(draws, _WORK // n), least)
    found: dict[str, list[np.ndarray]] = {name: [] for name, _ in added}
    at_once = max(1, _AT_ONCE // n)
    for i in range(0, draws, at_once):
        drawn = recoloured(min(at_once, draws - i), rng)
        drawn = drawn.reshape(len(drawn), n) * measured
        size = np.abs(drawn).max(1, keepdims=True)  # of a free run that diverges beyond the range of float32
        drawn = (drawn / np.where(size > 0.0, size, 1.0)).astype(np.float32)
        drawn = drawn - (drawn @ nuisance) @ nuisance.T
        energy = np.maximum((drawn**2).sum(1), 1e-30)
        best = {name: np.zeros(len(drawn)) for name in found}
        for (name, _), basis in zip(added, bases, strict=True):
            best[name] = np.maximum(best[name], ((drawn @ basis) ** 2).sum(1) / energy)
        for name, fall in best.items():
            found[name].append(nats(fall, int(measured.sum())))
    return null_of({name: np.concatenate(parts) for name, parts in found.items()})


def nats(fall: Any, n: int) -> Any:
    """Gain of log-likelihood that a relative fall of the error energy of n samples is."""
    return -0.5 * n * np.log(np.maximum(1.0 - fall, 1e-12))


def beside(columns: Float[np.ndarray, "n d"], basis: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n d"]:
    return columns - basis @ (basis.T @ columns)


def orthonormal(columns: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n m"]:
    """Basis of the columns' span without directions that are only rounding."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 1e-300]
    if not columns.shape[1]:
        return columns
    u, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return u[:, s > 1e-7 * s[0]]
