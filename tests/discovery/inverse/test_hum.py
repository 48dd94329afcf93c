"""A hum of a drive is told from what a motion explains."""

import numpy as np
import pytest

from pgrssnn_jax.discovery.inverse.hum import hum
from pgrssnn_jax.discovery.inverse.motion import Motion

SEQUENCES, TIME, DT, PERIOD = 4, 900, 0.02, 33.3  # of the hum, samples
SHAPE = (SEQUENCES, TIME, 2)


def smooth(seed: int, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    """Signals of deviation about 1 with a memory of half a second, as speeds have it."""
    white = np.random.default_rng(seed).standard_normal(shape)
    kernel = np.hanning(51)
    found = np.apply_along_axis(lambda one: np.convolve(one, kernel, "same"), 1, white)
    return found / found.std()


def sines(size: float, period: float = PERIOD) -> np.ndarray:
    """Of the second joint, each sequence with a phase of its own."""
    phase = np.random.default_rng(5).uniform(0, 2 * np.pi, (SEQUENCES, 1))
    found = np.zeros(SHAPE)
    found[..., 1] = size * np.sin(2 * np.pi / period * np.arange(TIME) + phase)
    return found


def motion(v: np.ndarray, torque: np.ndarray) -> Motion:
    return Motion(np.cumsum(v, 1) * DT, v, np.gradient(v, DT, axis=1), torque, DT, 5.0, np.zeros(2), np.zeros(2))


def noise(seed: int = 1) -> np.ndarray:
    return 0.1 * np.random.default_rng(seed).standard_normal(SHAPE)


@pytest.mark.parametrize("answered", [0.0, 0.95])
def test_joint_period_and_size_are_told_also_where_a_controller_answers(answered):
    torque = 5.0 * smooth(0) + sines(answered * 0.4)
    found = hum([(motion(smooth(2), torque), sines(0.4) + noise())])
    assert found is not None
    assert found.output == 1
    assert found.period == pytest.approx(PERIOD, abs=0.1 * PERIOD**2 / TIME)
    assert found.amplitude == pytest.approx(0.4, rel=0.1)


def test_it_may_show_by_one_way_of_reading_the_motion_alone():
    one = motion(smooth(2), smooth(0))
    assert hum([(one, noise())]) is None
    assert hum([(one, noise()), (one, sines(0.4) + noise())]) is not None


def test_a_line_of_the_motion_that_a_model_misses_by_a_third_is_no_hum():
    torque = 5.0 * smooth(0) + sines(1.2)
    assert hum([(motion(smooth(2) + sines(1.0), torque), sines(0.4) + noise())]) is None


@pytest.mark.parametrize("periods", [9, 60])
def test_errors_of_a_motion_that_repeats_itself_are_none(periods):
    """A law that is missing (here a product of the speeds) repeats with it."""
    length = TIME // periods
    v = np.tile(smooth(2, (1, length, 2)), (SEQUENCES, periods + 1, 1))[:, :TIME]
    once = np.sin(2 * np.pi * 3 / length * np.arange(length))
    error = np.zeros(SHAPE)
    error[..., 1] = 0.4 * np.resize(once, TIME)
    assert hum([(motion(v, 0.1 * smooth(0)), error + noise())]) is None
    assert hum([(motion(smooth(2), 0.1 * smooth(0)), error + noise())]) is not None


@pytest.mark.parametrize("seed", range(10))
def test_errors_that_follow_a_motion_are_none(seed):
    """Dry friction that is missing changes its sign whenever a joint turns round."""
    v = smooth(seed)
    assert hum([(motion(v, 5.0 * smooth(seed + 50)), 0.4 * np.sign(v) + noise(seed))]) is None
