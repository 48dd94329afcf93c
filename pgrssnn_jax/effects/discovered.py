"""The physics that a discovery ended with: `physics.effects=RUNFOLDER/discovery.json`."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pgrssnn_jax.effects.systems import add_named
from pgrssnn_jax.physics.base import Physics

OF_TRAINING = ("derivatives", "physics_gradient", "backend")  # settings that leave the physics as it is
_KEYS = ("system", "verdict", "physics", "numbers", "initial_state")


def discovered_physics(group: Mapping[str, Any], load: Callable[[Mapping[str, Any]], Physics]) -> Physics:
    """The physics of a `discovery.json` with its fitted parameters and effects; load: from settings to a physics.

    Its settings (limits, integrator) take the place of the group's, because parameters and effects were fitted with
    them. Where the estimation record shares its start with the test record, states start where the fit found them.
    Raises `ValueError` when the file is none, or belongs to another physics.
    """
    path = Path(str(group["effects"]))
    found = _read(path)
    if found["physics"].get("_target_") != group["_target_"]:
        expected, other = group["_target_"], found["physics"].get("_target_")
        raise ValueError(f"physics.effects: {path}: expected a discovery of {expected}, found one of {other}")
    kept = {name: group[name] for name in OF_TRAINING if name in group}
    base = load({**found["physics"], **kept, "effects": None})
    parameters = found["numbers"]["parameters"]
    if sorted(parameters) != sorted(base.params):
        raise ValueError(
            f"physics.effects: {path}: expected parameters {sorted(base.params)}, found {sorted(parameters)}"
        )
    base = base._replace(params=jax.tree.map(_array, base.params, parameters))
    physics = add_named(base, found["numbers"]["effects"])
    start = found["initial_state"] or {}
    states = tuple(s._replace(start=start[s.name]) if s.name in start else s for s in physics.states)
    words = ", ".join(found["numbers"]["effects"]) or "no effect"
    return physics._replace(states=states, remark=f"physics of {path}: refitted parameters, {words}")


def _array(like: Any, value: Any) -> np.ndarray:
    return np.asarray(value, np.float64).reshape(np.shape(like))


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        raise ValueError(f"physics.effects: expected a discovery.json, found {str(path)!r} ({problem})") from problem
    missing = [key for key in _KEYS if not isinstance(found, dict) or key not in found]
    if missing:
        raise ValueError(f"physics.effects: {path}: expected the key {missing[0]!r} of a discovery.json, found none")
    return found
