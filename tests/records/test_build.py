"""Records from arrays in memory: shapes that people have, samples that were not measured, and what is refused."""

from collections.abc import Iterator

import jaxtyping
import numpy as np
import pytest

from pgrssnn_jax.records.build import record_from
from pgrssnn_jax.records.record import Channel, valid_mask

ONE = {"dt": 0.5, "inputs": {"pump_voltage": "V"}, "outputs": {"level_voltage": "V"}}
TWO = {"dt": 0.5, "inputs": {"f": "N", "g": ""}, "outputs": {"p": "m", "q": "rad"}}
DRAW = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def unchecked() -> Iterator[None]:
    """Types are checked in tests only: here what users get to see without."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def test_a_record_knows_its_channels_its_sample_time_and_its_start():
    found = record_from(np.zeros((4, 2)), np.ones((4, 2)), **TWO, start="shared")
    assert found.info.inputs == (Channel("f", "N"), Channel("g", ""))
    assert found.info.outputs == (Channel("p", "m"), Channel("q", "rad"))
    assert (found.info.dt, found.info.start, found.info.padded, found.info.benchmark) == (0.5, "shared", False, "")
    assert record_from(np.zeros((4, 2)), np.ones((4, 2)), **TWO).info.start == "unknown"


@pytest.mark.parametrize("shape", [(7, 2), (3, 7, 2)], ids=["time", "sequences"])
def test_arrays_are_taken_as_they_are(shape):
    u, y = DRAW.normal(size=shape), DRAW.normal(size=shape)
    found = record_from(u, y, **TWO)
    assert found.u.shape == (shape[0] if len(shape) == 3 else 1, 7, 2)
    np.testing.assert_array_equal(found.u.reshape(shape), u)
    np.testing.assert_array_equal(found.y.reshape(shape), y)
    assert found.mask.all()
    assert valid_mask(found) is None


@pytest.mark.parametrize("kind", [np.asarray, list, lambda a: a[:, None]], ids=["array", "numbers", "column"])
def test_a_single_channel_needs_no_axis(kind):
    u, y = np.arange(5.0), np.arange(5.0) + 10
    found = record_from(kind(u), kind(y), **ONE)
    assert found.u.shape == found.y.shape == (1, 5, 1)
    np.testing.assert_array_equal(found.u[0, :, 0], u)
    np.testing.assert_array_equal(found.y[0, :, 0], y)


@pytest.mark.parametrize("kind", [list, tuple])
@pytest.mark.parametrize("axis", [True, False], ids=["column", "no axis"])
def test_sequences_of_any_length_are_padded_with_what_came_last(kind, axis):
    us = [np.arange(n) + 10.0 * i for i, n in enumerate((3, 5, 2))]
    given = [u[:, None] for u in us] if axis else us
    found = record_from(kind(given), kind([1 + u for u in given]), **ONE)
    assert found.u.shape == (3, 5, 1)
    assert found.info.padded
    for i, u in enumerate(us):
        np.testing.assert_array_equal(found.u[i, :, 0], np.append(u, [u[-1]] * (5 - len(u))))
        np.testing.assert_array_equal(found.y[i, : len(u), 0], 1 + u)
        np.testing.assert_array_equal(found.mask[i, :, 0], np.arange(5) < len(u))
    np.testing.assert_array_equal(valid_mask(found), np.arange(5) < np.array([[3], [5], [2]]))


def test_sequences_of_equal_length_are_not_padded():
    found = record_from([np.zeros((4, 2))] * 3, [np.ones((4, 2))] * 3, **TWO)
    assert (found.u.shape, found.info.padded) == ((3, 4, 2), False)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_number_was_not_measured(bad):
    y = DRAW.normal(size=(2, 6, 2))
    y[0, 1, 1] = y[1, 5] = bad
    found = record_from(np.zeros((2, 6, 2)), y, **TWO)
    np.testing.assert_array_equal(found.mask, np.isfinite(y))
    np.testing.assert_array_equal(found.y[found.mask], y[np.isfinite(y)])
    assert np.isfinite(found.y).all()


@pytest.mark.parametrize("dtype", [bool, int])
def test_a_mask_and_missing_numbers_add_up(dtype):
    y, mask = DRAW.normal(size=(6, 2)), np.ones((6, 2), bool)
    mask[0], y[3, 1] = False, np.nan
    found = record_from(np.zeros((6, 2)), y, **TWO, mask=mask.astype(dtype))
    expected = mask.copy()
    expected[3, 1] = False
    np.testing.assert_array_equal(found.mask[0], expected)


def test_every_sequence_may_have_a_mask_of_its_own():
    ys = [np.arange(3.0), np.arange(4.0)]
    masks = [np.array([True, False, True]), np.array([True, True, True, False])]
    found = record_from(ys, ys, **ONE, mask=masks)
    np.testing.assert_array_equal(found.mask[..., 0], [[1, 0, 1, 0], [1, 1, 1, 0]])


def test_whole_numbers_become_floating_point_numbers():
    found = record_from(np.arange(4), np.arange(4), **ONE)
    assert (found.u.dtype, found.y.dtype, found.mask.dtype) == (np.float64, np.float64, np.bool_)


def test_what_was_given_is_not_changed():
    y = np.array([1.0, np.nan, 3.0])
    record_from(np.zeros(3), y, **ONE)
    assert np.isnan(y[1])


G = np.zeros((4, 2))


@pytest.mark.parametrize(
    ("u", "y", "more", "sentence"),
    [
        (G, G, {"dt": 0.0}, "dt: expected a positive sample time in seconds, found 0.0"),
        (G, G, {"dt": float("nan")}, "dt: expected a positive sample time in seconds, found nan"),
        (G, G, {"start": "zero"}, r"start: expected one of \['unknown', 'rest', 'shared'\], found 'zero'"),
        (G, G, {"inputs": ["f", "g"]}, r"inputs: expected names with units, .*, found \['f', 'g'\]"),
        (G, G, {"outputs": "pq"}, "outputs: expected names with units, .*, found 'pq'"),
        (G, np.zeros((5, 2)), {}, r"u and y: expected sequences of equal lengths, found \[4\] and \[5\]"),
        ([G, G], [G, G[:3]], {}, r"u and y: expected sequences of equal lengths, found \[4, 4\] and \[4, 3\]"),
        ([G, G], G, {}, r"u and y: expected sequences of equal lengths, found \[4, 4\] and \[4\]"),
        (np.zeros((4, 3)), G, {}, r"u: expected \[time, 2\] or sequences of it, found shape \(4, 3\)"),
        (G, np.zeros(4), {}, r"y: expected \[time, 2\] or sequences of it, found shape \(4,\)"),
        (G, np.zeros((1, 2, 4, 2)), {}, r"y: expected \[time, 2\] or sequences of it, found shape \(2, 4, 2\)"),
        (G[:0], G[:0], {}, r"u: expected \[time, 2\] or sequences of it, found shape \(0, 2\)"),
        ([G, G[:0]], [G, G[:0]], {}, r"u: expected \[time, 2\] or sequences of it, found shape \(0, 2\)"),
        ([], [], {}, "u: expected at least one sequence, found none"),
        (np.float64(1.0), G, {}, r"u: expected \[time, 2\] or sequences of it, found shape \(\)"),
        (G, G, {"mask": np.ones(4, bool)}, r"mask: expected \[time, 2\] or sequences of it, found shape \(4,\)"),
        (G, G, {"mask": np.ones((3, 2), bool)}, r"mask: expected sequences of the lengths of y, \[4\], found \[3\]"),
        (np.full((4, 2), np.nan), G, {}, "u: expected finite numbers, found nan in sample 0 of 'f'"),
        ([G, G + np.inf], [G, G], {}, "u: expected finite numbers, found inf in sequence 1, sample 0 of 'f'"),
    ],
)
def test_what_is_no_record_is_refused_in_one_sentence(u, y, more, sentence):
    with pytest.raises(ValueError, match=f"^record: .*{sentence}"):
        record_from(u, y, **{**TWO, **more})


def test_a_mask_of_another_length_is_named():
    with pytest.raises(ValueError, match=r"mask: .*found .*\[3\]"):
        record_from(G, G, **TWO, mask=np.ones((3, 2), bool))
