"""Physics-guided recurrent state-space neural networks in JAX: `import pgrssnn_jax as pg`.

The names of `api.py`, and the rooms `physics` and `effects`, are loaded when they are first used.
"""
# ruff: noqa: F403, F405

import contextlib
import os
import sys
import types
import warnings
from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pgrssnn_jax import effects, physics
    from pgrssnn_jax.api import *

__version__ = "0.1.0"
__all__ = [
    "Discovered", "Effect", "Ensemble", "ModelSpec", "Parameter", "Physics", "Record", "Signal", "add", "continuous",
    "discover", "discrete", "effects", "filter_form", "fit", "load", "load_arm_log", "load_benchmark", "physics",
    "read_csv", "read_physics", "record", "rollout", "simulate",
]  # fmt: skip

# jaxlib 0.10.2 computes products with a constant matrix of equal numbers wrongly on CPUs when it fuses them with what
# stands before (jax issue 39103). Other versions may not know the flag, and XLA stops at flags that it does not know.
_FUSION = "--xla_cpu_experimental_ynn_fusion_type"
# The rest of the API need not be loaded for these.
_OF_PHYSICS = ("Parameter", "Physics", "Signal", "continuous", "discrete")


def _avoid_wrong_products() -> None:
    with contextlib.suppress(metadata.PackageNotFoundError):  # the entry scripts say what is missing
        if metadata.version("jaxlib") != "0.10.2" or _FUSION in os.environ.get("XLA_FLAGS", ""):
            return
        if "jax" in sys.modules and import_module("jax._src.xla_bridge").backends_are_initialized():
            warnings.warn(
                "pgrssnn_jax: jaxlib 0.10.2 computes some products wrongly on CPUs, and JAX is already running without "
                f"the flag that avoids it: import pgrssnn_jax first, or set XLA_FLAGS={_FUSION}",
                stacklevel=3,
            )
            return
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_FUSION}=".strip()


_avoid_wrong_products()


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import_module("pgrssnn_jax.acceleration.devices").use_all_cores()
    if name in ("physics", "effects"):
        return import_module(f"pgrssnn_jax.{name}")
    return getattr(import_module(f"pgrssnn_jax.{'physics.base' if name in _OF_PHYSICS else 'api'}"), name)


class _Finished(types.ModuleType):
    """`pgrssnn_jax.finished` of version 0.1."""

    def __getattr__(self, name: str) -> Any:
        if name != "load_run":
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        warnings.warn("pgrssnn_jax.finished.load_run is now called pgrssnn_jax.load", FutureWarning, stacklevel=2)
        return __getattr__("load")


sys.modules[f"{__name__}.finished"] = _Finished(f"{__name__}.finished")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
