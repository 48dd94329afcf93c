"""Random inputs with a mean of 0 and a standard deviation of 1.

multisine      w(t) = Σ_k a_k cos(2π k t / n + φ_k),    φ_k uniform
random steps   w held at uniform levels over random spans
low-pass       s_t = s_{t-1} + (w_t - s_{t-1}) / lag
command        z of lag dz/dt = w(t - delay) - z
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


def smooth_steps(rng: np.random.Generator, n: int, shortest: int, longest: int, lag: float) -> Wave:
    return standard(low_pass(random_steps(rng, n, shortest, longest), lag))


def low_pass(wave: Wave, lag: float) -> Wave:
    return lfilter([1 / lag], [1, 1 / lag - 1], wave)


def command(wave: Wave, sub_steps: int, delay: float, lag: float, first: int) -> Wave:
    """What an actuator makes of held samples, by sub-step from sample `first` on: late by `delay`, then with a
    first-order lag, in the middle of every sub-step. delay in samples, a whole number of sub-steps; lag in samples, at
    rest at the beginning of the wave."""
    late = np.arange(len(wave) * sub_steps) - round(delay * sub_steps)
    held = wave[np.maximum(late, 0) // sub_steps]
    if lag > 0.0:
        kept = np.exp(-1.0 / (lag * sub_steps))
        ends, _ = lfilter([1.0 - kept], [1.0, -kept], held, zi=[kept * held[0]])
        held = held + kept**0.5 * (np.concatenate([held[:1], ends[:-1]]) - held)
    return held[first * sub_steps :]


def standard(wave: Wave) -> Wave:
    return (wave - wave.mean()) / wave.std()
