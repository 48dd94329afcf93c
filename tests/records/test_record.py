import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toys import small_record

from pgrssnn_jax.records.record import Channel, RecordInfo, cast, crop, record, stack, take, windows

INFO = RecordInfo((Channel("f", "N"), Channel("g")), (Channel("p", "m"),), 0.1, "file", "somewhere")


def signals(n_seq=2, n_time=6):
    draw = np.random.default_rng(0)
    return draw.normal(size=(n_seq, n_time, 2)), draw.normal(size=(n_seq, n_time, 1))


def test_signals_are_kept_and_count_everywhere():
    u, y = signals()
    r = record(u, y, INFO)
    np.testing.assert_array_equal(r.u, u)
    np.testing.assert_array_equal(r.y, y)
    assert r.mask.shape == y.shape
    assert r.mask.all()
    assert r.info is INFO


def test_one_sequence_gets_its_axis():
    u, y = signals(1)
    mask = np.arange(6)[:, None] > 2
    r = record(u[0], y[0], INFO, mask)
    assert (r.u.shape, r.y.shape, r.mask.shape) == ((1, 6, 2), (1, 6, 1), (1, 6, 1))
    np.testing.assert_array_equal(r.mask[0], mask)


def test_what_was_not_measured_is_finite_and_does_not_count():
    u, y = signals()
    y[1, 3], y[0, 5] = np.nan, np.inf
    r = record(u, y, INFO, np.isfinite(y))
    assert not r.mask[1, 3, 0]
    assert r.mask.sum() == 10
    assert np.isfinite(r.y).all()
    np.testing.assert_array_equal(r.y[r.mask], y[np.isfinite(y)])


def test_mask_of_one_sample_goes_for_all_sequences():
    u, y = signals()
    mask = np.array([True, True, False, True, True, True])[:, None]
    np.testing.assert_array_equal(record(u, y, INFO, mask).mask, np.stack([mask, mask]))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_precision_is_left_alone(dtype):
    u, y = (a.astype(dtype) for a in signals())
    r = record(u, y, INFO)
    assert (r.u.dtype, r.y.dtype) == (dtype, dtype)


@pytest.mark.parametrize(
    ("u", "y"),
    [
        (np.zeros((5, 2)), np.zeros((6, 1))),
        (np.zeros((2, 5, 2)), np.zeros((1, 5, 1))),
        (np.zeros(5), np.zeros(5)),
        (np.zeros((1, 5, 2)), np.zeros((5, 1))),
        (np.zeros((1, 1, 5, 2)), np.zeros((1, 1, 5, 1))),
    ],
)
def test_shapes_that_disagree_are_named(u, y):
    with pytest.raises(ValueError, match=r"u and y: expected \[sequence, time, channel\].*found"):
        record(u, y, INFO)


def test_channels_must_be_those_of_the_info():
    u, y = signals()
    with pytest.raises(ValueError, match=r"channels: expected \(2, 1\) .*found \(2, 2\)"):
        record(u, u, INFO)
    with pytest.raises(ValueError, match=r"channels: expected \(2, 1\) .*found \(1, 1\)"):
        record(y, y, INFO)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_count_are_finite(bad):
    u, y = signals()
    u[0, 0, 1] = bad
    with pytest.raises(ValueError, match="expected finite numbers"):
        record(u, y, INFO)
    u, y = signals()
    y[1, 2] = bad
    with pytest.raises(ValueError, match="expected finite numbers"):
        record(u, y, INFO)


