"""What may be hidden in the arm, and how large it is drawn; joints are counted from 1 in the magnitudes.

A size that matters differs by joint: gravity holds joints 2 and 3 (some thousand Nm/rad), the others drift freely.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - its files are in a folder of their own

from pgrssnn_jax.physics.arms.tables import ArmTables

from .arm_plant import Effects
from .case import Catalogue

CATALOGUE = Catalogue(
    acts_on={
        "torque_bias": "drive",
        "torque_gain": "drive",
        "linear_spring": "spring",
        "gravity_counterbalance": "balance",
        "viscous_friction": "friction",
        "coulomb_friction": "friction",
        "velocity_disturbance": "velocity",
        "payload": "load",
        "gravity_direction": "base",
        "home_offset": "sensor",
        "ripple": "drive",
    },
    unnamed=("ripple",),
    noises=(1e-4, 1e-3, 1e-2),  # rad, as encoders have it
    identical={
        "torque_bias": ("input_offset",),
        "torque_gain": ("input_gain",),
        "home_offset": ("sensor_offset",),
    },
    family={"coulomb_friction": ("stribeck_friction", "stiction")},
    recalibrated=("viscous_friction", "coulomb_friction"),  # both are parameters of the base physics
)
_FRICTION = 0.1  # relative error of every known friction number, at most

_BIAS = np.array([5.0, 60.0, 30.0, 2.0, 4.0, 1.0])  # Nm, the least; the largest is four times as large
_LOAD_RADIUS = 0.15  # m, of a solid ball
_STRUCTURAL = 0.5  # share of the wrong gravities, of the wrong zeros: half a turn, a quarter turn
Change = tuple[ArmTables, Effects, dict[str, Any]]


def _some(rng: np.random.Generator, among: tuple[int, ...], least: int, most: int) -> np.ndarray:
    """Joints, counted from 0."""
    return np.sort(rng.choice(among, size=int(rng.integers(least, most + 1)), replace=False))


def _signs(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.choice([-1.0, 1.0], size=n)


def _placed(base: np.ndarray, joints: np.ndarray, values: np.ndarray) -> np.ndarray:
    found = np.array(base, float)
    found[joints] += values
    return found


def _said(name: str, joints: np.ndarray, values: np.ndarray) -> dict[str, Any]:
    return {name: values.tolist(), f"{name}_joints": (joints + 1).tolist()}


def _torque_bias(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    joints = _some(rng, tuple(range(6)), 2, 6)
    bias = _signs(rng, len(joints)) * _BIAS[joints] * rng.uniform(1, 4, len(joints))
    return tables, effects._replace(bias=_placed(effects.bias, joints, bias)), _said("torque_bias", joints, bias)


def _torque_gain(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    joints = _some(rng, tuple(range(6)), 1, 3)
    off = _signs(rng, len(joints)) * rng.uniform(0.05, 0.15, len(joints))
    return tables, effects._replace(gain=_placed(effects.gain, joints, off)), _said("torque_gain", joints, 1 + off)


def _viscous(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """Nm s on the motor side, 30 to 100 % of what is known."""
    joints = _some(rng, tuple(range(6)), 1, 3)
    more = tables.viscous[joints] * rng.uniform(0.3, 1.0, len(joints))
    changed = tables._replace(viscous=_placed(tables.viscous, joints, more))
    return changed, effects, _said("viscous_friction", joints, more)


def _coulomb(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """Nm on the motor side, 20 to 60 % of what is known."""
    joints = _some(rng, tuple(range(6)), 1, 3)
    more = tables.coulomb[joints] * rng.uniform(0.2, 0.6, len(joints))
    changed = tables._replace(coulomb=_placed(tables.coulomb, joints, more))
    return changed, effects, _said("coulomb_friction", joints, more)


def _memory(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """For samples of 0.1 s."""
    s = _signs(rng, 6) * rng.uniform(0.05, 0.2, 6)
    return tables, effects._replace(memory=effects.memory + s), _said("velocity_disturbance", np.arange(6), s)


def _payload(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """kg, a solid ball about the flange."""
    mass = float(rng.uniform(50, 200))
    ball = pin.Inertia(mass, np.array(tables.tip), 0.4 * mass * _LOAD_RADIUS**2 * np.eye(3))
    link = pin.Inertia(float(tables.mass[-1]), tables.center[-1], tables.inertia[-1]) + ball
    loaded = tables._replace(
        mass=np.append(tables.mass[:-1], link.mass),
        center=np.vstack([tables.center[:-1], link.lever]),
        inertia=np.concatenate([tables.inertia[:-1], link.inertia[None]]),
    )
    return loaded, effects, {"payload": mass}


def _gravity(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """The base leans by an angle, rad, towards a heading in the floor's plane, or hangs from the ceiling."""
    tilt, heading = float(np.deg2rad(rng.uniform(2, 8))), float(rng.uniform(0, 2 * np.pi))
    tilt = np.pi if rng.random() < _STRUCTURAL else tilt
    axis = np.array([-np.sin(heading), np.cos(heading), 0.0])
    leaning = tables._replace(gravity=pin.exp3(tilt * axis) @ tables.gravity)
    return leaning, effects, {"tilt": tilt, "heading": heading, "gravity": leaning.gravity.tolist()}


