"""Physics-guided recurrent state-space neural networks, as pure functions in JAX."""

import contextlib
import os
from importlib import metadata

__version__ = "0.1.0"

# jaxlib 0.10.2 computes products with a constant matrix of equal numbers wrongly on CPUs when it fuses them with what
# stands before (jax issue 39103). Other versions may not know the flag, and XLA stops at flags that it does not know.
_FUSION = "--xla_cpu_experimental_ynn_fusion_type"
with contextlib.suppress(metadata.PackageNotFoundError):  # the entry scripts say what is missing
    if metadata.version("jaxlib") == "0.10.2" and _FUSION not in os.environ.get("XLA_FLAGS", ""):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_FUSION}=".strip()
