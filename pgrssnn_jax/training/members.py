"""From a function of one member to a function of all members: the one place that decides how they are mapped.

Which mapping is fastest depends on the shapes: many small products with each member's own weights are slow when
batched on a CPU, few long recurrences are slow one after another. `benchmarks/rollout.py` measures it; an experiment
says it once, in `conf/members/`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from pgrssnn_jax.acceleration.compiler import optimised
from pgrssnn_jax.acceleration.devices import over_devices


class Member(NamedTuple):
    """Which member this is: its seed and the index of its dataset (realisation)."""

    seed: int
    dataset: int


@dataclass(frozen=True)
class MemberMapping:
    """how: `vmap` within a sub-batch, or members one after another (`loop`); sub_batch: members per `vmap` (None: all);
    devices: JAX devices over which the members are sharded; optimisation: of machine code, 0 to 3 (None: as the
    compiler chooses), where 0 compiles in about half the time and runs two to four times slower."""

    how: Literal["vmap", "loop"] = "vmap"
    sub_batch: int | None = None
    devices: int = 1
    optimisation: int | None = None


def jit_members(one: Callable[..., Any], mapping: MemberMapping, *, donated: int | None = None) -> jax.stages.Wrapped:
    """`map_members`, compiled as the mapping says; donated: the argument whose memory the result takes over."""
    given = () if donated is None else (donated,)
    mapped = map_members(one, mapping)
    return jax.jit(mapped, compiler_options=optimised(mapping.optimisation), donate_argnums=given)


def for_one_run(mapping: MemberMapping) -> MemberMapping:
    """The mapping of a program that runs once: it compiles longer than it runs, so with little optimisation."""
    return replace(mapping, optimisation=0) if mapping.optimisation is None else mapping


def map_members(one: Callable[..., Any], mapping: MemberMapping) -> Callable[..., Any]:
    """`one(*trees) -> tree` for one member becomes a function of trees with a leading member axis.

    Raises `ValueError` for a mapping that cannot be, and when more devices are asked for than there are.
    """
    if not 1 <= mapping.devices <= jax.device_count():
        raise ValueError(f"members: devices: expected 1 to {jax.device_count()}, found {mapping.devices}")
    if mapping.sub_batch is not None and mapping.sub_batch < 1:
        raise ValueError(f"members: sub_batch: expected at least 1, found {mapping.sub_batch}")
    if mapping.optimisation not in (None, 0, 1, 2, 3):
        raise ValueError(f"members: optimisation: expected null or 0 to 3, found {mapping.optimisation}")

    def on_one_device(*trees: Any) -> Any:
        if mapping.how == "loop":
            return jax.lax.map(lambda args: one(*args), trees)
        count = len(jax.tree.leaves(trees)[0])
        if mapping.sub_batch is None or mapping.sub_batch >= count:
            return jax.vmap(one)(*trees)
        return jax.lax.map(lambda args: one(*args), trees, batch_size=mapping.sub_batch)

    return over_devices(on_one_device, mapping.devices)


def keys_of(chosen: Sequence[Member]) -> jax.Array:
    """One key per member, split by name: its seed, then its dataset."""
    return jnp.stack([jax.random.fold_in(jax.random.key(m.seed), m.dataset) for m in chosen])


def repeat(tree: Any, count: int) -> Any:
    """The same tree for every one of `count` members."""
    return jax.tree.map(lambda a: jnp.broadcast_to(jnp.asarray(a)[None], (count, *jnp.shape(a))), tree)


def select(tree: Any, member: int) -> Any:
    """One member's tree."""
    return jax.tree.map(lambda a: a[member], tree)


def choose_mapping(n_members: int, n_sequences: int, devices: int, *, native: bool = False) -> MemberMapping:
    """The fastest mapping of those measured (`benchmarks/rollout.py --only mappings`): on CPUs one after another when
    each member has a batch of sequences to multiply with (1 and 31 were measured, 8 lies between) or its recurrence is
    native, all at once when each has a single long sequence (tanks)."""
    how = "loop" if native or (n_sequences >= 8 and jax.default_backend() == "cpu") else "vmap"
    return MemberMapping(how, devices=min(devices, n_members))
