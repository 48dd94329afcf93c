"""From the composed configuration to a physics, its records and the settings: what the API takes as values. All bad
input is found here or by the API, before a byte is written: every function raises `ValueError` with one sentence."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from pgrssnn_jax.cli.config_store import shared_start
from pgrssnn_jax.data.benchmarks import LOADERS, as_records
from pgrssnn_jax.discovery.inverse.filter_form import filter_form
from pgrssnn_jax.effects.base import Effect
from pgrssnn_jax.effects.stored import read_stored, stored_physics
from pgrssnn_jax.physics.base import Origin, Physics
from pgrssnn_jax.physics.check import check_physics
from pgrssnn_jax.physics.library import library_builder
from pgrssnn_jax.records.arguments import call_with, typed_line
from pgrssnn_jax.records.record import Record, Splits
from pgrssnn_jax.training.settings import DataSettings

_KEYS = {
    "physics", "data", "model", "fit", "members", "accelerate",
    "seed", "n_seeds", "initial_state", "n_init", "report_n_init", "resume", "recipe",
}  # fmt: skip


_OWN_DATA = ("csv", "arm_log")


class Experiment(NamedTuple):
    """physics: with the effects of `physics.effects`, if it is said."""

    physics: Physics
    train: Record
    test: Record


def load_experiment(
    config: Mapping[str, Any], notify: Callable[[str], None], *, effects: Sequence[Effect] = ()
) -> Experiment:
    """config: the resolved configuration as plain data; notify: shows one line to the user."""
    unknown = sorted(config.keys() - _KEYS - {"discovery"})
    if unknown:
        raise ValueError(f"configuration: expected the keys {sorted(_KEYS)}, found {unknown[0]!r}")
    group = dict(config["physics"])
    unnumbered = group.get("form") == "filter" and group.get("filter_numbers") is None
    if unnumbered:
        del group["form"]
    physics = load_physics(group, effects=effects)
    if physics.remark:
        notify(physics.remark)
    data = config["data"]
    if data["name"] not in LOADERS:
        raise ValueError(f"data.name: expected one of {sorted(LOADERS)}, found {data['name']!r}")
    ours = {"name", "shared_initial_state", *(field.name for field in fields(DataSettings))}
    given = {key: value for key, value in data.items() if key not in ours}
    splits = call_with(LOADERS[data["name"]], given, "data", physics=physics, notify=notify)
    start = shared_start(data, config["initial_state"])
    splits = Splits(*(part._replace(info=replace(part.info, start=start)) for part in splits))
    train, test = as_records(splits)
    if unnumbered and physics.settings.get("form") == "forward":
        physics = filter_form(physics, train)
    return Experiment(physics, train, test)


_HINTS = {
    "physics._target_": "+experiment=cascaded_tank, physics=tanks, or physics._target_=my_module.my_physics",
    "data.train": "data.train=FILE.csv (or another data=...)",
    "data.test": "data.test=FILE.csv",
}


def plain_config(config: DictConfig) -> dict[str, Any]:
    """The resolved configuration without Hydra's part; a value that must be given and is not is bad input."""
    missing = sorted(OmegaConf.missing_keys(config), key=lambda key: (not key.startswith("physics"), key))
    if missing:
        hint = _HINTS.get(missing[0], "a value on the command line")
        raise ValueError(f"{missing[0]}: expected {hint}, found none")
    return incomplete_config(config)


def incomplete_config(config: DictConfig) -> dict[str, Any]:
    """The same as `plain_config`, with `???` where a value is missing.

    What is not part of a run is left out: the name of a sweep, and the budget, which is applied here.
    """
    found = OmegaConf.to_container(config, resolve=True, throw_on_missing=False)
    assert isinstance(found, dict)
    settings = {str(key): value for key, value in found.items() if key not in ("sweep", "budget")}
    if settings.get("recipe") == "own" and "data" in settings:  # data of one's own: no recipe is known
        settings["recipe"] = "auto" if settings["data"].get("name") in _OWN_DATA else "default"
    return capped(settings, found.get("budget") or {})


