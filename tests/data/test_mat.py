"""MAT files of robot sequences: units, order, and one sentence for each way in which a file can be bad."""

import numpy as np
import pytest
import scipy.io

from pgrssnn_jax.data.mat import read_mat

JOINTS, SAMPLES = 3, 5


def arrays(**other):
    """Two training sequences, one of the others; every number tells its array, joint and column."""
    found = {}
    for k, (part, count) in enumerate((("train", 2), ("val", 1), ("test", 1))):
        column = np.arange(count * SAMPLES, dtype=float)
        found[f"u_{part}"] = 1000 * k + 100 * np.arange(JOINTS)[:, None] + column
        found[f"y_{part}"] = -found[f"u_{part}"]
    return {**found, **other}


@pytest.fixture
def write(tmp_path):
    def write(**other):
        content = {key: value for key, value in arrays(**other).items() if value is not None}
        scipy.io.savemat(tmp_path / "a.mat", content)
        return tmp_path / "a.mat"

    return write


def test_sequences_back_to_back_become_an_axis(write):
    found = read_mat(write(), JOINTS, SAMPLES)
    assert found.train.u.shape == found.train.y.shape == (2, SAMPLES, JOINTS)
    assert found.validation.u.shape == found.test.y.shape == (1, SAMPLES, JOINTS)
    # Second sequence, fourth sample, third joint.
    assert found.train.u[1, 3, 2] == 200 + SAMPLES + 3
    np.testing.assert_array_equal(found.validation.u[0, :, 0], 1000 + np.arange(SAMPLES))


def test_degrees_become_radians_and_torques_stay(write):
    found = read_mat(write(), JOINTS, SAMPLES)
    for part in found[:3]:
        np.testing.assert_allclose(part.y, -np.pi / 180 * part.u)


def test_the_digest_is_that_of_the_file(write):
    first, again, other = (read_mat(write(**change), JOINTS, SAMPLES).digest for change in ({}, {}, {"more": 1.0}))
    assert len(first) == 12
    # SciPy writes the time into its header.
    assert other not in (first, again)


@pytest.mark.parametrize("options", [{"do_compression": True}, {"format": "4"}])
def test_other_forms_of_the_format(tmp_path, options):
    scipy.io.savemat(tmp_path / "a.mat", arrays(), **options)
    assert read_mat(str(tmp_path / "a.mat"), JOINTS, SAMPLES).train.u.shape == (2, SAMPLES, JOINTS)


def test_whole_numbers_are_numbers(write):
    found = read_mat(write(u_test=np.ones((JOINTS, SAMPLES), np.int16)), JOINTS, SAMPLES)
    assert found.test.u.dtype == np.float64


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        pytest.param(
            {"y_val": None},
            "array 'y_val': expected it in the file, found u_test, u_train, u_val, y_test, y_train",
            id="missing",
        ),
        pytest.param(
            {"u_train": np.ones((4, 10))},
            "array 'u_train': expected 3 rows, one for each joint of the physics, found shape (4, 10)",
            id="joints",
        ),
        pytest.param(
            {"u_train": np.ones((3, 2, 5))},
            "array 'u_train': expected 3 rows, one for each joint of the physics, found shape (3, 2, 5)",
            id="axes",
        ),
        pytest.param(
            {"u_train": np.ones((3, 11)), "y_train": np.ones((3, 11))},
            "array 'u_train': expected a multiple of 5 columns, the samples of a sequence, found 11",
            id="no multiple",
        ),
        pytest.param(
            {"u_test": np.ones((3, 0)), "y_test": np.ones((3, 0))},
            "array 'u_test': expected a multiple of 5 columns, the samples of a sequence, found 0",
            id="no sequence",
        ),
        pytest.param(
            {"y_test": np.ones((3, 10))}, "array 'y_test': expected 5 columns, as 'u_test', found 10", id="lengths"
        ),
        pytest.param(
            {"u_val": np.where(np.arange(5) == 2, np.nan, np.ones((3, 5)))},
            "array 'u_val': expected finite numbers, found nan in row 1, column 3",
            id="NaN",
        ),
        pytest.param(
            {"u_val": np.ones((3, 5)) + 1j}, "array 'u_val': expected a matrix of real numbers, found ", id="complex"
        ),
        pytest.param(
            {"u_val": np.array([["a", "b"]])}, "array 'u_val': expected a matrix of real numbers, found ", id="text"
        ),
        pytest.param({"u_val": {"a": 1}}, "array 'u_val': expected a matrix of real numbers, found ", id="struct"),
        pytest.param(
            {"u_val": scipy.sparse.csc_array(np.eye(3))},
            "array 'u_val': expected a matrix of real numbers, found ",
            id="sparse",
        ),
        pytest.param(
            {key: np.deg2rad(value) / 100 for key, value in arrays().items()},
            "positions y_*: expected degrees, found no value beyond ±0.385, which looks like radians",
            id="radians",
        ),
    ],
)
def test_a_bad_array_is_one_sentence_with_its_place(write, change, expected):
    file = write(**change)
    with pytest.raises(ValueError) as caught:
        read_mat(file, JOINTS, SAMPLES)
    assert str(caught.value).startswith(f"{file}: {expected}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "expected a MAT file, found no such file"),
        (b"", "expected a readable MAT file, found "),
        (b"time, torque_1\n0.0, 1.0\n" * 30, "expected a readable MAT file, found "),
        (b"\x89HDF\r\n\x1a\n" + bytes(600), "expected a MAT file up to version 7.2, found version 7.3"),
        (b"MATLAB 7.3 MAT-file, Platform" + bytes(600), "expected a MAT file up to version 7.2, found version 7.3"),
    ],
)
def test_what_is_no_such_file(tmp_path, content, expected):
    file = tmp_path / "a.mat"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ValueError) as caught:
        read_mat(file, JOINTS, SAMPLES)
    assert str(caught.value).startswith(f"{file}: {expected}")
    assert "\n" not in str(caught.value)


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="expected a readable MAT file, found Is a directory"):
        read_mat(tmp_path, JOINTS, SAMPLES)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_off_anywhere_is_one_sentence(tmp_path, compressed):
    scipy.io.savemat(tmp_path / "a.mat", arrays(), do_compression=compressed)
    content = (tmp_path / "a.mat").read_bytes()
    for kept in range(0, len(content) - 1, 17):
        (tmp_path / "cut.mat").write_bytes(content[:kept])
        with pytest.raises(ValueError) as caught:
            read_mat(tmp_path / "cut.mat", JOINTS, SAMPLES)
        assert str(caught.value).startswith(f"{tmp_path / 'cut.mat'}: ")
        assert "\n" not in str(caught.value)
