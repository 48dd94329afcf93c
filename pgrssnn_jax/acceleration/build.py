"""Shared libraries from C++, compiled once on the machine that runs them and kept in the user's cache folder."""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path

import jax

from pgrssnn_jax.acceleration.devices import cache_folder

KERNELS = Path(__file__).with_name("kernels")
# no -ffast-math: NaN must stay NaN, and it would change the floating-point mode of the whole process
_FLAGS = ("-std=c++17", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")
COMPILERS = ("c++", "g++", "clang++")
_PATIENCE = 300  # seconds for the compiler, which takes 2 to 15


def missing_library(
    name: str, sources: Mapping[str, str], options: Sequence[str], use: Callable[[ctypes.CDLL], None]
) -> str | None:
    """Compiles sources (file name and text), and gives the library to `use`. Returns None, or why it is not to be had:
    one phrase."""
    if jax.default_backend() != "cpu":
        return f"the C++ kernels run on CPUs, and JAX computes on {jax.default_backend()}"
    compiler = next(filter(None, map(shutil.which, filter(None, (os.environ.get("CXX"), *COMPILERS)))), None)
    if compiler is None:
        return f"no C++ compiler found (CXX, {', '.join(COMPILERS)})"
    try:
        use(ctypes.CDLL(str(_compiled(name, sources, compiler, options))))
    except subprocess.CalledProcessError as error:
        lines = error.stderr.splitlines()
        said = next((line for line in lines if "error" in line), f"exit code {error.returncode}")
        return f"{compiler} does not compile the C++ kernels: {said.strip()}"
    except (OSError, AttributeError, RuntimeError, subprocess.TimeoutExpired) as error:
        return f"the C++ kernels cannot be compiled or loaded: {error}"
    return None


def register(library: ctypes.CDLL, targets: Sequence[str]) -> None:
    """Kernels `pgrssnn_<target>` of a library, for `jax.ffi.ffi_call`."""
    for target in targets:
        handler = jax.ffi.pycapsule(getattr(library, f"pgrssnn_{target}"))
        jax.ffi.register_ffi_target(f"pgrssnn_{target}", handler, platform="cpu")


def _compiled(name: str, sources: Mapping[str, str], compiler: str, options: Sequence[str]) -> Path:
    """The library for these sources, headers, compiler, processor and jaxlib; compiled if the cache lacks it."""
    version = _run([compiler, "--version"])
    parts = (*sources.values(), headers(), version, metadata.version("jaxlib"), *_FLAGS, *options)
    digest = hashlib.sha256("\n".join((*parts, _processor())).encode()).hexdigest()[:16]
    library = cache_folder() / "native" / f"{name}-{digest}.so"
    if library.exists():
        return library
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:  # a killed compiler leaves no half library behind
        files = [Path(folder) / file for file in sources]
        for file, text in zip(files, sources.values(), strict=True):
            file.write_text(text)
        made = Path(folder) / library.name
        include = ("-I", str(KERNELS), "-isystem", jax.ffi.include_dir())
        _run([compiler, *_FLAGS, *options, *include, "-shared", "-fPIC", *map(str, files), "-o", str(made)])
        made.replace(library)
    return library


def headers() -> str:
    """Texts of all headers of the kernels."""
    return "\n".join(file.read_text() for file in sorted(KERNELS.rglob("*.h")))


def _run(command: list[str]) -> str:
    """Its output. Raises `CalledProcessError` where it fails."""
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=True, timeout=_PATIENCE)
    return done.stdout


@cache
def _processor() -> str:
    """What -march=native looks at: folders of a user may be shared by machines that differ."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    flags = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()} {platform.processor()} {flags}"
