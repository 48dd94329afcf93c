"""GRU recurrence, dense layers and the dynamics of arms as C++ kernels, compiled once on the machine that runs them.

XLA runs a scan over small matrices step by step through its runtime: for 16 units a step takes ten times longer than
its arithmetic. The kernels (`kernels/*.cc`) take a whole sequence at once, and keep no intermediate results for the
gradient. They agree with `models/gru.py`, `models/networks.py` and `physics/arms/chain.py` to the rounding of single
precision (sigmoid and tanh to an absolute 1e-7).
"""

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from functools import cache, partial
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.acceleration.devices import cache_folder

_KERNELS = Path(__file__).with_name("kernels")
# no -ffast-math: NaN must stay NaN, and it would change the floating-point mode of the whole process
_FLAGS = ("-std=c++17", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")
COMPILERS = ("c++", "g++", "clang++")
_PATIENCE = 300  # seconds for the compiler, which takes 5 to 15
_TARGETS = ("gru_forward", "gru_backward", "two_dense_forward", "two_dense_backward", "arm", "arm_factors")
MOST_JOINTS = 32  # of the kernel of arms


@cache
def missing_kernels() -> str | None:
    """Compiles and registers the kernels. Returns None, or the reason why they are not available: one phrase."""
    if jax.default_backend() != "cpu":
        return f"the C++ kernels run on CPUs, and JAX computes on {jax.default_backend()}"
    compiler = next(filter(None, map(shutil.which, filter(None, (os.environ.get("CXX"), *COMPILERS)))), None)
    if compiler is None:
        return f"no C++ compiler found (CXX, {', '.join(COMPILERS)})"
    try:
        library = ctypes.CDLL(str(_compiled(compiler)))
        for name in _TARGETS:
            handler = jax.ffi.pycapsule(getattr(library, f"pgrssnn_{name}"))
            jax.ffi.register_ffi_target(f"pgrssnn_{name}", handler, platform="cpu")
    except subprocess.CalledProcessError as error:
        lines = error.stderr.splitlines()
        said = next((line for line in lines if "error" in line), f"exit code {error.returncode}")
        return f"{compiler} does not compile the C++ kernels: {said.strip()}"
    except (OSError, AttributeError, RuntimeError, subprocess.TimeoutExpired) as error:
        return f"the C++ kernels cannot be compiled or loaded: {error}"
    return None


def _compiled(compiler: str) -> Path:
    """The library for these sources, compiler, processor and jaxlib, compiled if the user's cache folder lacks it."""
    version = _run([compiler, "--version"])
    files = sorted(_KERNELS.iterdir())
    texts = [file.read_text() for file in files if file.suffix in (".cc", ".h")]
    parts = (*texts, version, metadata.version("jaxlib"), *_FLAGS, _processor())
    name = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
    library = cache_folder() / "native" / f"kernels-{name}.so"
    if library.exists():
        return library
    library.parent.mkdir(parents=True, exist_ok=True)
    sources = [str(file) for file in files if file.suffix == ".cc"]
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:  # a killed compiler leaves no half library behind
        made = Path(folder) / library.name
        include = ("-isystem", jax.ffi.include_dir())
        command = [compiler, *_FLAGS, *include, "-shared", "-fPIC", *sources, "-o", str(made)]
        _run(command)
        made.replace(library)
    return library


def _run(command: list[str]) -> str:
    """Its output. Raises `CalledProcessError` where it fails."""
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=True, timeout=_PATIENCE)
    return done.stdout


def _processor() -> str:
    """What -march=native looks at: folders of a user may be shared by machines that differ."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    flags = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()} {platform.processor()} {flags}"


def _call(target: str, like: Any, *arrays: Any, **attributes: Any) -> Any:
    """The kernel's results, of the shapes of `like`; it maps over any leading axes itself."""
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, jnp.float32), like)
    call = jax.ffi.ffi_call(f"pgrssnn_{target}", shapes, vmap_method="broadcast_all")
    return call(*arrays, **attributes)


@jax.custom_vjp
def gru_scan(
    kernel: Float[jax.Array, "hidden gates"],
    bias: Float[jax.Array, " gates"],
    projected: Float[jax.Array, "time seq gates"],
    start: Float[jax.Array, "seq hidden"],
) -> Float[jax.Array, "time seq hidden"]:
    """`models.gru.gru_scan`, float32 and reverse mode only. Call it where `missing_kernels()` is None."""
    states = jax.ShapeDtypeStruct((*projected.shape[:2], kernel.shape[0]), jnp.float32)
    return _call("gru_forward", states, kernel, bias, projected, start)


def _gru_forward(*arrays: Any) -> tuple[jax.Array, tuple[Any, ...]]:
    states = gru_scan(*arrays)
    return states, (*arrays, states)


def _gru_backward(residuals: tuple[Any, ...], cotangent: Any) -> tuple[jax.Array, ...]:
    return tuple(_call("gru_backward", residuals[:-1], *residuals, cotangent))


gru_scan.defvjp(_gru_forward, _gru_backward)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def two_dense(
    relu: bool,
    first: Float[jax.Array, "n_in hidden"],
    first_bias: Float[jax.Array, " hidden"],
    second: Float[jax.Array, "hidden n_out"],
    second_bias: Float[jax.Array, " n_out"],
    z: Float[jax.Array, "rows n_in"],
) -> Float[jax.Array, "rows n_out"]:
    """`models.networks.TwoDense`, float32 and reverse mode only; relu False: the logistic function."""
    y = jax.ShapeDtypeStruct((z.shape[0], second.shape[1]), jnp.float32)
    return _call("two_dense_forward", y, first, first_bias, second, second_bias, z, relu=relu)


def _two_dense_forward(relu: bool, *arrays: Any) -> tuple[jax.Array, tuple[Any, ...]]:
    return two_dense(relu, *arrays), arrays


def _two_dense_backward(relu: bool, arrays: tuple[Any, ...], cotangent: Any) -> tuple[jax.Array, ...]:
    first, first_bias, second, _, z = arrays
    return tuple(_call("two_dense_backward", arrays, first, first_bias, second, z, cotangent, relu=relu))


two_dense.defvjp(_two_dense_forward, _two_dense_backward)


class ArmConstants(NamedTuple):
    """Of an arm, as `kernels/arm.cc` reads them: 23 numbers per joint in a row, parents, gravity in m/s²."""

    tables: np.ndarray
    parents: np.ndarray
    gravity: np.ndarray


Batch = Float[jax.Array, "n batch"]


def arm_accelerations(arm: ArmConstants, q: Batch, v: Batch, tau: Batch) -> Batch:
    """q̈ of `physics.arms.chain.accelerations`, float32, without a derivative."""
    return _call("arm", q, q, v, tau, **arm._asdict())


def arm_factors(arm: ArmConstants, pairs: int, q: Batch, v: Batch, tau: Batch) -> tuple[Batch, jax.Array, jax.Array]:
    """q̈, the factors `[pairs + n, batch]` of M and the packed world `[15, n, batch]`; pairs: of a joint and another one
    between it and the base."""
    n, batch = q.shape
    like = (q, jax.ShapeDtypeStruct((pairs + n, batch), q.dtype), jax.ShapeDtypeStruct((15, n, batch), q.dtype))
    return tuple(_call("arm_factors", like, q, v, tau, **arm._asdict()))
