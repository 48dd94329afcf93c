"""The settings that `recipe=auto` chooses from, and one member's settings as traced numbers.

The physics alone comes first: it is always a candidate. The others differ in the size of the corrections, where
training begins, the learning rate, and whether parameters of the physics and the start of the record are trained too.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import jax
import jax.numpy as jnp

from pgrssnn_jax.physics.base import Physics, is_parameter
from pgrssnn_jax.training.objective import Choice
from pgrssnn_jax.training.settings import TrainingSettings, changed

_ALONE = {"networks": False}
_FITTED = {"physics_parameters": "trained"}
_QUICKLY = {**_FITTED, "learning_rate": 1e-2}  # of their sizes per epoch: a few numbers settle in a hundred epochs
_SEARCHED = {"initial_state": "least_squares"}
_GENTLE = {"start_from_physics": True, "correction": 0.1}
#: what differs from the default settings. correction: f_nn in units of a state's scale per sample; 0.01 is for physics
#: that integrate their input, 1 is published. The learning rate 3e-3 is the arms'
CANDIDATES: Sequence[Mapping[str, Any]] = (
    _ALONE,
    {**_ALONE, **_SEARCHED},
    {**_ALONE, **_QUICKLY},
    {**_ALONE, **_QUICKLY, **_SEARCHED},
    {"start_from_physics": True, "correction": 1.0},
    {"start_from_physics": True, "correction": 1.0, **_FITTED},
    {**_GENTLE, "learning_rate": 3e-3},
    {**_GENTLE, **_FITTED, "learning_rate": 3e-3},
    {**_GENTLE, "correction": 0.01, "learning_rate": 3e-3},
    {**_GENTLE, "correction": 0.01, **_FITTED, "learning_rate": 3e-3},
    {**_GENTLE, "correction": 0.001, "learning_rate": 3e-3},
    {"correction": 0.1},
    {**_SEARCHED, "start_from_physics": True, "correction": 1.0},
    {**_SEARCHED, **_GENTLE, "learning_rate": 3e-3},
    {**_SEARCHED, **_GENTLE, **_FITTED, "learning_rate": 3e-3},
    {**_SEARCHED, **_GENTLE, "correction": 0.01, "learning_rate": 3e-3},
    {**_SEARCHED, **_GENTLE, "correction": 0.01, **_FITTED, "learning_rate": 3e-3},
)
Starts = Literal["never", "perhaps", "always"]
_STARTS = ("estimated", "least_squares")  # that are trained
_TRIED = ("correction", "start_from_physics", "learning_rate", "physics_parameters", "initial_state")


def candidates(
    settings: TrainingSettings,
    physics: Physics,
    held: Collection[str],
    usual: Mapping[str, Any],
    *,
    starts: Starts,
    networks: bool,
) -> list[TrainingSettings]:
    """The settings to choose from, without those that differ in what is held or cannot be. usual: what the recipe of
    the benchmark would choose, a candidate too; starts: is the start of a record never, perhaps or always trained?
    networks: may there be any beside the physics?"""
    changes = [] if settings.model.guided else [{}, {"learning_rate": 3e-3}]
    if settings.model.guided and not settings.model.networks:
        changes = [_ALONE, {**_ALONE, **_QUICKLY}]
    elif settings.model.guided:
        changes = [*CANDIDATES, {name: usual[name] for name in _TRIED if name in usual}]
    movable = physics.differentiable and any(
        p.trainable for p in jax.tree.leaves(physics.parameters, is_leaf=is_parameter)
    )
    possible = [
        change
        for change in changes
        if (movable or "physics_parameters" not in change)
        and (starts != "never" or change.get("initial_state") not in _STARTS)
        and (networks or not change.get("networks", settings.model.guided))
    ]
    if starts == "always":
        possible = [{**change, **_SEARCHED} for change in possible]
    free = ({name: value for name, value in change.items() if name not in held} for change in possible)
    return list(dict.fromkeys(changed(settings, change) for change in free))


def choice_of(settings: TrainingSettings, among: Sequence[TrainingSettings]) -> Choice:
    """The settings of one member as numbers; among: those of all members of the program."""
    model, fit = settings.model, settings.fit
    return Choice(
        jnp.float32(model.correction if model.guided else 1.0),
        jnp.float32(model.networks),
        jnp.bool_(model.start_from_physics and model.guided),
        jnp.float32(fit.learning_rate),
        jnp.int32(fit.patience),
        jnp.bool_(fit.physics_parameters == "trained"),
        jnp.bool_(_searched(settings)) if any(map(_searched, among)) else None,
    )


def _searched(settings: TrainingSettings) -> bool:
    return settings.run.initial_state in _STARTS


def shared_settings(settings: TrainingSettings, among: Sequence[TrainingSettings]) -> TrainingSettings:
    """Settings of one program that trains all candidates, each by its `Choice`."""
    trained = any(one.fit.physics_parameters == "trained" for one in among)
    return settings._replace(
        model=replace(settings.model, networks=True, correction=1.0, start_from_physics=False),
        fit=replace(settings.fit, physics_parameters="trained" if trained else "fixed", guard="rollback"),
    )


def is_alone(settings: TrainingSettings) -> bool:
    """Is nothing trained but, perhaps, the start?"""
    return not settings.model.networks and settings.fit.physics_parameters == "fixed"


def describe(settings: TrainingSettings) -> str:
    """One line for people."""
    fitted = settings.fit.physics_parameters == "trained"
    if not settings.model.networks:
        words = ["the physics alone", *(["its parameters trained"] if fitted else [])]
        return ", ".join([*words, f"initial_state={settings.run.initial_state}"])
    words = [f"correction={settings.model.correction:g}"] if settings.model.guided else []
    words += ["start_from_physics=true"] if settings.model.start_from_physics and settings.model.guided else []
    words += [f"learning_rate={settings.fit.learning_rate:g}"]
    words += ["physics_parameters=trained"] if fitted else []
    return ", ".join([*words, f"initial_state={settings.run.initial_state}"])
