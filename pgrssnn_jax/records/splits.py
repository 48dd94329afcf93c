"""Which part of an estimation record validates: a record of its own, its tail, or blocks that members take in turn.

    sample t trains member m where floor(t / block) mod folds ≠ seed(m) mod folds, and validates it elsewhere
    (of sequence s: (floor(t / block) + s) mod folds; where sequences are many, s mod folds)

In k-fold cross-validation across members all members predict the whole record; only the masks differ. Nothing of the
record is lost to the ensemble, and early stopping sees every part of it, also where a physics has been fitted to it.
Source: Krogh and Vedelsby, Neural network ensembles, cross validation, and active learning, NIPS 1995.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgrssnn_jax.records.arguments import check_count
from pgrssnn_jax.records.record import Record, continues, crop, join, map_signals, stack, take, windows

_TAIL = 4  # one part in so many of a record validates where nothing else is said


def kfold_masks(
    train: Record,
    validation: Record,
    seeds: Sequence[int],
    folds: int,
    block: int = 32,
    *,
    lead: int = 0,
    one_record: bool = False,
) -> tuple[Record, Record]:
    """The records of members `[member, seq, time, channel]` with masks by their seeds.

    folds: how many members share a record between them; block: samples that are set aside together; of a record with at
    least `folds` sequences, whole sequences are. lead: first samples of every sequence that are never set aside.
    one_record: the validation record was cut from the training record. A validation record that is a later part of the
    same measurement, with a gap before it, is never trained on. Raises `ValueError` where the two records are not one,
    or too short for every fold to have a block, or have no measured sample in a fold.
    """
    if folds < 2:
        raise ValueError(f"data.folds: expected 0 (the split of the data) or at least 2, found {folds}")
    check_count("data.block", block, 1, 10**9, "samples")
    runs, later = [], False
    for member in range(len(train.u)):
        first, second = take(train, member), take(validation, member)
        later = is_later(first, second)
        if not (one_record or later or continues(first, second)):
            raise ValueError("data.folds: expected 0 where validation does not go on right after training, in one run")
        runs.append(join(first, second))
    whole = stack(runs)
    n_seq, time = whole.u.shape[1:3]
    trained = n_seq - 1 if later else n_seq  # sequences that are trained on by some member
    samples = train.u.shape[2] if later else time
    by_sequence = trained >= folds
    if not by_sequence and samples < folds * block:
        raise ValueError(
            f"data.folds: expected at least folds x block = {folds * block} samples to share, found {samples}"
        )
    sequence, sample = np.arange(n_seq)[:, None], np.arange(time)[None]
    fold = (np.where(by_sequence, 0, sample // block) + sequence) % folds
    aside = (fold == np.asarray(seeds)[:, None, None] % folds) & (sample >= lead)
    aside = (aside | (sequence >= trained))[..., None]
    seen, kept_back = (np.asarray(whole.mask) & which for which in (~aside, aside))
    for name, mask in (("train", seen), ("validate", kept_back)):
        if not mask.any((1, 2, 3)).all():
            raise ValueError(f"data.folds: expected measured samples to {name} on in every fold, found one with none")
    return whole._replace(mask=seen), whole._replace(mask=kept_back, info=replace(whole.info, same_run=True))


def is_later(first: Record, second: Record) -> bool:
    """Is the second record, of one sequence, a later part of the measurement of the first, with a gap between them?"""
    same = replace(first.info, begins=0) == replace(second.info, begins=0)
    return len(first.u) == len(second.u) == 1 and same and second.info.begins > first.info.begins + first.u.shape[1]


def by_dataset(whole: Record) -> Record:
    """A record with its leading axis of datasets (realisations), `[dataset, seq, time, channel]`."""
    return whole._replace(validation=None) if whole.u.ndim == 4 else stack([whole])


def estimation_parts(train: Record, validation: Record | None = None) -> tuple[Record, Record]:
    """The training and the validation part, `[dataset, seq, time, channel]`: the validation record that is given, else
    the one that came with the data, else the tail of the training record."""
    aside = train.validation if validation is None else validation
    if aside is None:
        train, aside = split_tail(train)
    return by_dataset(train), by_dataset(aside)


def split_tail(whole: Record, count: int | None = None) -> tuple[Record, Record]:
    """A record without its end, and its end: samples in time of a single sequence (count, None: a quarter), or the last
    quarter of several sequences, of which the first `count` samples."""
    n_seq, time = whole.u.shape[-3:-1]
    if n_seq == 1:
        tail = max(1, time // _TAIL) if count is None else count
        check_count("data.n_validation", tail, 1, time - 1, f"of the {time} samples in {whole.info.origin}")
        return crop(whole, 0, time - tail), crop(whole, time - tail, time)
    cut = n_seq - max(1, n_seq // _TAIL)
    return _sequences(whole, slice(0, cut)), front(_sequences(whole, slice(cut, None)), "data.n_validation", count)


def front(whole: Record, key: str, count: int | None) -> Record:
    """The first `count` samples of every sequence; key: the setting that says so, for messages."""
    if count is None:
        return whole
    check_count(key, count, 1, whole.u.shape[-2], f"samples per sequence in {whole.info.origin}")
    return crop(whole, 0, count)


def cut_windows(train: Record, length: int) -> Record:
    """Training sequences `[dataset, seq, time, channel]` cut into windows; those that are nothing but padding go."""
    check_count("data.window", length, 1, train.u.shape[-2], "samples per training sequence")
    cut = windows(train, length)
    if not train.info.padded:
        return cut
    used = np.any(cut.mask, axis=(0, 2, 3))
    return map_signals(cut, lambda signal: signal[:, used])


def _sequences(whole: Record, which: slice) -> Record:
    return map_signals(whole, lambda signal: signal[..., which, :, :])
