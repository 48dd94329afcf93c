"""Saving and restoring the whole state of training with orbax.

A checkpoint holds everything that the next chunk depends on, so that a resumed run ends with the same numbers, bit for
bit, as one that was never interrupted: trainable and best parameters, optimizer state, epoch, outcome, scaling, units,
and the losses so far. Orbax writes to a temporary name and renames; a checkpoint that exists is whole.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import orbax.checkpoint as ocp

from pgrssnn_jax.records.arguments import first_line
from pgrssnn_jax.records.scaling import Scaling, Units
from pgrssnn_jax.training.loop import Losses, no_losses
from pgrssnn_jax.training.optimise import MemberState


class Checkpoint(NamedTuple):
    state: MemberState
    scaling: Scaling
    units: Units
    losses: Losses


class CheckpointFolder:
    """Checkpoints of one run, named by epoch; the latest two are kept."""

    def __init__(self, folder: Path, *, create: bool = True) -> None:
        """create False: for reading. Raises `ValueError` when the folder is not there."""
        if not create and not folder.is_dir():
            raise ValueError(f"checkpoint: expected one in {str(folder)!r}, found none")
        options = ocp.CheckpointManagerOptions(max_to_keep=2, enable_async_checkpointing=False, create=create)
        self._manager = ocp.CheckpointManager(folder.resolve(), options=options)

    def save(self, checkpoint: Checkpoint) -> None:
        """Saves under the number of epochs trained; saving the same epoch again is a no-op."""
        epoch = checkpoint.losses.epochs
        if epoch != self._manager.latest_step():
            host = jax.tree.map(np.asarray, jax.device_get(checkpoint))
            self._manager.save(epoch, args=ocp.args.StandardSave(_named(host)))

    def restore(self, like: Checkpoint, *, any_shape: bool = False) -> Checkpoint:
        """The latest checkpoint, in the structure of `like`; any_shape: whatever the number of members and sequences.

        Raises `ValueError` when there is none, or when it belongs to other members or another model than `like`.
        """
        epoch = self._manager.latest_step()
        if epoch is None:
            raise ValueError(f"checkpoint: expected one in {str(self._manager.directory)!r}, found none")
        found, expected = _today(self._read(epoch)), _named(like)
        trees: dict[str, Any] = {}
        for name in ("state", "scaling", "units"):
            arrays = found.get(name, {})
            here, there = (
                {key: () if any_shape else np.shape(leaf) for key, leaf in named.items()}
                for named in (arrays, expected[name])
            )
            if here != there:
                raise ValueError(
                    f"checkpoint: {name}: expected the arrays of this model and its members, found those of another one"
                )
            leaves = [arrays[key] for key in sorted(arrays)]
            trees[name] = jax.tree.unflatten(jax.tree.structure(getattr(like, name)), leaves)
        there = sorted(found.get("losses", ()))
        if epoch and there != sorted(Losses._fields):
            raise ValueError(f"checkpoint: losses: expected {sorted(Losses._fields)}, found {there}")
        losses = Losses(**found["losses"]) if epoch else no_losses(len(trees["state"].epoch))
        return Checkpoint(**trees, losses=losses)

    def _read(self, epoch: int) -> Mapping[str, Any]:
        try:
            found = self._manager.restore(epoch, args=ocp.args.StandardRestore())
        except Exception as problem:  # orbax raises whatever a damaged file leads it to
            found = first_line(problem)
        if not isinstance(found, Mapping) or not all(isinstance(part, Mapping) for part in found.values()):
            raise ValueError(f"checkpoint: expected a whole one in {str(self._manager.directory)!r}, found {found}")
        return found

    def close(self) -> None:
        self._manager.close()


def _named(checkpoint: Checkpoint) -> dict[str, Any]:
    """Arrays by name: readable without this package, and independent of how optax or Flax nest their states."""
    named = {}
    for name in ("state", "scaling", "units"):
        paths = jax.tree_util.tree_leaves_with_path(getattr(checkpoint, name))
        named[name] = {
            f"{i:04d}{jax.tree_util.keystr(path)}".replace("/", "|"): leaf for i, (path, leaf) in enumerate(paths)
        }
    if checkpoint.losses.epochs:  # orbax refuses arrays without elements
        named["losses"] = checkpoint.losses._asdict()
    return named


def _today(found: Mapping[str, Any]) -> dict[str, Any]:
    """A checkpoint of an earlier version under the names of this one."""
    state = {name.replace(".retreats", ".rollbacks"): leaf for name, leaf in found.get("state", {}).items()}
    return {**found, "state": state}
