"""Compiling with little optimisation, which takes about half as long: for what compiles longer than it runs."""

import os
from importlib import metadata

_FLAGS = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"


def little_optimised() -> dict[str, str]:
    """Variables of the environment, set before JAX compiles; none for an XLA that may stop at flags it lacks."""
    if metadata.version("jaxlib") != "0.10.2":
        return {}
    return {"XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {_FLAGS}".strip()}
