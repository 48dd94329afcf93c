"""What an arm has besides its tables, or in their place."""

from typing import NamedTuple

import jax


class Extra(NamedTuple):
    """None where an arm is as its tables say.

    payload: its mass, kg, the distance of its centre outwards from the tip along the last joint's axis, its place
    across it along x and y of the last joint's frame, and its radius of gyration, the same about every axis, m, `[5]`;
    rotor: armature beside the tables', kg m² on the link side, `[n]`; gravity: in place of the tables', m/s², `[3]`;
    wrist: inertia of the last motor, kg m² on the link side, and r, where it turns with q̇_n + r q̇_{n-1}, `[2]`;
    links: mass of every link beside the tables', kg, its centre theirs, the inertia in proportion to the mass, `[n]`.
    With these the tables are no constants of the compiled program any more.
    """

    payload: jax.Array | None = None
    rotor: jax.Array | None = None
    gravity: jax.Array | None = None
    wrist: jax.Array | None = None
    links: jax.Array | None = None