@settings(deadline=None, max_examples=40, derandomize=True)
@given(n_seq=st.integers(1, 3), n_time=st.integers(1, 13), length=st.integers(1, 13))
def test_windows_laid_end_to_end_are_the_sequences(n_seq, n_time, length):
    u, y = signals(n_seq, n_time)
    mask = y > 0
    whole = record(u, y, INFO, mask)
    if length > n_time:
        with pytest.raises(ValueError, match=rf"length: expected between 1 and .*{n_time} .*found {length}"):
            windows(whole, length)
        return
    cut = windows(whole, length)
    count = n_time // length
    for piece, a in zip(cut[:3], whole[:3], strict=True):
        assert piece.shape == (n_seq * count, length, a.shape[-1])
        for s in range(n_seq):
            joined = np.concatenate(piece[s * count : (s + 1) * count])
            np.testing.assert_array_equal(joined, a[s, : count * length])


def test_windows_of_nothing_are_refused():
    with pytest.raises(ValueError, match="length: expected between 1 and .*found 0"):
        windows(record(*signals(), INFO), 0)


def test_windows_and_crop_leave_leading_axes_alone():
    records = [record(*(a + i for a in signals()), INFO) for i in range(3)]
    together = stack(records)
    for i, one in enumerate(records):
        for change in (lambda r: windows(r, 4), lambda r: crop(r, 1, 5)):
            for a, b in zip(change(together)[:3], change(one)[:3], strict=True):
                np.testing.assert_array_equal(a[i], b)


def test_crop_takes_samples_from_start_to_stop():
    u, y = signals()
    part = crop(record(u, y, INFO, y > 0), 2, 5)
    np.testing.assert_array_equal(part.u, u[:, 2:5])
    np.testing.assert_array_equal(part.mask, y[:, 2:5] > 0)
    np.testing.assert_array_equal(part.y, np.where(y > 0, y, 0)[:, 2:5])


def test_take_undoes_stack():
    records = [record(*(a + i for a in signals()), INFO) for i in range(3)]
    together = stack(records)
    assert together.u.shape == (3, 2, 6, 2)
    assert together.info is INFO
    for i, one in enumerate(records):
        for a, b in zip(take(together, i)[:3], one[:3], strict=True):
            np.testing.assert_array_equal(a, b)
    some = take(together, np.array([2, 0]))
    np.testing.assert_array_equal(some.y, np.stack([records[2].y, records[0].y]))


def test_stack_needs_equal_shapes():
    with pytest.raises(ValueError, match=r"stack: records: expected equal shapes, found"):
        stack([record(*signals(2), INFO), record(*signals(1), INFO)])


def test_cast_changes_precision_and_nothing_else():
    whole = record(*signals(), INFO)
    half = cast(whole, np.float32)
    assert (half.u.dtype, half.y.dtype, half.mask.dtype) == (np.float32, np.float32, np.bool_)
    np.testing.assert_array_equal(half.u, whole.u.astype(np.float32))
    assert half.info is INFO


def test_a_record_passes_through_jit_and_vmap_with_its_info():
    whole = small_record(*signals())
    energy = jax.jit(lambda r: (r._replace(u=2 * jnp.asarray(r.u)), jnp.sum(r.y**2) * r.info.dt))
    doubled, value = energy(whole)
    assert doubled.info == whole.info
    np.testing.assert_allclose(doubled.u, 2 * whole.u, rtol=1e-6)
    np.testing.assert_allclose(value, 0.5 * np.sum(whole.y**2), rtol=1e-5)
    each = jax.vmap(lambda r: r.y.sum())(stack([whole, whole]))
    np.testing.assert_allclose(each, [whole.y.sum()] * 2, rtol=1e-5)


def test_a_record_shows_how_much_of_what_from_where():
    u, y = signals(1, 6)
    whole = record(u, y, INFO)
    assert repr(whole._replace(validation=crop(whole, 4, 6))).splitlines() == [
        "Record of 1 sequence of 6 samples, one every 0.1 s",
        "  inputs: f (N), g (–)",
        "  outputs: p (m)",
        "  validation: 1 sequence of 2 samples, one every 0.1 s",
        "  source: file: somewhere",
    ]
    assert repr(stack([record(*signals(), INFO)] * 3)).startswith("Record of 3 datasets of 2 sequences of 6 samples")
