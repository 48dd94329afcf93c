"""Effects on what an arm moves.

payload             point mass m, kg, at d m outwards from the tip along the last joint's axis
rotor_inertia       J kg m² on the motor side, felt as J G² by the links; one per joint
gravity_direction   base tilted by R = Ry(β) Rx(α): in the axes of the base gravity is Rᵀ g
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.arm_common import INFINITE, an_arm, at_neutral
from pgrssnn_jax.effects.base import Effect, at_points
from pgrssnn_jax.physics.arms.chain import Extra
from pgrssnn_jax.physics.arms.points import ArmPoints
from pgrssnn_jax.physics.base import Parameter, Physics


def _on_masses(change: Callable[[Any, ArmPoints, Extra], Extra]) -> Callable[[Physics], Physics]:
    """What the arm has besides its tables ← change(p, points, what it has)."""

    def changed(points: ArmPoints) -> ArmPoints:
        inner = points.masses
        assert inner is not None  # `an_arm(masses=True)`
        return points._replace(masses=lambda p: change(p, points, inner(p)))

    return lambda physics: at_points(physics, changed)


def _loaded(p: Any, points: ArmPoints, extra: Extra) -> Extra:
    n = p.effects["payload"]
    return extra._replace(payload=jnp.stack([n["mass"], n["distance"]]))


def _heavier(p: Any, points: ArmPoints, extra: Extra) -> Extra:
    return extra._replace(rotor=p.effects["rotor_inertia"]["J"] * p.own["G"] ** 2)


def _tilted(p: Any, points: ArmPoints, extra: Extra) -> Extra:
    n = p.effects["gravity_direction"]
    return extra._replace(gravity=tilted(points.gravity, n["about_x"], n["about_y"]))


def tilted(gravity: Float[np.ndarray, "3"], about_x: jax.Array, about_y: jax.Array) -> Float[jax.Array, "3"]:
    """Rᵀ g."""
    gx, gy, gz = (float(g) for g in gravity)
    c, s = jnp.cos(about_y), jnp.sin(about_y)
    x, z = c * gx - s * gz, s * gx + c * gz
    c, s = jnp.cos(about_x), jnp.sin(about_x)
    return jnp.stack([x, c * gy + s * z, c * z - s * gy])


def payload() -> Effect:
    """From the last link's tip; a mass at a wrong distance would look like another mass and no inertia."""
    return Effect(
        "payload",
        title="Payload",
        equation="m at d from the tip along the last joint's axis",
        cause="the arm carries a load that its description does not have",
        acts_on="dynamics",
        parameters={
            "mass": Parameter("m", "kg", bounds=(0.0, INFINITE), neutral=0.0),
            "distance": Parameter("d", "m", bounds=(-2.0, 2.0), neutral=0.0),
        },
        initial_guesses=lambda span: [{"mass": np.asarray(1.0), "distance": np.asarray(d)} for d in (0.1, 0.4)],
        wrap=_on_masses(_loaded),
        needs=an_arm(masses=True),
    )


def rotor_inertia(n: int) -> Effect:
    parameters = {"J": Parameter("J", "kg m^2", bounds=(0.0, INFINITE), neutral=0.0)}
    return Effect(
        "rotor_inertia",
        title="More motor inertia",
        equation="M(q) + diag(J G²)",
        cause="rotor, brake or gear turn with the motor and weigh more than known",
        acts_on="dynamics",
        parameters=parameters,
        initial_guesses=at_neutral(parameters, n),
        wrap=_on_masses(_heavier),
        needs=an_arm(n, masses=True),
        shapes={"J": (n,)},
        channels="joint",
    )


def gravity_direction() -> Effect:
    names = ("about_x", "about_y")
    return Effect(
        "gravity_direction",
        title="Tilted base",
        equation="g' = (Ry(β) Rx(α))ᵀ g",
        cause="the base of the arm does not stand upright",
        acts_on="dynamics",
        parameters={
            name: Parameter(symbol, "rad", bounds=(-np.pi, np.pi), neutral=0.0)
            for name, symbol in zip(names, ("α", "β"), strict=True)
        },
        initial_guesses=lambda span: [{name: np.zeros(()) for name in names}],
        wrap=_on_masses(_tilted),
        needs=an_arm(masses=True),
    )
