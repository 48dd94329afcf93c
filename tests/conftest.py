"""Strictness that users need not pay for: array shapes checked, rank promotion raises, warnings are errors."""

import gc
import hashlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest
from compiler import little_optimised

import pgrssnn_jax  # noqa: F401  sets flags of the compiler, which count before the first computation only

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_num_cpu_devices", 2)

# Many tests compile the same small programs; commands that tests start find them too. Every worker has its own.
_COMPILED = tempfile.TemporaryDirectory(prefix="pgrssnn_jax_compiled_")
if "PYTEST_XDIST_WORKER" in os.environ or "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _COMPILED.name
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)  # what compiles sooner is hardly worth its file
jax.config.update("jax_traceback_in_locations_limit", 0)  # nobody reads where an operation of a program was written


#: tracing makes millions of small objects; a collection of garbage every 700 of them takes 5 % of the tests' time
gc.set_threshold(100_000, 50, 100)


def pytest_configure(config: pytest.Config) -> None:
    """Any other selection compiles everything as users do."""
    if config.option.markexpr in ("not slow", "compiles"):
        os.environ.update(little_optimised())


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What `compiles` is `slow`, before any are selected. Tests marked `data` run where the data is; elsewhere they are
    skipped, and `.ci/run` counts them. The files are shuffled where their order is named, so that no file is always the
    last one within a limit of time."""
    for item in items:
        if item.get_closest_marker("compiles"):
            item.add_marker("slow")
    if order := os.environ.get("SLOW_TESTS_ORDER"):
        items.sort(key=lambda item: hashlib.sha256(f"{order} {item.path.name}".encode()).digest())
    if data_folder() is None:
        skip = pytest.mark.skip(reason="PGRSSNN_DATA is not set")
        for item in items:
            if item.get_closest_marker("data"):  # not by keyword, which a folder of this name would give
                item.add_marker(skip)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Slow tests begin within the limit of time, where there is one."""
    if item.get_closest_marker("slow") and time.time() > float(os.environ.get("SLOW_TESTS_UNTIL", "inf")):
        pytest.skip(f"no time is left for {item.nodeid}")


def data_folder() -> Path | None:
    folder = os.environ.get("PGRSSNN_DATA")
    return Path(folder).resolve() if folder else None


@pytest.fixture
def data() -> Path:
    """The folder of measured data; use it in tests marked `data` only."""
    folder = data_folder()
    assert folder is not None, "mark this test with pytest.mark.data"
    return folder


@pytest.fixture
def key() -> jax.Array:
    return jax.random.key(20260715)


@pytest.fixture(autouse=True, scope="session")
def simulated_once() -> Iterator[None]:
    """Loaders simulate the same plants again and again, for seconds; tests of the simulators call these themselves."""
    from pgrssnn_jax.data import arm_simulator, tanks

    with pytest.MonkeyPatch.context() as patch:
        for module, name in ((tanks, "estimation_and_test"), (arm_simulator, "simulated_arm")):
            patch.setattr(module, name, _copies(cache(getattr(module, name))))
        yield


def _copies(function: Callable) -> Callable:
    return lambda *given: jax.tree.map(np.copy, function(*given))


MOST_MEMORY = 5e9  # bytes that a worker holds before its compiled programs go; two of them fit a machine of 16 GB


@pytest.fixture(autouse=True)
def freed(request: pytest.FixtureRequest) -> Iterator[None]:
    """A worker that keeps the programs of all slow tests needs many gigabytes and is aborted."""
    yield
    if request.node.get_closest_marker("slow") and memory() > MOST_MEMORY:
        jax.clear_caches()


def memory() -> float:
    """Bytes of memory that this process holds; infinite where nothing tells them."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return float("inf")


@pytest.fixture
def x64() -> Iterator[None]:
    """Double precision for this test only."""
    with jax.enable_x64(True):
        yield
