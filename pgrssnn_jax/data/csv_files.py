"""The records of an experiment from users' CSV files (`records/csv.py`)."""

from pathlib import Path

from pgrssnn_jax.data.sources import channels
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.csv import read_csv
from pgrssnn_jax.records.record import Record, Splits, stack
from pgrssnn_jax.records.splits import front, split_tail


def load_csv(
    *,
    train: str | Path,
    test: str | Path,
    validation: str | Path | None = None,
    physics: Physics,
    n_train: int | None = None,
    n_validation: int | None = None,
) -> Splits:
    """The three records of an experiment on users' files, each `[1, seq, time, channel]`.

    validation: None takes it from the end of `train`: the last quarter of the samples of a single sequence, the last
    quarter (at least one) of several sequences. n_train, n_validation: samples per sequence; training samples count
    from the front, None: all.
    """

    def read(key: str, path: str | Path) -> Record:
        try:
            return read_csv(path, channels(physics.inputs), channels(physics.outputs), physics.dt)
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from None

    fitted, tested = read("data.train", train), read("data.test", test)
    if validation is None:
        fitted, validated = split_tail(fitted, n_validation)
    else:
        validated = front(read("data.validation", validation), "data.n_validation", n_validation)
    fitted = front(fitted, "data.n_train", n_train)
    for key, part in (("data.train", fitted), ("data.validation", validated), ("data.test", tested)):
        if not part.mask.any():
            raise ValueError(f"{key}: expected at least one measured output, found none in {part.info.origin}")
    return Splits(*(stack([part]) for part in (fitted, validated, tested)))
