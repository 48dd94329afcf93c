"""The recurrence of a GRU as a C++ kernel, compiled once on the machine that runs it.

XLA runs a scan over small matrices step by step through its runtime: for 16 units a step takes ten times longer than
its arithmetic. The kernel (`gru.cc`) takes a whole sequence at once. Its results agree with `models/gru.py` to
rounding. Measured on two cores: gradient of 768 steps of 16 units 1.31 -> 0.25 ms, of ten members 5.1 -> 1.9 ms; 605
steps of 60 sequences and 64 units 80 -> 48 ms, on one core instead of two.
"""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

from pgrssnn_jax.acceleration.devices import cache_folder

_SOURCE = Path(__file__).with_name("gru.cc")
# no -ffast-math: NaN must stay NaN, and it would change the floating-point mode of the whole process
_FLAGS = ("-std=c++17", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")
_COMPILERS = ("c++", "g++", "clang++")
_PATIENCE = 300  # seconds for the compiler, which takes 3 to 12
_TARGETS = ("pgrssnn_gru_forward", "pgrssnn_gru_backward")


@cache
def missing_kernel() -> str | None:
    """None once the kernel is compiled and known to JAX, else why it cannot be had: one phrase."""
    if jax.default_backend() != "cpu":
        return f"the C++ kernel runs on CPUs, and JAX computes on {jax.default_backend()}"
    compiler = next(filter(None, map(shutil.which, filter(None, (os.environ.get("CXX"), *_COMPILERS)))), None)
    if compiler is None:
        return f"no C++ compiler found (CXX, {', '.join(_COMPILERS)})"
    try:
        library = ctypes.CDLL(str(_compiled(compiler)))
        for name in _TARGETS:
            jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(library, name)), platform="cpu")
    except subprocess.CalledProcessError as error:
        return f"{compiler} does not compile the C++ kernel: {error.stderr.strip().splitlines()[0]}"
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the C++ kernel cannot be compiled or loaded: {error}"
    return None


def _compiled(compiler: str) -> Path:
    """The library for this source, compiler, processor and JAX, compiled if it is not in the user's cache folder."""
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=True, timeout=_PATIENCE)
    parts = (_SOURCE.read_text(), version.stdout, jax.__version__, " ".join(_FLAGS), _processor())
    name = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
    library = cache_folder() / "native" / f"gru-{name}.so"
    if library.exists():
        return library
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:  # a killed compiler leaves no half library behind
        made = Path(folder) / library.name
        include = ("-isystem", jax.ffi.include_dir())
        command = [compiler, *_FLAGS, *include, "-shared", "-fPIC", str(_SOURCE), "-o", str(made)]
        subprocess.run(command, capture_output=True, text=True, check=True, timeout=_PATIENCE)
        made.replace(library)
    return library


def _processor() -> str:
    """What -march=native looks at: folders of a user may be shared by machines that differ."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    flags = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()} {platform.processor()} {flags}"


@jax.custom_vjp
def native_gru_scan(
    kernel: Float[jax.Array, "hidden gates"],
    bias: Float[jax.Array, " gates"],
    projected: Float[jax.Array, "time seq gates"],
) -> Float[jax.Array, "time seq hidden"]:
    """`models.gru.gru_scan` by the kernel, float32 and reverse mode only. Call it where `missing_kernel()` is None."""
    states = jax.ShapeDtypeStruct((*projected.shape[:2], kernel.shape[0]), jnp.float32)
    return jax.ffi.ffi_call(_TARGETS[0], states, vmap_method="broadcast_all")(kernel, bias, projected)


def _forward(kernel: jax.Array, bias: jax.Array, projected: jax.Array) -> tuple[jax.Array, tuple[Any, ...]]:
    states = native_gru_scan(kernel, bias, projected)
    return states, (kernel, bias, projected, states)


def _backward(residuals: tuple[Any, ...], cotangent: Any) -> tuple[jax.Array, ...]:
    likes = tuple(jax.ShapeDtypeStruct(a.shape, jnp.float32) for a in residuals[:3])
    return tuple(jax.ffi.ffi_call(_TARGETS[1], likes, vmap_method="broadcast_all")(*residuals, cotangent))


native_gru_scan.defvjp(_forward, _backward)
