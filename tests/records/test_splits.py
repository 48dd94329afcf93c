"""Members that take turns in what they set aside: every sample validates once, and what is set aside is not seen."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from commands import planned
from small import simulated, small_fit
from toys import quick_jit

from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.build import record_from
from pgrssnn_jax.records.record import Record, cast, crop, stack
from pgrssnn_jax.records.splits import by_dataset, cut_windows, estimation_parts, kfold_masks, split_tail
from pgrssnn_jax.training.members import select
from pgrssnn_jax.training.settings import FitSettings

SAMPLES, TRAINED = 50, 35
ALONE, TRAINED_PHYSICS = ModelSpec(networks=False), FitSettings(physics_parameters="trained")  # compile quickly


def measured_once() -> Record:
    """A record with a gap in its measurements."""
    whole = simulated(cascaded_tanks(), samples=SAMPLES, seed=1, noise=0.1)
    mask = whole.mask.copy()
    mask[:, 11:14] = False
    return whole._replace(mask=mask)


def shared(whole: Record, seeds: list[int], folds: int, block: int) -> tuple[Record, Record]:
    parts = crop(whole, 0, TRAINED), crop(whole, TRAINED, SAMPLES)
    return kfold_masks(*(stack([part] * len(seeds)) for part in parts), seeds, folds, block)


@pytest.mark.parametrize(("folds", "block"), [(2, 1), (3, 4), (5, 10)])
def test_every_measured_sample_validates_in_one_fold_and_trains_in_the_others(folds: int, block: int) -> None:
    whole = measured_once()
    train, validation = shared(whole, list(range(7, 7 + folds)), folds, block)
    assert not (train.mask & validation.mask).any()
    np.testing.assert_array_equal(validation.mask.sum(0), whole.mask.astype(int))
    np.testing.assert_array_equal(train.mask.sum(0), (folds - 1) * whole.mask.astype(int))
    for part in (train, validation):
        assert np.array_equal(part.u, np.stack([whole.u] * folds))
        assert np.array_equal(part.y[0], whole.y)


def test_a_member_is_determined_by_its_seed_and_blocks_are_set_aside_whole() -> None:
    train, _ = shared(measured_once()._replace(mask=np.ones((1, SAMPLES, 1), bool)), [4, 1, 7], 3, 5)
    aside = ~train.mask[:, 0, :, 0]
    assert (aside == aside[0]).all()
    assert np.array_equal(np.flatnonzero(aside[0]), [*range(5, 10), *range(20, 25), *range(35, 40)])


@pytest.mark.parametrize("start", ["first_output", "estimated"])
def test_what_a_member_sets_aside_does_not_reach_its_training(start: str) -> None:
    fit, data = small_fit(spec=ALONE, settings=TRAINED_PHYSICS, initial=InitialState(start, 5), members=1)
    train, validation = shared(measured_once(), [0], 5, 5)
    data = select(data._replace(train=train, validation=validation), 0)
    other = data._replace(train=data.train._replace(y=np.where(data.train.mask, data.train.y, 9.0)))

    @quick_jit
    def begun(data):
        theta = fit.objective.begin(jax.random.key(0), data)
        return theta, jax.grad(lambda theta: fit.objective.on_train(theta, data).total)(theta)

    seen, unseen = begun(data), begun(other)
    for a, b in zip(jax.tree.leaves(seen), jax.tree.leaves(unseen), strict=True):
        assert np.array_equal(a, b)


def test_the_errors_set_aside_add_up_to_those_of_one_run_over_the_whole_record() -> None:
    whole, folds = cast(simulated(cascaded_tanks(), samples=SAMPLES, seed=1, noise=0.1), np.float32), 4
    fit, data = small_fit(spec=ALONE, settings=TRAINED_PHYSICS, initial=InitialState("zero"), members=1)
    data = select(data, 0)
    theta = quick_jit(fit.objective.begin)(jax.random.key(0), data)
    validated = quick_jit(lambda data: fit.objective.on_validation(theta, data).mean)
    train, validation = shared(whole, list(range(folds)), folds, 6)
    aside = 0.0
    for member in range(folds):
        own = data._replace(train=select(train, member), validation=select(validation, member))
        aside += float(validated(own)) * own.validation.mask.sum()
    together = float(quick_jit(fit.objective.on_train)(theta, data._replace(train=whole)).total)
    np.testing.assert_allclose(aside, together, rtol=1e-5)


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["data.folds=1"], "data.folds: expected 0 .the split of the data. or at least 2, found 1"),
        (["data.folds=5", "data.block=0"], "data.block: expected between 1 and .* samples, found 0"),
        (["data.folds=5", "data.n_train=100"], "at least folds x block = 160 samples to share, found 100"),
        (["data.folds=5", "data.block=300"], "at least folds x block = 1500 samples to share, found 1024"),
    ],
)
def test_a_record_that_cannot_be_shared_is_answered_with_one_sentence(more: list[str], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        planned("+experiment=cascaded_tank", "data.generated=true", *more)


def test_records_of_two_measurements_are_not_shared() -> None:
    whole = simulated(cascaded_tanks(), samples=SAMPLES, seed=1)
    other = whole._replace(info=replace(whole.info, origin="another"))
    with pytest.raises(ValueError, match="data.folds: expected 0 where validation does not go on right after training"):
        kfold_masks(stack([whole]), stack([other]), [0], 2, 6)


def test_a_later_part_of_the_same_measurement_is_never_trained_on() -> None:
    whole = simulated(cascaded_tanks(), samples=SAMPLES, seed=1)
    first, later = crop(whole, 0, SAMPLES // 2), crop(whole, SAMPLES // 2 + 5, SAMPLES)
    train, validation = kfold_masks(*(stack([part] * 2) for part in (first, later)), [0, 1], 2, 6)
    assert train.u.shape[:2] == (2, 2)
    assert not train.mask[:, 1].any()
    time = later.u.shape[1]
    assert validation.mask[:, 1, :time].all()
    assert not validation.mask[:, 1, time:].any()
    np.testing.assert_array_equal(validation.mask[:, 0].sum(0), train.mask[:, 0].sum(0))


@pytest.mark.parametrize("folds", [2, 5])
def test_the_first_samples_are_in_no_block(folds: int) -> None:
    whole = simulated(cascaded_tanks(), samples=SAMPLES, seed=1)
    parts = [stack([part] * folds) for part in (crop(whole, 0, TRAINED), crop(whole, TRAINED, SAMPLES))]
    train, validation = kfold_masks(*parts, list(range(folds)), folds, 6, lead=4)
    assert train.mask[:, :, :4].all()
    assert not validation.mask[:, :, :4].any()
    np.testing.assert_array_equal(validation.mask.sum(0)[:, 4:], 1)


def test_a_fold_in_which_nothing_was_measured_is_named() -> None:
    whole = measured_once()
    whole = whole._replace(mask=whole.mask & (np.arange(SAMPLES) // 10 % 5 != 3)[None, :, None])
    with pytest.raises(ValueError, match="measured samples to validate on in every fold"):
        shared(whole, [0, 3], 5, 10)
    shared(whole, [0, 1], 5, 10)  # no member sets that fold aside


def test_members_of_an_experiment_share_one_run_and_report_what_they_set_aside() -> None:
    plan = planned("+experiment=cascaded_tank", "data.generated=true", "data.folds=5").plan
    assert plan.data.train.u.shape[:3] == (10, 1, 1024)
    assert np.array_equal(plan.validation.mask, plan.data.validation.mask)
    assert (plan.data.train.info.same_run, plan.data.validation.info.same_run) == (False, True)


# --- what validates where nobody says, and windows --------------------------------------------------------------------


def counting(*lengths: int) -> Record:
    """Samples that count up over all sequences, in sequences of these lengths."""
    ends = np.cumsum(lengths)
    us = [np.arange(end - n, end) for n, end in zip(lengths, ends, strict=True)]
    return record_from(us, [u + 0.5 for u in us], dt=1.0, inputs={"u": "V"}, outputs={"y": "V"})


def samples(whole: Record) -> list:
    return whole.u[..., 0].tolist()


def test_without_a_validation_record_the_tail_of_training_validates() -> None:
    train, aside = estimation_parts(counting(8))
    assert (samples(train), samples(aside)) == ([[[0, 1, 2, 3, 4, 5]]], [[[6, 7]]])
    train, aside = estimation_parts(counting(*[2] * 8))
    assert (train.u.shape, aside.u.shape) == ((1, 6, 2, 1), (1, 2, 2, 1))
    assert np.array_equal(np.concatenate([train.u, aside.u], 1)[0], counting(*[2] * 8).u)


def test_a_validation_record_that_is_given_wins_over_the_one_that_came_with_the_data() -> None:
    whole, came, given = counting(8), counting(3), counting(5)
    train, aside = estimation_parts(whole._replace(validation=came))
    assert (samples(train), samples(aside)) == ([samples(whole)], [samples(came)])
    assert samples(estimation_parts(whole._replace(validation=came), given)[1]) == [samples(given)]
    assert train.validation is None


def test_realisations_keep_their_axis() -> None:
    one, two = counting(8), counting(8)
    both = stack([one, two._replace(u=two.u + 100)])
    assert by_dataset(both).u.shape == (2, 1, 8, 1)
    assert by_dataset(one).u.shape == (1, 1, 8, 1)
    train, aside = split_tail(both)
    assert (train.u.shape, aside.u.shape) == ((2, 1, 6, 1), (2, 1, 2, 1))
    assert samples(aside)[1] == [[106, 107]]
    assert (train.info.begins, aside.info.begins) == (0, 6)


@pytest.mark.parametrize("count", [0, 8])
def test_a_tail_leaves_something_to_train_on(count: int) -> None:
    with pytest.raises(
        ValueError, match=f"data.n_validation: expected between 1 and 7 of the 8 samples .*found {count}"
    ):
        split_tail(counting(8), count)


def test_windows_cut_every_dataset() -> None:
    both = stack([counting(9), counting(9)._replace(u=counting(9).u + 100)])
    cut = cut_windows(both, 4)
    assert samples(cut) == [[[0, 1, 2, 3], [4, 5, 6, 7]], [[100, 101, 102, 103], [104, 105, 106, 107]]]


def test_windows_of_nothing_but_padding_go() -> None:
    cut = cut_windows(by_dataset(counting(4, 2, 4)), 2)
    assert samples(cut) == [[[0, 1], [2, 3], [4, 5], [6, 7], [8, 9]]]
    assert cut.mask.all()


@pytest.mark.parametrize("length", [0, 9])
def test_windows_longer_than_a_sequence_are_refused(length: int) -> None:
    sentence = f"data.window: expected between 1 and 8 samples per training sequence, found {length}"
    with pytest.raises(ValueError, match=sentence):
        cut_windows(by_dataset(counting(8)), length)
