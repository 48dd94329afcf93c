"""What is saved comes back, and what belongs to another run does not."""

import jax
import numpy as np
import pytest
from small import small_fit
from toys import quick_jit

from pgrssnn_jax.cli.process import stop_signal
from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.records.scaling import Affine, Units
from pgrssnn_jax.training.checkpoints import Checkpoint, CheckpointFolder
from pgrssnn_jax.training.loop import Losses, Training, no_losses, train
from pgrssnn_jax.training.members import Member, MemberMapping, keys_of, map_members
from pgrssnn_jax.training.settings import FitSettings

MEMBERS = [Member(i, 0) for i in range(3)]


def begun(fit, data):
    return quick_jit(map_members(fit.begin, MemberMapping()))(keys_of(MEMBERS), data)


def shaped(fit, data):
    """What training begins with, without its numbers."""
    return jax.eval_shape(map_members(fit.begin, MemberMapping()), keys_of(MEMBERS), data)


def filled(shapes):
    """Numbers of any kind, all different: what is saved need not come from training, which compiles long."""
    draw = np.random.default_rng(0)
    return jax.tree.map(lambda a: (100 * draw.normal(size=a.shape)).astype(a.dtype), shapes)


def saved(state, data, losses) -> Checkpoint:
    units = Units(Affine(np.zeros((3, 1)), np.ones((3, 1))), Affine(np.full((3, 1), 2.0), np.full((3, 1), 3.0)))
    return Checkpoint(state, data.scaling, units, losses)


@pytest.fixture
def opened():
    folders: list[CheckpointFolder] = []

    def open_folder(path) -> CheckpointFolder:
        folders.append(CheckpointFolder(path))
        return folders[-1]

    yield open_folder
    for folder in folders:
        folder.close()


def same(a, b) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return jax.tree.structure(a) == jax.tree.structure(b) and all(
        np.array_equal(x, y, equal_nan=True) and np.asarray(x).dtype == np.asarray(y).dtype for x, y in pairs
    )


@pytest.mark.parametrize(("kind", "physics_parameters"), [("first_output", "fixed"), ("estimated", "trained")])
def test_state_scaling_and_losses_come_back_bit_for_bit(tmp_path, opened, kind, physics_parameters):
    fit, data = small_fit(
        initial=InitialState(kind, n_init=5), settings=FitSettings(physics_parameters=physics_parameters)
    )
    state = filled(shaped(fit, data))._replace(best_loss=np.float32([1.0, np.inf, np.nan]))
    losses = Losses(np.float32([[1, 2], [3, np.nan], [5, 6]]), np.full((3, 2), np.nan, np.float32))
    opened(tmp_path).save(saved(state, data, losses))
    found = opened(tmp_path).restore(saved(shaped(fit, data), data, no_losses(3)))
    assert same(found.state, state)
    assert same(found.scaling, data.scaling)
    assert np.all(found.units.y.scale == 3.0)
    assert same(found.losses, losses)


def test_the_latest_epoch_is_restored(tmp_path, opened):
    fit, data = small_fit()
    state = filled(shaped(fit, data))
    folder = opened(tmp_path)
    for epochs in (1, 2, 3):
        losses = Losses(np.full((3, epochs), epochs, np.float32), np.full((3, epochs), np.nan, np.float32))
        folder.save(saved(state, data, losses))
    assert folder.restore(saved(state, data, no_losses(3))).losses.epochs == 3


def test_another_model_or_other_members_are_named(tmp_path, opened):
    fit, data = small_fit()
    opened(tmp_path).save(saved(filled(shaped(fit, data)), data, no_losses(3)))
    other, other_data = small_fit(spec=ModelSpec(hidden=5))
    with pytest.raises(ValueError, match="state: expected the arrays of this model"):
        opened(tmp_path).restore(saved(shaped(other, other_data), other_data, no_losses(3)))


@pytest.mark.parametrize(
    ("devices", "spec", "physics_parameters"),
    [
        pytest.param(1, ModelSpec(networks=False), "trained", id="1"),
        pytest.param(2, ModelSpec(hidden=4), "fixed", id="2", marks=pytest.mark.slow),
    ],
)
def test_an_interrupted_and_resumed_run_ends_bit_for_bit_as_an_uninterrupted_one(
    tmp_path, opened, devices, spec, physics_parameters
):
    """Interrupted by a real signal in the middle, saved, restored into a new program, trained on."""
    import os
    import signal

    settings = FitSettings(
        epochs=24, validate_every=2, chunk_epochs=4, learning_rate=1e-2, physics_parameters=physics_parameters
    )
    fit, data = small_fit(spec=spec, settings=settings)

    def run(state, losses, on_chunk) -> Training:
        with stop_signal() as stop:
            return train(fit, MemberMapping("vmap", None, devices), state, data, losses, on_chunk=on_chunk, stop=stop)

    whole = run(begun(fit, data), no_losses(3), lambda *_: None)

    def interrupt(state, losses, now):
        if now.epoch == 12:
            os.kill(os.getpid(), signal.SIGINT)

    half = run(begun(fit, data), no_losses(3), interrupt)
    assert half.interrupted
    assert half.losses.epochs == 12
    opened(tmp_path).save(saved(half.state, data, half.losses))
    again = opened(tmp_path).restore(saved(begun(fit, data), data, no_losses(3)))
    resumed = run(again.state, again.losses, lambda *_: None)
    assert not resumed.interrupted
    assert same(jax.device_get(resumed.state), jax.device_get(whole.state))
    assert same(resumed.losses, whole.losses)
