"""Errors of samples by the members that left them out, and how much luck is in the epoch that each member keeps."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pgrssnn_jax.records.record import Channel, Record, RecordInfo
from pgrssnn_jax.training.left_out import LeftOut, at_epoch_of_others, by_long_blocks, left_out, optimism

INFO = RecordInfo((Channel("u"),), (Channel("y"),), 1.0, "simulated")


def validation(mask: np.ndarray, y: float = 0.0) -> Record:
    shape = mask.shape
    return Record(np.zeros(shape), np.full(shape, y), mask, INFO)


def test_every_sample_counts_for_the_member_that_left_it_out():
    aside = np.array([[True, False, False], [False, True, False]])[:, None, :, None]
    predicted = np.array([[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]])[:, None, :, None]
    found = left_out(predicted, validation(aside, y=100.0), [0, 0], [0, 1])
    assert found.measured[0, :, 0].tolist() == [True, True, False]
    np.testing.assert_allclose(found.predicted[0, :2, 0], [1.0, 20.0])
    np.testing.assert_allclose(found.spread[0, :, 0], [4.5, 9.0, 13.5])
    # by hand: errors 99 and 80, from which half of 4.5² + 9² is what one of two members has more than their mean
    factor = np.sqrt(1 - 0.5 * (4.5**2 + 9.0**2) / (99.0**2 + 80.0**2))
    np.testing.assert_allclose(found.error[0, :2, 0], factor * np.array([99.0, 80.0]))


def test_members_that_leave_out_the_same_record_are_judged_by_their_mean():
    predicted = np.array([1.0, 3.0])[:, None, None, None] * np.ones((1, 1, 4, 1))
    found = left_out(predicted, validation(np.ones((2, 1, 4, 1), bool), y=5.0), [0, 0], [0, 1])
    np.testing.assert_allclose(found.error, 3.0)


def test_datasets_stand_below_each_other_and_failed_members_do_not_count():
    predicted = np.array([1.0, 2.0, np.nan])[:, None, None, None] * np.ones((1, 1, 4, 1))
    found = left_out(predicted, validation(np.ones((3, 1, 4, 1), bool)), [0, 1, 1], [0, 1])
    np.testing.assert_allclose(found.error[:, 0, 0], [-1.0, -2.0])


def test_a_lucky_epoch_of_one_member_is_not_taken_for_its_error():
    losses = np.array([[4.0, 0.1, 3.0, 2.0], [4.0, 3.0, 2.0, 1.0], [4.0, 3.0, 2.0, 1.0]])
    assert at_epoch_of_others(losses).tolist() == [2.0, 3.0, 3.0]
    assert at_epoch_of_others(losses[:1]).tolist() == [0.1]
    assert optimism(losses) > 1.5


def test_losses_that_fall_together_are_not_optimistic():
    falling = np.outer([1.0, 5.0, 0.2], np.linspace(2.0, 1.0, 9))
    assert optimism(falling) == pytest.approx(1.0)
    assert optimism(1e6 * falling) == pytest.approx(1.0)


def test_members_that_stopped_stay_as_they_were_and_epochs_without_validation_do_not_count():
    losses = np.array([[np.nan, 2.0, np.nan, 1.0, np.nan, np.nan], [np.nan, 2.0, np.nan, 1.0, np.nan, 1.5]])
    assert optimism(losses) == pytest.approx(1.0)
    assert optimism(np.full((2, 3), np.nan)) == 1.0
    assert optimism(np.zeros((2, 0))) == 1.0


def test_errors_that_follow_each_other_count_as_few():
    """An autoregression with a pole at a is worth (1 - a) / (1 + a) of its samples."""
    rng, time = np.random.default_rng(0), 20000
    white = rng.standard_normal((1, time, 1))
    slow = lfilter([1.0], [1.0, -0.9], white, axis=1)
    for error, share in ((white, 1.0), (slow, 0.1 / 1.9)):
        found = LeftOut(error, error, error, error, np.ones(error.shape, bool))
        assert found.independent[0] == pytest.approx(share * time, rel=0.2)


def test_errors_on_long_blocks_widen_what_short_ones_say():
    """Compared after as many epochs; short blocks that are no easier change nothing."""
    losses = np.outer([1.0, 4.0], [9.0, 4.0, 1.0, 0.25])
    assert by_long_blocks(losses, 4.0, 2) == pytest.approx(4.0 / np.sqrt(2 * 4.0))
    assert by_long_blocks(losses, 1.0, 2) == 1.0
    assert by_long_blocks(np.full((2, 4), np.nan), 4.0, 2) == 1.0
