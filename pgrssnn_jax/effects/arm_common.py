"""What the effects of an arm have in common: which arms can take them, and where their fits begin."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pgrssnn_jax.effects.base import Effect, Needs, at_point, counted
from pgrssnn_jax.physics.arms.points import ArmPoints
from pgrssnn_jax.physics.base import Parameter, Physics, extension_of

INFINITE = float("inf")
STANDSTILL = 0.02  # rad/s: v0 of dry friction


def points_of(physics: Physics) -> ArmPoints | None:
    """The extension points of an arm; None for what is none."""
    known = extension_of(physics)
    return known.points if known and isinstance(known.points, ArmPoints) else None


def an_arm(n: int | None = None, *, masses: bool = False) -> Needs:
    """n: number of joints, None: any. masses: the effect changes those that the arm moves."""

    def met(physics: Physics) -> bool:
        points = points_of(physics)
        return points is not None and n in (None, len(physics.inputs)) and not (masses and points.masses is None)

    joints = "" if n is None else f" of {counted(n, 'joint')}"
    return Needs(f"an arm{joints}{' with backend=jax' if masses else ''}", met)


def arm_effect(
    n: int | None,
    name: str,
    point: str,
    change: Callable[..., Any],
    parameters: Mapping[str, Parameter],
    *,
    per_joint: bool = True,
    **fields: Any,
) -> Effect:
    """v ← change(numbers, own, v, ...) at an extension point of an arm of n joints (None: any).

    per_joint: one number of each parameter per joint; false, or for any arm: one in all. A fit begins at none where
    the fields do not say otherwise: the torque is linear in the numbers.
    """
    shape = () if n is None or not per_joint else (n,)
    whole: dict[str, Any] = {
        "wrap": lambda physics: at_point(physics, point, name, change),
        "shapes": dict.fromkeys(parameters, shape) if shape else {},
        "initial_guesses": lambda span: [{key: np.full(shape, p.neutral, float) for key, p in parameters.items()}],
        "needs": an_arm(n, masses=point == "masses"),
        "channels": "joint" if shape else "",
    }
    return Effect(name, parameters, **{**whole, **fields})


def largest(span: np.ndarray, first: int = 0) -> np.ndarray:
    """Largest absolute value of every channel from the first one named."""
    return np.maximum(np.abs(span[:, first:]).max(0), 1e-12)
