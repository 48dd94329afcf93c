"""A physics as plain data, and back: settings of its builder, its numbers, its effects with theirs.

The same keys stand in `discovery.json` (what discovery found) and in the `physics.json` of a run folder (what was
trained on). Reading them executes nothing: the physics is given, the file only sets its numbers.
"""

import hashlib
import inspect
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pgrssnn_jax.effects.base import Effect, WithEffects, effects_of, own_of
from pgrssnn_jax.effects.systems import add_named, in_catalogue_order
from pgrssnn_jax.physics.base import Physics, Signal
from pgrssnn_jax.records.arguments import shown, typed_line

OF_TRAINING = ("derivatives", "physics_gradient", "backend")  # settings that leave the physics as it is
_KEYS = ("system", "physics", "numbers", "initial_state")


def physics_to_json(physics: Physics) -> dict[str, Any]:
    """Everything that `stored_physics` needs beside the physics without its effects, and what tells another one."""
    target = physics.origin.target if physics.origin else ""
    return {
        "system": physics.name,
        "physics": {"_target_": target or None, **settings_to_json(physics)},
        "numbers": {"parameters": plain(own_of(physics.params)), "effects": _in_order(physics)},
        "initial_state": {s.name: s.start for s in physics.states if s.start is not None},
        "signals": {kind: _named(getattr(physics, kind)) for kind in ("states", "inputs", "outputs")},
        "dt": physics.dt,
        "output_timing": physics.output_timing,
        "discovered": physics.discovered,
        "optimism": physics.optimism,
        "source_sha256": source_digest(physics),
    }


def settings_to_json(physics: Physics) -> dict[str, Any]:
    """The settings of the physics' builder as plain data; functions among them are left out."""
    return {name: plain(value) for name, value in physics.settings.items() if not callable(value)}


def stored_physics(physics: Physics, stored: Mapping[str, Any], *, where: str, extra: Sequence[Effect] = ()) -> Physics:
    """The physics with the settings, numbers, effects and initial states of a file.

    The file's settings (limits, integrator) take the place of the physics' own, because the numbers were fitted with
    them. extra: effects that are in no catalogue; where: the file, for messages. Raises `ValueError` when the file is
    of another physics or names an effect that the physics cannot take.
    """
    check_keys(stored, where)
    if stored["system"] != physics.name:
        raise ValueError(f"{where}: expected physics {physics.name!r}, found {stored['system']!r}")
    wanted = {
        name: value
        for name, value in stored["physics"].items()
        if name in physics.settings and name not in OF_TRAINING and value != plain(physics.settings[name])
    }
    base = physics.variant(**{name: value for name, value in wanted.items() if not callable(physics.settings[name])})
    effects, there = stored["numbers"]["effects"], effects_of(base.params)
    own = _like(own_of(base.params), stored["numbers"]["parameters"], where)
    kept = {name: _like(there[name], effects[name], where, name) for name in there if name in effects}
    base = base._replace(params=WithEffects(own, kept) if there else own)
    order = stored["numbers"].get("order") or list(effects)
    if not isinstance(order, list) or any(name not in list(effects) for name in order):
        raise ValueError(f"{where}: numbers.order: expected names among {list(effects)}, found {shown(order)}")
    if "verdict" in stored and "order" not in stored["numbers"]:  # files of before list effects as they were found
        order = in_catalogue_order(base, effects)
    found = add_named(base, {name: effects[name] for name in order if name not in there}, extra)
    start = stored["initial_state"] or {}
    for name, value in start.items():
        if not _is_number(value):
            raise ValueError(f"{where}: initial_state: {name}: expected a finite number, found {shown(value)}")
    states = tuple(s._replace(start=start[s.name]) if s.name in start else s for s in found.states)
    discovered, optimism = bool(stored.get("discovered", "verdict" in stored)), stored.get("optimism")
    if optimism is not None and not (_is_number(optimism) and optimism >= 1.0):
        raise ValueError(f"{where}: optimism: expected null or a number of at least 1, found {shown(optimism)}")
    return found._replace(states=states, discovered=discovered, optimism=optimism)


def _is_number(value: Any) -> bool:
    is_real = isinstance(value, int | float) and not isinstance(value, bool)
    return is_real and abs(value) <= sys.float_info.max