def _home(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """A few degrees, or a quarter turn of one joint. Not joint 1, about whose vertical axis every angle is alike, and
    not joint 6, which carries next to nothing."""
    joints = np.union1d(_some(rng, (1, 2), 1, 2), _some(rng, (3, 4), 0, 1)).astype(int)
    off = _signs(rng, len(joints)) * rng.uniform(0.02, 0.1, len(joints))
    if rng.random() < _STRUCTURAL:
        joints, off = joints[:1], np.sign(off[:1]) * np.pi / 2
    return tables, effects._replace(home=_placed(effects.home, joints, off)), _said("home_offset", joints, off)


def _spring(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """A cable bundle, Nm/rad."""
    joints = _some(rng, tuple(range(6)), 1, 2)
    stiff = 2 * _BIAS[joints] * rng.uniform(1, 4, len(joints))
    changed = effects._replace(spring=_placed(np.zeros(6), joints, stiff))
    return tables, changed, _said("linear_spring", joints, stiff)


def _counterbalance(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """A spring that bears part of the arm's weight, Nm and rad."""
    moment, angle = float(rng.uniform(500, 3000)), float(rng.uniform(-np.pi, np.pi))
    return tables, effects._replace(counterbalance=(moment, angle)), {"counterbalance": [moment, angle]}


def _ripple(rng: np.random.Generator, tables: ArmTables, effects: Effects) -> Change:
    """A hum of the drives, Nm and Hz, for which the catalogue has no name."""
    joints = _some(rng, tuple(range(6)), 1, 2)
    size, hum = 2 * _BIAS[joints] * rng.uniform(1, 4, len(joints)), float(rng.uniform(0.5, 2.0))
    changed = effects._replace(ripple=_placed(np.zeros(6), joints, size), hum=hum)
    return tables, changed, _said("ripple", joints, size) | {"hum": hum}


def rubbing(rng: np.random.Generator, tables: ArmTables) -> ArmTables:
    """Every friction number as far from what is known as load, warmth and age bring it."""
    off = 1 + rng.uniform(-_FRICTION, _FRICTION, (2, tables.n))
    return tables._replace(viscous=off[0] * tables.viscous, coulomb=off[1] * tables.coulomb)


DRAWS: dict[str, Callable[[np.random.Generator, ArmTables, Effects], Change]] = {
    "torque_bias": _torque_bias,
    "torque_gain": _torque_gain,
    "viscous_friction": _viscous,
    "coulomb_friction": _coulomb,
    "velocity_disturbance": _memory,
    "payload": _payload,
    "gravity_direction": _gravity,
    "home_offset": _home,
    "linear_spring": _spring,
    "gravity_counterbalance": _counterbalance,
    "ripple": _ripple,
}
