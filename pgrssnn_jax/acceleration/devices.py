"""How JAX uses this machine: one CPU device per core, work shared by the devices, and compiled programs kept.

All this changes the speed alone. JAX's own environment variables, and what the user has configured, win.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import AxisType, PartitionSpec

_AXIS = "device"


def usable_cores() -> int:
    """Linux: the cores that this process may use, not those that the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def use_all_cores() -> None:
    """One CPU device per core. Without effect where JAX has computed before."""
    if "JAX_NUM_CPU_DEVICES" in os.environ or jax.config.jax_num_cpu_devices > 0:  # pyright: ignore
        return
    try:
        jax.config.update("jax_num_cpu_devices", usable_cores())
    except RuntimeError:  # JAX is running
        return


def keep_compiled() -> None:
    """Compiled programs go into the user's cache folder, so that the next process finds them."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ or jax.config.jax_compilation_cache_dir:  # pyright: ignore
        return
    jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def cache_folder() -> Path:
    """Cache folder of this package; its content can be rebuilt."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pgrssnn_jax"


def sum_over_devices(value: jax.Array) -> jax.Array:
    """Within a function of `over_devices`."""
    return jax.lax.psum(value, _AXIS)


def filled_up(tree: Any, devices: int) -> Any:
    """Leading axis to a multiple of the devices, with copies of the last entry."""
    missing = -len(jax.tree.leaves(tree)[0]) % devices
    if not missing:
        return tree
    return jax.tree.map(lambda a: jnp.concatenate([a, jnp.repeat(a[-1:], missing, axis=0)]), tree)


def over_devices(function: Callable[..., Any], devices: int) -> Callable[..., Any]:
    """The same function of trees with a leading axis, that axis sharded over the first `devices` JAX devices; padded to
    a multiple of them with copies of the last entry, which are dropped again."""
    if devices == 1:
        return function
    chosen = jax.devices()[:devices]
    mesh = jax.make_mesh((devices,), (_AXIS,), axis_types=(AxisType.Auto,), devices=chosen)
    spec = PartitionSpec(_AXIS)
    sharded = jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)

    def on_devices(*trees: Any) -> Any:
        count = len(jax.tree.leaves(trees)[0])
        return jax.tree.map(lambda a: a[:count], sharded(*filled_up(trees, devices)))

    return on_devices
