"""From users' files to the three records of an experiment."""

import numpy as np
import pytest

from pgrssnn_jax.data.benchmarks import load_csv
from pgrssnn_jax.physics.tanks import cascaded_tanks

HEADER = "sequence,pump_voltage,level_voltage"


@pytest.fixture
def write(tmp_path):
    def write(name, *lengths, mask=1):
        """Samples that count up over the whole file, in sequences of these lengths."""
        labels = np.repeat(np.arange(len(lengths)), lengths)
        rows = [f"{label},{i},{i + 0.5},{mask}" for i, label in enumerate(labels)]
        file = tmp_path / f"{name}.csv"
        file.write_text("\n".join([HEADER + ",mask", *rows]))
        return file

    return write


def load(**options):
    return load_csv(physics=cascaded_tanks(), **options)


def samples(record):
    return record.u[0, ..., 0].tolist()


def test_validation_is_the_last_quarter_of_a_single_sequence(write):
    splits = load(train=write("a", 8), test=write("b", 3))
    assert samples(splits.train) == [[0, 1, 2, 3, 4, 5]]
    assert samples(splits.validation) == [[6, 7]]
    assert samples(splits.test) == [[0, 1, 2]]
    assert splits.train.y.shape == (1, 1, 6, 1)
    assert splits.test.info.origin.startswith("b.csv")


@pytest.mark.parametrize(("n_sequences", "expected"), [(2, 1), (3, 1), (4, 1), (8, 2), (11, 2)])
def test_validation_is_the_last_quarter_of_several_sequences(write, n_sequences, expected):
    splits = load(train=write("a", *[2] * n_sequences), test=write("b", 3))
    assert splits.validation.u.shape[1] == expected
    assert splits.train.u.shape[1] == n_sequences - expected
    assert samples(splits.train) + samples(splits.validation) == np.arange(2.0 * n_sequences).reshape(-1, 2).tolist()


def test_validation_from_a_file_leaves_the_training_file_whole(write):
    splits = load(train=write("a", 8), test=write("b", 3), validation=write("c", 5), n_validation=4)
    assert samples(splits.train) == [list(range(8))]
    assert samples(splits.validation) == [[0, 1, 2, 3]]


def test_fewer_training_samples_are_taken_from_the_front(write):
    splits = load(train=write("a", 12), test=write("b", 3), n_train=5, n_validation=2)
    assert samples(splits.train) == [[0, 1, 2, 3, 4]]
    assert samples(splits.validation) == [[10, 11]]


@pytest.mark.parametrize("key", ["train", "test", "validation"])
def test_messages_name_the_key_of_the_configuration(write, tmp_path, key):
    files = {"train": write("a", 8), "test": write("b", 8), "validation": write("c", 8)}
    with pytest.raises(ValueError, match=f"^data.{key}: .*: expected a readable CSV file, found no such file$"):
        load(**{**files, key: tmp_path / "no.csv"})
    with pytest.raises(ValueError, match=f"^data.{key}: expected at least one measured output, found none in d.csv"):
        load(**{**files, key: write("d", 8, mask=0)})


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ({"n_train": 7}, r"data.n_train: expected between 1 and 6 samples per sequence in a.csv.*, found 7"),
        ({"n_train": 0}, r"data.n_train: expected between 1 and 6 .*, found 0"),
        ({"n_validation": 8}, r"data.n_validation: expected between 1 and 7 of the 8 samples in a.csv.*, found 8"),
    ],
)
def test_counts_that_the_files_cannot_serve(write, option, expected):
    with pytest.raises(ValueError, match=f"^{expected}$"):
        load(train=write("a", 8), test=write("b", 3), **option)
