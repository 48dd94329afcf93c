"""An arm with effects as a description that others can read: what a URDF can hold, and what it cannot."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.arm import PAYLOAD, tilted
from pgrssnn_jax.effects.arm_common import points_of
from pgrssnn_jax.effects.base import effects_of, own_of
from pgrssnn_jax.effects.stored import plain
from pgrssnn_jax.physics.arms.tables import ArmTables
from pgrssnn_jax.physics.base import Physics

_IN_TABLES = (
    "payload", "link_mass", "home_offset", "gravity_direction", "rotor_inertia", "viscous_friction", "coulomb_friction",
)  # fmt: skip


def corrected_tables(physics: Physics) -> ArmTables:
    """The tables with the physics' own numbers and with the effects that are numbers of a table. Raises `ValueError`
    for what is no arm."""
    points = points_of(physics)
    if points is None:
        raise ValueError(f"corrected arm: expected an arm, found physics {physics.name!r}")
    tables = points.tables
    own, effects = (jax.tree.map(np.asarray, part) for part in (own_of(physics.params), effects_of(physics.params)))
    of = {name: effects.get(name, {}) for name in _IN_TABLES}
    heavier = np.ones(tables.n) + of["link_mass"].get("share", 0.0)
    tables = tables._replace(
        mass=heavier * tables.mass,
        inertia=heavier[:, None, None] * tables.inertia,
        gear=own["G"],
        viscous=own["B"] + of["viscous_friction"].get("B", 0.0),
        coulomb=own["Tc"] + of["coulomb_friction"].get("Tc", 0.0),
        motor_inertia=tables.motor_inertia + of["rotor_inertia"].get("J", 0.0),
        offset=tables.offset - of["home_offset"].get("offset", 0.0),  # the state is what the encoders read
    )
    if of["gravity_direction"]:
        angles = (jnp.asarray(of["gravity_direction"][key]) for key in ("about_x", "about_y"))
        with jax.enable_x64(True):
            tables = tables._replace(gravity=np.asarray(tilted(tables.gravity, *angles), np.float64))
    return _loaded(tables, of["payload"]) if of["payload"] else tables


def beyond_urdf(physics: Physics) -> dict[str, Any]:
    """What a URDF has no place for: numbers of the motors, the size of gravity, and the other effects."""
    tables, params, meanings = corrected_tables(physics), physics.params, effects_of(physics.parameters)
    said: dict[str, Any] = {
        "joints": list(tables.joints),
        "gear_ratio": {"value": tables.gear.tolist(), "unit": ""},
        "motor_inertia": {"value": tables.motor_inertia.tolist(), "unit": "kg m^2, on the motor side"},
        "gravity": {"value": float(np.linalg.norm(tables.gravity)), "unit": "m/s^2"},
        "in_urdf": [name for name in effects_of(params) if name in _IN_TABLES and name != "rotor_inertia"],
        "effects": {},
    }
    own = own_of(params)
    for symbol, name in (("theta", "torque_bias"), ("S", "velocity_disturbance")):
        if symbol in own:
            said["effects"][name] = {symbol: {"value": plain(np.asarray(own[symbol])), "unit": ""}}
    for name, numbers in effects_of(params).items():
        if name not in _IN_TABLES:
            units = {key: meaning.unit for key, meaning in meanings[name].items()}
            said["effects"][name] = {
                key: {"value": plain(np.asarray(value)), "unit": units[key]} for key, value in numbers.items()
            }
    return said


def _loaded(tables: ArmTables, numbers: Any) -> ArmTables:
    """The last link with a payload in it."""
    mass, distance, x, y, gyration = (float(numbers[key]) for key in PAYLOAD)
    outwards = -1.0 if tables.tip[2] < 0 else 1.0
    place = tables.tip + np.array([x, y, outwards * distance])
    bodies = [
        (tables.mass[-1], tables.center[-1], tables.inertia[-1]),
        (mass, place, mass * gyration**2 * np.eye(3)),
    ]
    whole = sum(m for m, *_ in bodies)
    if not whole:
        return tables
    center = sum(m * c for m, c, _ in bodies) / whole
    inertia = sum(
        j + m * ((c - center) @ (c - center) * np.eye(3) - np.outer(c - center, c - center)) for m, c, j in bodies
    )
    return tables._replace(
        mass=np.append(tables.mass[:-1], whole),
        center=np.vstack([tables.center[:-1], center]),
        inertia=np.concatenate([tables.inertia[:-1], np.asarray(inertia)[None]]),
    )
