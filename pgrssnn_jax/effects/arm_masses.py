"""Effects on what an arm moves.

payload             point mass m, kg, at d m outwards from the tip along the last joint's axis
rotor_inertia       J kg m² on the motor side, felt as J G² by the links; one per joint
gravity_direction   base tilted by R = Ry(β) Rx(α): in the axes of the base gravity is Rᵀ g
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.arm_common import INFINITE, an_arm, per_joint, points_of
from pgrssnn_jax.effects.base import Effect, at_point
from pgrssnn_jax.physics.arms.chain import Extra
from pgrssnn_jax.physics.base import Parameter, Physics


def _loaded(n: Any, own: Any, extra: Extra) -> Extra:
    return extra._replace(payload=jnp.stack([n["mass"], n["distance"]]))


def _heavier(n: Any, own: Any, extra: Extra) -> Extra:
    return extra._replace(rotor=n["J"] * own["G"] ** 2)


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
        parameters={
            "mass": Parameter("m", "kg", bounds=(0.0, INFINITE), neutral=0.0),
            "distance": Parameter("d", "m", bounds=(-2.0, 2.0), neutral=0.0),
        },
        initial_guesses=lambda span: [{"mass": np.asarray(1.0), "distance": np.asarray(d)} for d in (0.1, 0.4)],
        wrap=lambda physics: at_point(physics, "masses", "payload", _loaded),
        needs=an_arm(masses=True),
    )


def rotor_inertia(n: int) -> Effect:
    return per_joint(
        n,
        {"J": Parameter("J", "kg m^2", bounds=(0.0, INFINITE), neutral=0.0)},
        name="rotor_inertia",
        title="More motor inertia",
        equation="M(q) + diag(J G²)",
        cause="rotor, brake or gear turn with the motor and weigh more than known",
        wrap=lambda physics: at_point(physics, "masses", "rotor_inertia", _heavier),
        needs=an_arm(n, masses=True),
    )


def gravity_direction() -> Effect:
    name, names = "gravity_direction", ("about_x", "about_y")

    def wrap(physics: Physics) -> Physics:
        points = points_of(physics)
        assert points is not None  # `needs`

        def change(n: Any, own: Any, extra: Extra) -> Extra:
            return extra._replace(gravity=tilted(points.gravity, n["about_x"], n["about_y"]))

        return at_point(physics, "masses", name, change)

    return Effect(
        name,
        title="Tilted base",
        equation="g' = (Ry(β) Rx(α))ᵀ g",
        cause="the base of the arm does not stand upright",
        parameters={
            key: Parameter(symbol, "rad", bounds=(-np.pi, np.pi), neutral=0.0)
            for key, symbol in zip(names, ("α", "β"), strict=True)
        },
        initial_guesses=lambda span: [{key: np.zeros(()) for key in names}],
        wrap=wrap,
        needs=an_arm(masses=True),
    )
