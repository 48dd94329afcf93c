"""What cannot be explained: the size of the noise, and errors that look like those seen but mean nothing.

    floor² = mean (e_{t+1} - 2 e_t + e_{t-1})² / 6        white noise; what varies slowly cancels
    surrogate = error with its spectrum kept and its phases drawn anew
Source of the second: Theiler et al., Testing for nonlinearity in time series: the method of surrogate data, 1992.
"""

import numpy as np
from jaxtyping import Float

_TRIM = 0.02  # share of the largest second differences left out: steps of the input that a model does not follow


def noise_floor(error: Float[np.ndarray, "seq time y"], weight: Float[np.ndarray, "seq time y"]) -> float:
    """Σ (w e)² of white noise of the size seen between neighbouring measured samples; never above that of `error`."""
    total = 0.0
    for j in range(error.shape[2]):
        measured = [sequence[counts] for sequence, counts in zip(error[..., j], weight[..., j] > 0, strict=True)]
        squares = np.sort(np.concatenate([np.diff(one, 2) for one in measured]) ** 2)
        kept = squares[: max(1, int(len(squares) * (1.0 - _TRIM)))]
        # the mean of a squared normal deviate without its largest 2 % is 0.87
        total += float(kept.mean()) / 6.0 / 0.87 * float((weight[..., j] > 0).sum()) if len(squares) else 0.0
    return min(total, float((error**2).sum()))


def surrogates(
    error: Float[np.ndarray, "seq time y"], draws: int, rng: np.random.Generator
) -> Float[np.ndarray, "draw seq time y"]:
    """Errors with the same spectrum and random phases, the same phases for all outputs of a sequence."""
    n = error.shape[1]
    spectrum = np.fft.rfft(error, axis=1)
    phases = rng.uniform(0.0, 2.0 * np.pi, (draws, error.shape[0], spectrum.shape[1], 1))
    phases[:, :, 0] = np.pi * rng.integers(0, 2, phases[:, :, 0].shape)  # the mean stays real
    turned = spectrum[None] * np.exp(1j * phases)
    return np.fft.irfft(turned, n=n, axis=2)
