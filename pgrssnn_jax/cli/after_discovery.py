"""Configurations that depend on whether a discovery is given: `${after_discovery:WITH,WITHOUT}`.

WITH where `physics.effects` names a `discovery.json`, else WITHOUT. What was fitted to the whole estimation record is
best trained on in another way than the physics as published; the command line overrides both.
"""

from typing import Any

from omegaconf import Container, OmegaConf


def register() -> None:
    """Must run before a configuration is resolved; a second call changes nothing."""
    OmegaConf.register_new_resolver("after_discovery", _chosen, replace=True)


def _chosen(with_effects: Any, without: Any, *, _root_: Container) -> Any:
    return without if OmegaConf.select(_root_, "physics.effects") is None else with_effects
