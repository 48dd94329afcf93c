"""Saving and restoring the whole state of training with orbax.

A checkpoint holds everything that the next chunk depends on, so that a resumed run ends with the same numbers, bit for
bit, as one that was never interrupted: trainable and best parameters, optimizer state, epoch, outcome, scaling, and
the losses so far. Orbax writes to a temporary name and renames; a checkpoint that exists is whole.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import orbax.checkpoint as ocp

from pgrssnn_jax.fit import MemberState
from pgrssnn_jax.scaling import Scaling
from pgrssnn_jax.training import Losses


class Checkpoint(NamedTuple):
    state: MemberState
    scaling: Scaling
    losses: Losses


class CheckpointFolder:
    """Checkpoints of one run, named by epoch; the latest two are kept."""

    def __init__(self, folder: Path) -> None:
        options = ocp.CheckpointManagerOptions(max_to_keep=2, enable_async_checkpointing=False)
        self._manager = ocp.CheckpointManager(folder.resolve(), options=options)

    def save(self, checkpoint: Checkpoint) -> None:
        """Saves under the number of epochs trained; saving the same epoch again is a no-op."""
        epoch = checkpoint.losses.epochs
        if epoch != self._manager.latest_step():
            host = jax.tree.map(np.asarray, jax.device_get(checkpoint))
            self._manager.save(epoch, args=ocp.args.StandardSave(_plain(host)))

    def restore(self, like: MemberState, scaling: Scaling) -> Checkpoint:
        """The latest checkpoint, in the structure of a freshly begun state.

        Raises `ValueError` when there is none, or when it holds other members or another model than `like`.
        """
        epoch = self._manager.latest_step()
        if epoch is None:
            raise ValueError(f"resume: {self._manager.directory}: expected a checkpoint, found none")
        found = self._manager.restore(epoch, args=ocp.args.StandardRestore())
        expected = _plain(Checkpoint(like, scaling, Losses(np.zeros((0, 0)), np.zeros((0, 0)))))
        for name in ("state", "scaling"):
            if _shapes(found[name]) != _shapes(expected[name]):
                raise ValueError(
                    f"resume: {self._manager.directory}: {name}: expected the arrays of this model and its members, "
                    "found those of another one"
                )
        structure = jax.tree.structure(like), jax.tree.structure(scaling)
        return Checkpoint(
            jax.tree.unflatten(structure[0], _leaves(found["state"])),
            jax.tree.unflatten(structure[1], _leaves(found["scaling"])),
            Losses(**{name: np.asarray(values) for name, values in found["losses"].items()}),
        )

    def clear(self) -> None:
        """Forgets the checkpoints of an earlier run in the same folder."""
        for epoch in self._manager.all_steps():
            self._manager.delete(epoch)

    def close(self) -> None:
        self._manager.close()


def _plain(checkpoint: Checkpoint) -> dict[str, Any]:
    """Named arrays: readable without this package, and independent of how optax or Flax nest their states."""
    named = {}
    for name, tree in (("state", checkpoint.state), ("scaling", checkpoint.scaling)):
        paths = jax.tree_util.tree_leaves_with_path(tree)
        named[name] = {
            f"{i:04d}{jax.tree_util.keystr(path)}".replace("/", "|"): leaf for i, (path, leaf) in enumerate(paths)
        }
    return {**named, "losses": checkpoint.losses._asdict()}


def _leaves(named: dict[str, Any]) -> list[Any]:
    return [named[name] for name in sorted(named)]


def _shapes(named: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    return {name: tuple(np.shape(leaf)) for name, leaf in named.items()}
