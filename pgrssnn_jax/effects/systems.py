"""Which effects a physics may lack, by the system that it is, in the order in which they are added to it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pgrssnn_jax.effects.arm import arm_effects
from pgrssnn_jax.effects.base import Effect, Numbers, add
from pgrssnn_jax.effects.lgssm import lgssm_effects
from pgrssnn_jax.effects.sensors_actuators import any_system_effects
from pgrssnn_jax.effects.tanks import tank_effects
from pgrssnn_jax.physics.base import Physics

_PARAMETERS = {"arm": {"G", "B", "Tc"}, "lgssm": {"A", "B", "C"}, "tanks": {"k1", "k2", "k3", "k4", "k5"}}
_SAID_OTHERWISE = {"tanks": ("input_saturation", "input_dead_zone")}  # a pump has names of its own for these


def catalogue(physics: Physics, without: Sequence[str] = ()) -> tuple[Effect, ...]:
    """The system's own effects, then those of any system, but for those named in `without`.

    Raises `ValueError` when `without` names an effect that this physics does not have.
    """
    system = system_of(physics)
    # an arm's own effects say per joint what those of any system would
    found = arm_effects(physics) if system == "arm" else (*_own(physics, system), *any_system_effects(physics))
    found = tuple(e for e in found if e.name not in _SAID_OTHERWISE.get(system, ()))
    known = [effect.name for effect in found]
    for name in without:
        if name not in known:
            raise ValueError(f"effects: expected some of {known} of physics {physics.name!r}, found {name!r}")
    return tuple(effect for effect in found if effect.name not in without)


def system_of(physics: Physics) -> str:
    """`arm`, `lgssm` or `tanks` for the library's own systems, `any` for others, whatever they are called."""
    return physics.name if _PARAMETERS.get(physics.name, {""}) <= set(physics.params) else "any"


def _own(physics: Physics, system: str) -> tuple[Effect, ...]:
    if system == "tanks":
        return tank_effects(physics)
    if system == "lgssm":
        return lgssm_effects(physics)
    return ()


def add_named(physics: Physics, numbers: Mapping[str, Numbers]) -> Physics:
    """The physics with the effects that `numbers` names, each with its numbers, in the catalogue's order.

    Raises `ValueError` for a name that is not in the catalogue of this physics.
    """
    known = catalogue(physics)
    names = [effect.name for effect in known]
    for name in numbers:
        if name not in names:
            raise ValueError(f"effects: expected some of {names} of physics {physics.name!r}, found {name!r}")
    chosen = [effect for effect in known if effect.name in numbers]
    return add(physics, *chosen, numbers={effect.name: _numbers(effect, numbers[effect.name]) for effect in chosen})


def _numbers(effect: Effect, given: Numbers) -> dict[str, Any]:
    """Numbers as a JSON file holds them: None stands for a limit that is not there."""
    neutral = effect.neutral()

    def one(name: str, value: Any) -> np.ndarray:
        found = np.asarray(value, object)
        absent = np.vectorize(lambda v: v is None, otypes=[bool])(found)
        return np.where(absent, neutral.get(name, np.nan), np.where(absent, np.nan, found)).astype(np.float64)

    return {name: one(name, value) for name, value in given.items()}
