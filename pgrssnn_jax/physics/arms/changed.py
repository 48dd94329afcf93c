"""Effects that change what an arm moves, as numbers of its forward dynamics.

payload             point mass μ, kg, at d m outwards from the tip along the last joint's axis
rotor_inertia       J kg m² on the motor side, felt as J G² by the links
gravity_direction   base tilted by R = Ry(β) Rx(α): in the axes of the base gravity is Rᵀ g
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.arms.chain import Extra
from pgrssnn_jax.physics.arms.tables import ArmTables


def extra(tables: ArmTables, p: Any) -> Extra:
    """From the effects that are among the parameters."""
    payload = rotor = gravity = None
    if "payload" in p:
        payload = jnp.stack([p["payload"]["mass"], p["payload"]["distance"]])
    if "rotor_inertia" in p:
        rotor = p["rotor_inertia"]["J"] * p["G"] ** 2
    if "gravity_direction" in p:
        gravity = tilted(tables.gravity, p["gravity_direction"]["about_x"], p["gravity_direction"]["about_y"])
    return Extra(payload, rotor, gravity)


def tilted(gravity: Float[np.ndarray, "3"], about_x: jax.Array, about_y: jax.Array) -> Float[jax.Array, "3"]:
    """Rᵀ g."""
    gx, gy, gz = (float(g) for g in gravity)
    c, s = jnp.cos(about_y), jnp.sin(about_y)
    x, z = c * gx - s * gz, s * gx + c * gz
    c, s = jnp.cos(about_x), jnp.sin(about_x)
    return jnp.stack([x, c * gy + s * z, c * z - s * gy])
