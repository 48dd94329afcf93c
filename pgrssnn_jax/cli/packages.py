"""Are the packages there? Imports the standard library alone, so that a missing one is named instead of a traceback."""

import sys
from collections.abc import Sequence
from importlib import metadata, util

from pgrssnn_jax.cli.process import say

_MODULES = {
    "jax": "jax", "flax": "flax", "optax": "optax", "orbax-checkpoint": "orbax", "hydra-core": "hydra",
    "numpy": "numpy", "scipy": "scipy", "pandas": "pandas", "matplotlib": "matplotlib", "rich": "rich",
    "jaxtyping": "jaxtyping", "nonlinear-benchmarks": "nonlinear_benchmarks", "pin": "pinocchio",
}  # fmt: skip
_LAUNCHERS = {"joblib": "hydra-joblib-launcher", "submitit": "hydra-submitit-launcher"}


def check_packages() -> None:
    """Ends with exit code 2 and one sentence when a package is missing, or when the wrong `pinocchio` is there."""
    if problem := package_problem() or launcher_problem(sys.argv[1:]):
        sys.exit(say(problem))


def launcher_problem(arguments: Sequence[str]) -> str | None:
    """What is missing of the launcher that the command line asks for; Hydra itself would only list those it has."""
    for argument in arguments:
        name = argument.removeprefix("hydra/launcher=") if argument.startswith("hydra/launcher=") else ""
        package = _LAUNCHERS.get(name.split("_")[0])
        if package and not _installed(package):
            return (
                f"hydra/launcher={name}: expected the package {package}, found none installed: "
                f"run `pip install 'pgrssnn_jax[sweep]'` (in a checkout `pip install -e '.[sweep]'`)."
            )
    return None


def package_problem() -> str | None:
    if not _installed("pin") and _installed("pinocchio"):
        return (
            "packages: expected Pinocchio from the package 'pin', found the unrelated package 'pinocchio': "
            "run `pip uninstall pinocchio` and then `make install`."
        )
    missing = [name for name, module in _MODULES.items() if util.find_spec(module) is None]
    if missing:
        return f"packages: expected {', '.join(missing)}, found none installed: run `make install` and use `.venv`."
    return None


def _installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True