def read_stored(path: Path, where: str) -> dict[str, Any]:
    """A `discovery.json` or `physics.json`; where: the setting that names it. Raises `ValueError` when it is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as problem:
        reason = typed_line(problem)
        raise ValueError(f"{where}: expected a discovery.json, found {str(path)!r} ({reason})") from problem
    check_keys(found, f"{where}: {path}")
    return found


def check_keys(found: Any, where: str) -> None:
    """Raises `ValueError` when plain data cannot be a stored physics."""
    missing = [key for key in _KEYS if not isinstance(found, dict) or key not in found]
    if missing:
        raise ValueError(f"{where}: expected the key {missing[0]!r} of a stored physics, found none")
    found = {**found, "initial_state": found["initial_state"] or {}}  # null: nothing is known
    for key, inner in (("physics", ()), ("numbers", ("parameters", "effects")), ("initial_state", ())):
        if not isinstance(found[key], dict) or any(not isinstance(found[key].get(name), dict) for name in inner):
            raise ValueError(f"{where}: {key}: expected a group of named values, found {shown(found[key])}")


def source_digest(physics: Physics) -> str | None:
    """The first 12 hexadecimal digits of the SHA-256 of the source of the physics; None where there is none.

    Its source is that of the function of a module that built it, so that a command and Python agree."""
    function = _source(physics)
    module = sys.modules.get(getattr(function, "__module__", ""))
    outermost = getattr(function, "__qualname__", "").partition(".<locals>")[0]
    return _digest(getattr(module, outermost, function))


def has_source(physics: Physics, digest: str | None) -> bool:
    """Is it the digest of this physics, or that of its inner function, which earlier versions stored?"""
    return digest in (source_digest(physics), _digest(_source(physics)))


def _source(physics: Physics) -> Callable[..., Any]:
    return physics.origin.source if physics.origin and physics.origin.source else physics.step


def _digest(function: Callable[..., Any]) -> str | None:
    try:
        return hashlib.sha256(inspect.getsource(function).encode()).hexdigest()[:12]
    except (OSError, TypeError):
        return None


def plain(tree: Any) -> Any:
    """Numbers, lists, names and None in place of arrays, tuples and paths; infinite limits as None."""
    if isinstance(tree, Mapping):
        return {str(key): plain(value) for key, value in tree.items()}
    if isinstance(tree, np.ndarray | jax.Array | np.generic):
        return plain(np.asarray(tree).tolist())
    if isinstance(tree, list | tuple):
        return [plain(value) for value in tree]
    if isinstance(tree, float):
        return tree if math.isfinite(tree) else None
    return str(tree) if isinstance(tree, Path) else tree


def _in_order(physics: Physics) -> dict[str, Any]:
    """Numbers of the effects in the order in which they were added, which `parameters` has kept."""
    numbers = effects_of(physics.params)
    return {name: plain(numbers[name]) for name in effects_of(physics.parameters)}


def _named(signals: Sequence[Signal]) -> list[list[str]]:
    return [[signal.name, signal.unit] for signal in signals]


def _like(params: Any, found: Any, where: str, name: str = "parameters") -> Any:
    """Numbers of a file in the tree of the physics' params."""
    if isinstance(params, list | tuple) and isinstance(found, list) and len(found) == len(params):
        return type(params)(_like(one, other, where, name) for one, other in zip(params, found, strict=True))
    if not isinstance(params, Mapping):
        return _shaped(params, found, where, name)
    if not isinstance(found, Mapping) or sorted(found) != sorted(params):
        there = sorted(found) if isinstance(found, Mapping) else found
        raise ValueError(f"{where}: expected {name} {sorted(params)}, found {there}")
    return {key: _like(params[key], found[key], where, key) for key in params}


def _shaped(like: Any, value: Any, where: str, name: str) -> np.ndarray:
    """None stands for an infinite number, which is then that of the physics itself."""
    try:
        given = np.asarray(value, object)
        absent = np.reshape([number is None for number in given.flat], given.shape)
        found = np.where(absent, like, given).astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if found.shape != np.shape(like) or np.isnan(found).any():
        raise ValueError(f"{where}: {name}: expected numbers of shape {np.shape(like)}, found {shown(value)}")
    return found
