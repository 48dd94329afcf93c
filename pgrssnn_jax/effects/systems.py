"""Which effects a physics may lack, by the system that it is, in the order in which they are added to it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pgrssnn_jax.effects.arm import arm_effects
from pgrssnn_jax.effects.arm_common import points_of
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, add, effects_of, own_of
from pgrssnn_jax.effects.generic import generic_effects
from pgrssnn_jax.effects.lgssm import lgssm_effects
from pgrssnn_jax.effects.periodic import periodic_disturbance, periodic_sensor_error
from pgrssnn_jax.effects.sensors_actuators import any_system_effects
from pgrssnn_jax.effects.tanks import tank_effects
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.check import check_given
from pgrssnn_jax.records.arguments import check_kind, shown, typed_line

_PARAMETERS = {"lgssm": {"A", "B", "C"}, "tanks": {"k1", "k2", "k3", "k4", "k5"}}
_SAID_OTHERWISE = {"tanks": ("input_saturation", "input_dead_zone")}  # a pump has names of its own for these


def catalogue(physics: Physics, without: Sequence[str] = (), extra: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """The system's own effects that this physics can take and does not have, then those of any system, but for those
    named in `without`; then the user's own ones, `extra`.

    Raises `ValueError` when `without` names an effect that is not among them, and for an extra effect whose name is
    taken or that the physics cannot take.
    """
    there = effects_of(physics.params)
    found = [effect for effect in _of_system(physics) if effect.needs.met(physics) and effect.name not in there]
    known = [effect.name for effect in found]
    for name in without:
        if name not in known:
            raise ValueError(f"effects: expected some of {known} of physics {physics.name!r}, found {name!r}")
    found = [effect for effect in found if effect.name not in without]
    if isinstance(extra, Effect | str) or not isinstance(extra, Sequence):
        raise ValueError(f"effects: expected a list of pg.Effect, found {shown(extra)}")
    for effect in extra:
        check_kind("effects", effect, Effect, "a list of pg.Effect")
        if effect.name in (other.name for other in found):
            raise ValueError(f"effects: expected extra effects with names of their own, found another {effect.name!r}")
        _added(physics, effect)  # raises for what the physics cannot take
        if effect.initial_guesses is None:
            none = np.zeros((2, 1))
            effect.guesses(SignalRange(none, none, none))  # raises where none can be made up
        found.append(effect)
    return tuple(found)


def system_of(physics: Physics) -> str:
    """`arm`, `lgssm` or `tanks` for the library's own systems, `any` for others, whatever they are called."""
    if points_of(physics) is not None:
        return "arm"
    return physics.name if _PARAMETERS.get(physics.name, {""}) <= set(own_of(physics.params)) else "any"


def _of_system(physics: Physics) -> tuple[Effect, ...]:
    """Also those that a setting of the physics (an arm's backend) does not allow."""
    system = system_of(physics)
    if system == "arm":  # its own effects say per joint what those of any system would
        return arm_effects(physics)
    own = {"tanks": tank_effects, "lgssm": lgssm_effects, "any": generic_effects}[system]
    # a disturbance reaches the plant past its actuator, whatever play, range or delay that has
    found = (
        periodic_disturbance(physics),
        *own(physics),
        *any_system_effects(physics),
        periodic_sensor_error(physics),
    )
    return tuple(effect for effect in found if effect.name not in _SAID_OTHERWISE.get(system, ()))


def add_effect(physics: Physics, effect: Effect | str, /, **numbers: Any) -> Physics:
    """The physics with one effect, one of the user's or that of the catalogue with this name.

    numbers: by the names of the effect's parameters; one number stands for all channels or joints; None, and what is
    not given, is neutral. Raises `ValueError` for an unknown name, an effect that the physics cannot take or already
    has, and for numbers that are not the effect's.
    """
    check_given(physics)
    if isinstance(effect, str):
        return add_named(physics, {effect: numbers})
    check_kind("effects", effect, Effect, "the name of an effect or a pg.Effect")
    _added(physics, effect)
    return add_named(physics, {effect.name: numbers}, [effect])


def _added(physics: Physics, effect: Effect) -> Physics:
    """With an effect of the user's own. Raises `ValueError` where it does not make a physics of it."""
    where = f"effects: {effect.name}"
    if not callable(effect.wrap):
        raise ValueError(f"{where}: wrap: expected a function of a Physics, found {shown(effect.wrap)}")
    try:
        found = add(physics, effect)
        check_given(found._replace(origin=None))
    except ValueError as problem:
        said = str(problem)
        raise ValueError(said if said.startswith("effects: ") else f"{where}: {said}") from None
    except Exception as problem:  # whatever a user's function does
        reason = typed_line(problem)
        raise ValueError(f"{where}: wrap: expected it to return a Physics, found {reason}") from problem
    return found


def add_named(physics: Physics, numbers: Mapping[str, Numbers], extra: Sequence[Effect] = ()) -> Physics:
    """The physics with the effects that `numbers` names, each with its numbers, in their order.

    extra: effects beside those of the catalogue. Raises `ValueError` for a name that is in neither.
    """
    known = {effect.name: effect for effect in (*_of_system(physics), *extra)}
    for name in numbers:
        if name not in known:
            raise ValueError(f"effects: expected some of {list(known)} of physics {physics.name!r}, found {name!r}")
    filled = {name: _numbers(known[name], given) for name, given in numbers.items()}
    return add(physics, *(known[name] for name in numbers), numbers=filled)


def in_catalogue_order(physics: Physics, names: Iterable[str]) -> list[str]:
    """The order in which discovery adds effects: that of the catalogue, then those that are not in it."""
    known = [effect.name for effect in _of_system(physics)]
    return sorted(names, key=lambda name: known.index(name) if name in known else len(known))


def _numbers(effect: Effect, given: Numbers) -> dict[str, Any]:
    """Numbers as a JSON file or a user gives them: None stands for neutral (a limit that is not there), one number for
    those of all channels."""
    check_kind(f"effects: {effect.name}", given, Mapping, f"numbers by their names, {sorted(effect.parameters)}")
    neutral = effect.neutral()

    def one(name: str, value: Any) -> np.ndarray:
        found, missing = np.asarray(value, object), neutral.get(name, np.asarray(np.nan))
        if found.ndim == 0 or found.shape == missing.shape:
            absent = np.reshape([v is None for v in found.flat], found.shape)
            found = np.where(absent, missing, found)
        try:
            return found.astype(np.float64)
        except (TypeError, ValueError, OverflowError) as problem:
            raise ValueError(f"effects: {effect.name}.{name}: expected numbers, found {value!r}") from problem

    return {name: one(name, value) for name, value in given.items()}
