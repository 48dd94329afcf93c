"""Errors that come from the signals are told from noise of any spectrum."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pgrssnn_jax.discovery.follows import follows
from pgrssnn_jax.discovery.problem import Signals

SAMPLES = 1000


def record(seed: int = 0, sequences: int = 1) -> Signals:
    """A slow random input; 5 folds of blocks of 32 samples."""
    rng = np.random.default_rng(seed)
    u = lfilter([0.1], [1.0, -0.9], rng.normal(size=(sequences, SAMPLES)), axis=1)[..., None]
    one = np.ones((sequences, SAMPLES, 1))
    block = np.broadcast_to(np.arange(SAMPLES) // 32 % 5, (sequences, SAMPLES))
    return Signals(u, 0 * one, one, block, np.zeros((sequences, 1)), np.ones((sequences, 1)))


def lagged(wave: np.ndarray, samples: float) -> np.ndarray:
    kept = np.exp(-1 / samples)
    return lfilter([1 - kept], [1, -kept], wave, axis=1)


def play(u: np.ndarray, width: float) -> np.ndarray:
    """What a gear with backlash leaves of its input."""
    z, found = u[:, 0], []
    for now in np.moveaxis(u, 1, 0):
        z = np.clip(z, now - width, now + width)
        found.append(z)
    return np.stack(found, 1)


def judged(signals: Signals, error: np.ndarray, seed: int = 0):
    x = lagged(signals.u, 20.0)
    return follows(signals, x, error, np.random.default_rng(seed))


@pytest.mark.parametrize("sequences", [1, 3])
def test_a_hard_stop_and_backlash_that_acted_some_time_ago_are_seen(sequences):
    signals = record(sequences=sequences)
    noise = 0.1 * np.random.default_rng(1).normal(size=signals.u.shape)
    level = lagged(signals.u, 20.0)
    for cause in (np.maximum(level - np.quantile(level, 0.7), 0.0), play(signals.u, 0.3) - signals.u):
        effect = lagged(cause, 30.0)
        found = judged(signals, effect / effect.std() + noise)
        assert found.share > 0.3
        assert found.p_value < 0.01


def test_noise_of_any_spectrum_does_not_follow_the_signals():
    """40 records: at a level of 0.01 more than two alarms are one chance in a hundred."""
    alarms = 0
    for seed in range(40):
        error = np.random.default_rng(100 + seed).normal(size=(1, SAMPLES, 1))
        error = lagged(error, (0.01, 3.0, 10.0, 100.0)[seed % 4])
        found = judged(record(seed), error / error.std(), seed)
        alarms += found.share >= 0.1 and found.p_value <= 0.01
    assert alarms <= 2


def test_what_was_not_measured_does_not_count():
    signals = record()
    cause = lagged(np.maximum(signals.u, 0.0), 30.0)
    half = np.arange(SAMPLES)[None, :, None] % 2 * np.ones_like(cause)
    found = judged(signals._replace(weight=half), half * cause / cause.std())
    assert found.share > 0.3


def test_an_offset_alone_is_no_matter_of_the_signals():
    signals = record()
    found = judged(signals, 1.0 + 0.1 * np.random.default_rng(2).normal(size=signals.u.shape))
    assert found.p_value > 0.01
