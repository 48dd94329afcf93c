"""Where the parts of an arm are: forward kinematics for pictures, in NumPy."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.arms.tables import ArmTables, turn_z


def skeleton(tables: ArmTables) -> Callable[[Float[np.ndarray, "*batch n"]], Float[np.ndarray, "*batch points 3"]]:
    """Base, joint origins and tip of a serial chain, `n + 2` points in m, from joint positions in rad."""

    def points(q: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch points 3"]:
        turned, origin = np.eye(3), np.zeros((*q.shape[:-1], 3))
        found = [origin]
        for i in range(tables.n):
            origin = origin + (turned @ tables.position[i])
            found.append(origin)
            turned = turned @ tables.rotation[i] @ turn_z(tables.offset[i]) @ turn_z(q[..., i])
        found.append(origin + turned @ tables.tip)
        return np.stack(found, axis=-2)

    return points