def load_physics(group: Mapping[str, Any], *, effects: Sequence[Effect] = ()) -> Physics:
    """Calls the function named by `physics._target_` with the other keys of the group and checks what it returns.

    `group["effects"]`: a `discovery.json`, whose settings, numbers and effects are put into the physics; effects: of
    one's own that it may name.
    """
    target = str(group["_target_"])
    settings = {name: value for name, value in group.items() if name not in ("_target_", "effects")}
    function = library_builder(target) or imported(target, "physics._target_", "an importable function")
    try:
        physics = call_with(function, settings, "physics")
    except ValueError:
        raise
    except Exception as problem:
        reason = typed_line(problem)
        raise ValueError(f"physics: expected {target!r} to return a Physics, found {reason}") from problem
    check_physics(physics, target)
    if library_builder(target) is None:
        physics = physics._replace(origin=_own_origin(function, settings, target, physics))
    if group.get("effects") is None:
        return physics
    path = Path(str(group["effects"]))
    stored = read_stored(path, "physics.effects")
    found = stored_physics(physics, stored, where=f"physics.effects: {path}", extra=effects)
    words = ", ".join(stored["numbers"]["effects"]) or "no effect"
    return found._replace(remark=f"physics of {path}: refitted parameters, {words}")


def _own_origin(function: Any, settings: Mapping[str, Any], target: str, physics: Physics) -> Origin:
    """Settings of the user's function, and those that its physics has besides (the integrator)."""
    inner = physics.origin

    def build(**wanted: Any) -> Physics:
        built = function(**{name: value for name, value in wanted.items() if name in settings})
        more = {name: value for name, value in wanted.items() if name in built.settings and name not in settings}
        return built.variant(**more)

    more = {} if inner is None else inner.settings
    return Origin(build, {**more, **settings}, target, function)


def own_effects(names: Sequence[str], physics: Physics) -> tuple[Effect, ...]:
    """Effects of the user's own by MODULE.NAME: an `Effect`, or a function of the physics that returns one."""
    found = []
    for name in names:
        effect = imported(str(name), "discovery.effects", "an importable effect")
        effect = effect if isinstance(effect, Effect) else effect(physics)
        if not isinstance(effect, Effect):
            raise ValueError(f"discovery.effects: {name}: expected an Effect, found {type(effect).__name__}")
        found.append(effect)
    return tuple(found)


def imported(target: str, where: str, expected: str) -> Any:
    """What MODULE.NAME stands for; only ever of names that the user gave."""
    module, _, name = target.rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except Exception as problem:  # whatever a user's module does while it is imported
        reason = typed_line(problem)
        raise ValueError(f"{where}: expected {expected}, found {target!r} ({reason})") from problem


def capped(config: Mapping[str, Any], budget: Mapping[str, Any]) -> dict[str, Any]:
    """config with no number above the cap of a budget, which is the most that a run may take.

        value -> min(value, cap);  null, which stands for all there is, -> cap

    budget: `{"any": caps, "data": {name: caps}}`, either may be missing; caps: a tree like the configuration. A cap on
    what this configuration does not have says nothing, so one file serves every data set. Values that are no numbers
    stay as they are: whoever reads them says what is wrong with them. Raises `ValueError` for another form.
    """
    unknown = sorted(budget.keys() - {"any", "data"})
    if unknown:
        raise ValueError(f"budget: expected the keys any and data, found {unknown[0]!r}")
    own = budget.get("data", {}).get(config["data"]["name"], {}) if "data" in config else {}
    return _capped(_capped(config, budget.get("any", {}), "budget.any"), own, "budget.data")


def _capped(value: Any, cap: Any, where: str) -> Any:
    if isinstance(cap, Mapping):
        if not isinstance(value, Mapping):
            raise ValueError(f"{where}: expected a number as the configuration has there, found a group")
        return {
            name: _capped(part, cap[name], f"{where}.{name}") if name in cap else part for name, part in value.items()
        }
    if isinstance(value, Mapping):
        raise ValueError(f"{where}: expected a group as the configuration has there, found {cap!r}")
    if type(cap) not in (int, float):
        raise ValueError(f"{where}: expected a number, found {cap!r}")
    if value is None:
        return cap
    return min(value, cap) if type(value) in (int, float) else value
