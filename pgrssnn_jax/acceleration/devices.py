"""How JAX uses this machine: one CPU device per core, so that members can be sharded, and compiled programs kept.

Both change the speed alone. JAX's own environment variables, and what the user has configured, win.
"""

import os
from pathlib import Path

import jax


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
