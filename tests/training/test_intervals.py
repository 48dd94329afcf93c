"""Prediction intervals hold the share of measurements that they say, on samples that calibration has not seen."""

import numpy as np
import pytest

from pgrssnn_jax.records.record import Channel, Record, RecordInfo
from pgrssnn_jax.training.intervals import calibrate, inside
from pgrssnn_jax.training.left_out import LeftOut

INFO = RecordInfo((Channel("u"),), (Channel("y"),), 1.0, "simulated")
LAWS = {
    "normal": lambda rng, shape: rng.standard_normal(shape),
    "heavy": lambda rng, shape: rng.standard_t(2.5, shape),
    "one-sided": lambda rng, shape: rng.exponential(size=shape),
}


def drawn(seed, law="normal", samples=3000, size=lambda y: 0.2, units=(1.0, 1.0), spread=0.0):
    """A record with predictions whose errors follow a law; size: of the errors where the prediction is y."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((1, samples, 1))
    predicted = np.cumsum(rng.standard_normal((1, samples, 1)), 1) / 20
    predicted = np.tanh(predicted)
    error = size(predicted) * LAWS[law](rng, predicted.shape)
    u, predicted, error = units[0] * u, units[1] * predicted, units[1] * error
    found = LeftOut(predicted, np.full_like(predicted, spread), error, u, np.ones(predicted.shape, bool))
    return found, Record(u, predicted + error, found.measured, INFO)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("level", [0.5, 0.9])
def test_the_share_of_new_measurements_inside_is_the_level(law, level):
    shares = []
    for seed in range(5):
        found, record = drawn(10 + seed, law)
        new, again = drawn(20 + seed, law)
        half = calibrate(found, [record]).half_width(new.predicted, new.spread, new.u, level)
        (share,), (width,) = inside(again, new.predicted, half, 0)
        assert width == pytest.approx(2 * half.mean())
        shares.append(share)
    assert np.mean(shares) == pytest.approx(level, abs=0.03)


def test_the_interval_is_wide_where_errors_are_large():
    found, record = drawn(1, size=lambda y: np.exp(1.5 * y) / 10)
    level = np.array([-0.8, 0.8])[None, :, None]
    low, high = calibrate(found, [record]).half_width(level, 0 * level, 0 * level, 0.9)[0, :, 0]
    assert 4.0 < high / low < 1.2 * np.exp(1.5 * 1.6)  # the prior keeps it below


def test_units_change_nothing():
    factors = (1e-6, 1e6)
    (plain, record), (other, scaled) = drawn(1), drawn(1, units=factors)
    one = calibrate(plain, [record]).half_width(plain.predicted, plain.spread, plain.u, 0.9)
    two = calibrate(other, [scaled]).half_width(other.predicted, other.spread, other.u, 0.9)
    np.testing.assert_allclose(two, factors[1] * one, rtol=1e-3)


def test_members_that_disagree_widen_the_interval():
    found, record = drawn(1)
    intervals = calibrate(found, [record])
    widths = [intervals.half_width(found.predicted, np.full_like(found.spread, d), found.u, 0.9).mean() for d in (0, 1)]
    assert widths[1] > 3 * widths[0]


def test_optimism_widens_every_level_alike():
    found, record = drawn(1)
    plain, wider = (
        calibrate(found, [record], k).half_width(found.predicted, found.spread, found.u, 0.9) for k in (1.0, 2.0)
    )
    np.testing.assert_allclose(wider, 2 * plain)


def test_few_independent_errors_widen_the_interval():
    """The same values of errors: in a random order, and sorted in waves that follow each other."""
    found, record = drawn(1, samples=400)
    ordered = np.sort(found.error, axis=1)
    waves = found._replace(error=np.concatenate([ordered[:, ::2], ordered[:, ::-2]], 1))
    assert waves.independent[0] < 0.1 * found.independent[0]
    widths = [calibrate(one, [record]).half_width(*one[:2], one.u, 0.9).mean() for one in (found, waves)]
    assert widths[1] > 1.1 * widths[0]


def without_mean(intervals):
    """The intervals of errors whose mean is known to be zero."""
    return intervals._replace(mean=0 * intervals.mean, covariance=0 * intervals.covariance)


def test_outside_the_range_of_training_the_interval_grows_with_the_distance():
    """More so the fewer errors say what their mean is; inside a long record they say enough."""
    far = np.array([1e3, 2e3])[None, :, None]
    zero, widths = np.zeros(far.shape), []
    for samples in (100, 3000):
        found, record = drawn(1, samples=samples)
        intervals = calibrate(found, [record])
        known = without_mean(intervals)
        half, of_known = (one.half_width(far, zero, zero, 0.9)[0, :, 0] for one in (intervals, known))
        assert half[1] / half[0] == pytest.approx(2.0, rel=0.01)
        np.testing.assert_allclose(of_known[1], of_known[0], rtol=0.01)  # the second is a sample later
        widths.append(half[0])
    assert widths[0] > 2 * widths[1]
    inside_range, of_known = (one.half_width(*found[:2], found.u, 0.9) for one in (intervals, known))
    np.testing.assert_allclose(inside_range, of_known, rtol=0.03)


def test_a_mean_error_that_few_samples_cannot_tell_is_covered():
    """Errors whose mean changes with the output, calibrated near zero and met far from it."""
    rng, shares = np.random.default_rng(3), []
    for _ in range(100):
        slope = rng.standard_normal()  # of the error's deviation per deviation of the output
        near, far = rng.standard_normal((1, 40, 1)), rng.uniform(3.0, 6.0, (1, 200, 1))
        errors = [slope * y + rng.standard_normal(y.shape) for y in (near, far)]
        u = np.zeros(near.shape)
        found = LeftOut(near, u, errors[0], u, np.ones(near.shape, bool))
        intervals = calibrate(found, [Record(u, near, found.measured, INFO)])
        known, zero = without_mean(intervals), np.zeros(far.shape)
        half = [one.half_width(far, zero, zero, 0.9) for one in (intervals, known)]
        shares.append([np.mean(np.abs(errors[1]) < one) for one in half])
    covered, without = np.mean(shares, axis=0)
    assert 0.85 < covered < 0.98
    assert without < 0.75


def test_without_left_out_samples_there_is_no_interval():
    found, record = drawn(1, samples=50)
    assert calibrate(found._replace(measured=np.zeros_like(found.measured)), [record]) is None


@pytest.mark.parametrize("level", [0.0, 1.0, -0.1, 90.0])
def test_a_level_that_is_none(level):
    found, record = drawn(1, samples=50)
    with pytest.raises(ValueError, match="interval: expected a level between 0 and 1, for example 0.9, found"):
        calibrate(found, [record]).half_width(found.predicted, found.spread, found.u, level)
