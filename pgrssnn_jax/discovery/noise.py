"""What cannot be explained: the size of the noise, and errors that look like those seen but mean nothing.

    floor² = mean (e_{t+1} - 2 e_t + e_{t-1})² / 6        white noise; what varies slowly cancels, a line is taken out
    surrogate = A(z)⁻¹ s_t A(z) e_t,  s_t = ±1        colour and size kept, where they occur; meaning lost
Source of the second: wild bootstrap, Wu, Annals of Statistics 14, 1986.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from pgrssnn_jax.discovery.spectrum import without_line

ORDER = 4  # of A: AR(4) follows white, AR(1) and low-pass filtered noise and the poles of second-order systems
_STABLE = 0.999  # largest modulus of a pole of 1 / A
_TRIM = 0.02  # share of the largest second differences left out: steps of the input that a model does not follow


def noise_floor(error: Float[np.ndarray, "seq time y"], weight: Float[np.ndarray, "seq time y"]) -> float:
    """Σ (w e)² of white noise of the size seen between neighbouring measured samples; never above that of `error`."""
    total = 0.0
    for j in range(error.shape[2]):
        there = weight[..., j] > 0
        still = without_line(error[..., j], there)
        measured = [sequence[counts] for sequence, counts in zip(still, there, strict=True)]
        squares = np.sort(np.concatenate([np.diff(one, 2) for one in measured]) ** 2)
        kept = squares[: max(1, int(len(squares) * (1.0 - _TRIM)))]
        # the mean of a squared normal deviate without its largest 2 % is 0.87
        total += float(kept.mean()) / 6.0 / 0.87 * float((weight[..., j] > 0).sum()) if len(squares) else 0.0
    return min(total, float((error**2).sum()))


def above_white_noise(
    error: Float[np.ndarray, "seq time y"], weight: Float[np.ndarray, "seq time y"], ratio: float
) -> bool:
    """Are weighted errors larger than the white noise in them by more than this ratio?"""
    return float((error**2).sum()) > ratio**2 * noise_floor(error, weight)


def white_variance(
    error: Float[np.ndarray, "seq time y"], mask: Bool[np.ndarray, "seq time y"]
) -> Float[np.ndarray, " y"]:
    """Of the white noise of each output."""
    outputs = range(error.shape[-1])
    return np.array([noise_floor(error[..., [j]], 1.0 * mask[..., [j]]) / max(mask[..., j].sum(), 1) for j in outputs])


class Surrogates(NamedTuple):
    """Draws A(z)⁻¹ s_t ε_t, kept as signs s, innovations ε and filters A of the outputs: as arrays, a
    thousand draws take a thousand times the memory of the record."""

    signs: Float[np.ndarray, "draw seq time"]
    innovations: Float[np.ndarray, "seq time y"]
    filters: Float[np.ndarray, "y lag"]

    def energy(self) -> Float[np.ndarray, " draw"]:
        """Σ e² of every draw e."""
        total = np.zeros(len(self.signs))
        for j, f in enumerate(self.filters):
            drawn = scipy.signal.lfilter([1.0], f, self.signs * self.innovations[..., j])
            total += np.einsum("dst,dst->d", drawn, drawn)
        return total

    def pull(self, columns: Float[np.ndarray, "seq time y k"]) -> Float[np.ndarray, "draw k"]:
        """Σ e c of every draw e and column c: the filter runs over the columns, backwards, and not over every draw."""
        through = np.zeros((*columns.shape[:2], columns.shape[3]))
        for j, f in enumerate(self.filters):
            backwards = scipy.signal.lfilter([1.0], f, columns[:, ::-1, j], axis=1)
            through += self.innovations[..., [j]] * backwards[:, ::-1]
        return self.signs.reshape(len(self.signs), -1) @ through.reshape(-1, columns.shape[3])


def surrogates_of(error: Float[np.ndarray, "seq time y"], draws: int, rng: np.random.Generator) -> Surrogates:
    """Errors of the same colour that mean nothing."""
    innovations, filters = _whitened(error)
    return Surrogates(_signs(innovations, draws, rng), innovations, filters)


def surrogates(
    error: Float[np.ndarray, "seq time y"], draws: int, rng: np.random.Generator
) -> Float[np.ndarray, "draw seq time y"]:
    """The same as arrays."""
    return recoloured(*_whitened(error), draws, rng)


def _whitened(
    error: Float[np.ndarray, "seq time y"],
) -> tuple[Float[np.ndarray, "seq time y"], Float[np.ndarray, "y lag"]]:
    filters = np.stack([autoregression(error[..., j]) for j in range(error.shape[2])])
    innovations = [scipy.signal.lfilter(f, [1.0], error[..., j], axis=-1) for j, f in enumerate(filters)]
    return np.stack(innovations, -1), filters


def _signs(
    innovations: Float[np.ndarray, "seq time y"], draws: int, rng: np.random.Generator
) -> Float[np.ndarray, "draw seq time"]:
    return rng.integers(0, 2, (draws, *innovations.shape[:2])) * 2.0 - 1.0


def recoloured(
    innovations: Float[np.ndarray, "seq time y"],
    filters: Float[np.ndarray, "y lag"],
    draws: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "draw seq time y"]:
    """A(z)⁻¹ s_t ε_t; outputs keep what they have in common, and all what they have at neighbouring times in size."""
    signs, drawn = _signs(innovations, draws, rng), np.empty((draws, *innovations.shape))
    for j, f in enumerate(filters):
        drawn[..., j] = scipy.signal.lfilter([1.0], f, signs * innovations[..., j])
    return drawn


def autoregression(
    error: Float[np.ndarray, "seq time"], measured: Bool[np.ndarray, "seq time"] | None = None, order: int = ORDER
) -> Float[np.ndarray, " lag"]:
    """1, -a_1, ..., -a_p of the likeliest stationary autoregression, from samples whose predecessors were measured."""
    time = error.shape[1]
    lagged = np.stack([error[:, order - k : time - k].ravel() for k in range(order + 1)])
    if measured is not None:
        whole = np.stack([measured[:, order - k : time - k].ravel() for k in range(order + 1)]).all(0)
        lagged = lagged[:, whole]
    products = lagged @ lagged.T
    past = products[1:, 1:] + 1e-10 * (products[0, 0] + 1e-300) * np.eye(order)
    filters = np.concatenate([[1.0], -np.linalg.solve(past, products[1:, 0])])
    largest = np.abs(np.roots(filters)).max(initial=0.0)
    return filters if largest <= _STABLE else filters * (_STABLE / largest) ** np.arange(len(filters))


def correlation_time(filters: Float[np.ndarray, " lag"]) -> float:
    """Σ_k ρ_k of an autoregression, in samples, 1 for white noise: so many samples tell as much as one."""
    response = np.asarray(scipy.signal.lfilter([1.0], filters, np.eye(1, 4096)[0]))
    return float(max(response.sum() ** 2 / (response**2).sum(), 1.0))


def longest_memory(error: Float[np.ndarray, "seq time y"]) -> float:
    """Correlation time of the output whose errors remember longest, in samples."""
    return max(correlation_time(autoregression(error[..., j])) for j in range(error.shape[-1]))
