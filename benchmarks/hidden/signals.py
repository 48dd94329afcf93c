"""Random inputs with a mean of 0 and a standard deviation of 1.

multisine      w(t) = Σ_k a_k cos(2π k t / n + φ_k),    φ_k uniform
random steps   w held at uniform levels over random spans
low-pass       s_t = s_{t-1} + (w_t - s_{t-1}) / lag
"""

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

Wave = Float[np.ndarray, " time"]


def multisine(rng: np.random.Generator, n: int, strong: int, weak: int, ratio: float = 0.15) -> Wave:
    """Lines up to `strong` of equal size, those up to `weak` smaller by `ratio`."""
    lines = np.arange(n // 2 + 1)
    size = np.where(lines <= strong, 1.0, ratio) * ((lines > 0) & (lines <= weak))
    phase = rng.uniform(0, 2 * np.pi, len(lines))
    return standard(np.fft.irfft(size * np.exp(1j * phase), n))


def random_steps(rng: np.random.Generator, n: int, shortest: int, longest: int) -> Wave:
    spans = rng.integers(shortest, longest + 1, size=n // shortest + 1)
    return standard(np.repeat(rng.uniform(-1, 1, len(spans)), spans)[:n])


def low_pass(wave: Wave, lag: float) -> Wave:
    return lfilter([1 / lag], [1, 1 / lag - 1], wave)


def standard(wave: Wave) -> Wave:
    return (wave - wave.mean()) / wave.std()
