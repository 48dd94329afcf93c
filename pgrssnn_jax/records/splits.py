"""Cross-validation across members: every member sets other blocks of the record aside.

    sample t trains member m where floor(t / block) mod folds ≠ seed(m) mod folds, and validates it elsewhere

All members predict the whole record; only the masks differ. Nothing of the record is lost to the ensemble, and early
stopping sees every part of it, also where a physics has been fitted to all of it.
Source: Krogh and Vedelsby, Neural network ensembles, cross validation, and active learning, NIPS 1995.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgrssnn_jax.data.sources import check_count
from pgrssnn_jax.records.record import Record, continues, join, stack, take


@dataclass(frozen=True)
class KFold:
    """folds: how many members share a record between them, 0: none, the split stands; block: samples that are set
    aside together."""

    folds: int = 0
    block: int = 32

    def __post_init__(self) -> None:
        if self.folds < 0 or self.folds == 1:
            raise ValueError(f"data.folds: expected 0 (the split of the data) or at least 2, found {self.folds}")
        check_count("data.block", self.block, 1, 10**9, "samples")


def kfold_masks(train: Record, validation: Record, seeds: Sequence[int], folds: KFold) -> tuple[Record, Record]:
    """The records of members `[member, seq, time, channel]` with masks by their seeds.

    Raises `ValueError` where the two records are not one run, or too short for every fold to have a block, or have no
    measured sample in a fold.
    """
    runs = []
    for member in range(len(train.u)):
        first, second = take(train, member), take(validation, member)
        if not continues(first, second):
            raise ValueError("data.folds: expected 0 where validation does not go on right after training, in one run")
        runs.append(join(first, second))
    whole = stack(runs)
    time = whole.u.shape[2]
    if time < folds.folds * folds.block:
        raise ValueError(
            f"data.folds: expected at least folds x block = {folds.folds * folds.block} samples to share, found {time}"
        )
    fold = np.arange(time) // folds.block % folds.folds
    aside = fold == np.asarray(seeds)[:, None] % folds.folds
    aside = aside[:, None, :, None]
    seen, kept_back = (np.asarray(whole.mask) & which for which in (~aside, aside))
    for name, mask in (("train", seen), ("validate", kept_back)):
        if not mask.any((1, 2, 3)).all():
            raise ValueError(f"data.folds: expected measured samples to {name} on in every fold, found one with none")
    return whole._replace(mask=seen), whole._replace(mask=kept_back, info=replace(whole.info, same_run=True))
