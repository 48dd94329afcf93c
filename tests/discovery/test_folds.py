"""Which samples a fit leaves out: all parts of every sequence in turn, however short it is."""

import numpy as np
import pytest
from discovery.small_cases import pump, tank_record

from pgrssnn_jax.discovery.problem import ALWAYS, Problem, build_problem, weighted_signals
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import Record

FOLDS = 5


@pytest.fixture(scope="module")
def problem() -> Problem:
    return build_problem(cascaded_tanks(), ())


def sequences(count: int, samples: int) -> Record:
    one = tank_record(pump(samples, 3))
    return one._replace(**{name: np.repeat(getattr(one, name), count, 0) for name in ("u", "y", "mask")})


@pytest.mark.parametrize(("count", "samples", "block"), [(60, 30, 30), (20, 64, 32), (12, 144, 32), (1, 1024, 32)])
def test_every_fold_has_its_part_and_no_sequence_is_spared(problem, count, samples, block):
    fold = weighted_signals(problem, sequences(count, samples), folds=FOLDS, block=block).block
    counted = fold >= 0
    assert np.isin(fold[~counted], ALWAYS).all()
    assert counted.any(1).all()
    assert counted.mean() > 0.85
    share = np.bincount(fold[counted], minlength=FOLDS) / counted.sum()
    assert share.min() > 0.5 / FOLDS


def test_sequences_take_turns(problem):
    """12 sequences of 144 samples: five blocks each, as many as folds."""
    fold = weighted_signals(problem, sequences(12, 144), folds=FOLDS, block=32).block
    assert len(set(fold[:, -1])) == FOLDS
