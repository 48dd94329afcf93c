"""The groups of the configuration, made from the defaults that stand in the package; the YAML files only override.

    model/*  fit/published  members/auto  run/*  discovery/standard  data/*  physics/{tanks,lgssm,arm}  recipe/*

A value that depends on whether the physics comes from a discovery is written `${after_discovery:WITH,WITHOUT}`,
and `${conf:FILE}` is the path of a file in conf/.
"""

import inspect
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import Container, OmegaConf

from pgrssnn_jax import physics
from pgrssnn_jax.data.benchmarks import LOADERS, loader_settings
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.effects.stored import plain
from pgrssnn_jax.models.spec import VARIANTS, ModelSpec
from pgrssnn_jax.training.recipes import DEFAULT, PROOF, RECIPES, Recipe
from pgrssnn_jax.training.settings import GROUP_OF, GROUPS, DataSettings, FitSettings, MemberSettings, RunSettings

_CONF = Path(__file__).parents[2] / "conf"
_PHYSICS = {"tanks": "cascaded_tanks", "lgssm": "lgssm", "arm": "arm"}
#: benchmarks whose test record starts where the training record does
_SHARED = ("cascaded_tank",)


def register() -> None:
    """Must run before a configuration is composed; a second call changes nothing."""
    OmegaConf.register_new_resolver("after_discovery", _chosen, replace=True)
    OmegaConf.register_new_resolver("conf", lambda path: str(_CONF / path), replace=True)
    store = ConfigStore.instance()
    # Hydra copies this singleton for every group that --help lists, which takes longer than all else
    ConfigStore.__deepcopy__ = lambda self, _: self  # pyright: ignore[reportAttributeAccessIssue]
    model = {**asdict(ModelSpec()), **_nested(DEFAULT)["model"]}
    for name, changes in VARIANTS.items():
        store.store(name, {"name": name, **model, **changes}, group="model")
    store.store("published", asdict(FitSettings()), group="fit")
    store.store("auto", asdict(MemberSettings()), group="members")
    store.store("standard", plain(asdict(DiscoverySettings())), group="discovery")
    run = plain(asdict(RunSettings()))
    store.store("training", run, group="run", package="_global_")
    store.store("proof", {**run, **plain(PROOF)}, group="run", package="_global_")
    for name in LOADERS:
        said = {key: "???" if value is ... else plain(value) for key, value in loader_settings(name).items()}
        shared = {"shared_initial_state": name in _SHARED}
        own = {"window": 64} if name == "lgssm" else {}  # samples; published
        store.store(name, {"name": name, **said, **shared, **asdict(DataSettings()), **own}, group="data")
    for name, build in _PHYSICS.items():
        parameters = inspect.signature(getattr(physics, build)).parameters
        settings = {key: plain(parameter.default) for key, parameter in parameters.items()}
        target = f"pgrssnn_jax.physics.{build}"
        store.store(name, {"_target_": target, **settings, "effects": None}, group="physics")
    for name, recipe in RECIPES.items():
        store.store(name, {**_nested(recipe), "recipe": name}, group="recipe", package="_global_")
    for name in ("own", "auto", "default"):  # own: `auto` for data of one's own, `default` for those of a benchmark
        store.store(name, {"recipe": name}, group="recipe", package="_global_")


def _chosen(with_effects: Any, without: Any, *, _root_: Container) -> Any:
    return without if OmegaConf.select(_root_, "physics.effects") is None else with_effects


def _nested(recipe: Recipe) -> dict[str, Any]:
    """A recipe in the groups of the configuration."""
    usual, after = recipe.changes, recipe.after_discovery
    nested: dict[str, Any] = {}
    for name in {**usual, **after}:
        group = GROUP_OF[name]
        value = usual.get(name, getattr(GROUPS[group], name))  # a field's default is its class's attribute
        if name in after and after[name] != value:
            value = f"${{after_discovery:{_word(after[name])},{_word(value)}}}"
        place = nested if group == "run" else nested.setdefault(group, {})
        place[name] = plain(value)
    return nested


def _word(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def shared_start(data: Mapping[str, Any], initial_state: str) -> Any:
    """`RecordInfo.start` of the records of a configuration."""
    shared = data.get("shared_initial_state", False)
    if not isinstance(shared, bool):
        raise ValueError(f"data.shared_initial_state: expected true or false, found {shared!r}")
    if shared:
        return "shared"
    return "rest" if initial_state == "zero" else "unknown"
