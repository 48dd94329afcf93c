"""Numbers for every effect of an arm, and compiled steps of the arm with one of them."""

from functools import cache, partial
from typing import Any

import jax
import numpy as np
from toys import quick_jit

from pgrssnn_jax.effects.arm import arm_effects
from pgrssnn_jax.effects.base import Effect, add
from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics

DT = 0.01  # s, of one Euler step, which shows the acceleration
MASSES = {"payload", "link_mass", "rotor_inertia", "gravity_direction"}
SPEED = np.linspace(0.01, 0.4, 6)
NUMBERS: dict[str, dict[str, Any]] = {
    "torque_gain": {"gain": np.linspace(0.8, 1.2, 6)},
    "wrist_coupling": {"c45": 0.1, "c46": -0.2, "c56": 0.3, "ratio": -0.7, "B": 0.02, "Tc": 0.3},
    "torque_bias": {"theta": np.linspace(-4.0, 5.0, 6)},
    "gravity_counterbalance": {"moment": 300.0, "angle": 0.4},
    "viscous_friction": {"B": np.linspace(0.0, 0.01, 6)},
    "coulomb_friction": {"Tc": np.linspace(0.1, 0.4, 6)},
    "stribeck_friction": {"torque": np.linspace(0.3, 0.1, 6), "speed": 0.2},
    "load_friction": {"mu": np.linspace(0.05, 0.3, 6)},
    "payload": {"mass": 40.0, "distance": 0.3, "x": 0.1, "y": -0.2, "gyration": 0.2},
    "link_mass": {"share": np.linspace(-0.3, 0.5, 6)},
    "rotor_inertia": {"J": np.linspace(1e-3, 2e-3, 6)},
    "gravity_direction": {"about_x": 0.1, "about_y": -0.2},
    "linear_spring": {"k": np.linspace(20.0, 200.0, 6)},
    "asymmetric_friction": {"dTc": np.linspace(-0.2, 0.3, 6), "dB": np.linspace(-0.002, 0.005, 6)},
    "joint_limit": {"lower": np.full(6, -0.4), "upper": np.linspace(0.1, 0.6, 6)},
    "stiction": {"speed": SPEED},
    "velocity_disturbance": {"S": np.linspace(-0.2, 0.2, 6)},
    "home_offset": {"offset": np.linspace(-0.1, 0.1, 6)},
}
NAMES = set(NUMBERS)


def samples(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """States, some beyond the limits, the first at rest at zero; motor torques."""
    draw = np.random.default_rng(seed)
    x, u = draw.uniform(-1.5, 1.5, (count, 12)), 3.0 * draw.normal(size=(count, 6))
    x[0] = 0.0
    return x, u


@cache
def effect(name: str) -> Effect:
    return next(e for e in arm_effects(arm()) if e.name == name)


def changed(name: str, physics: Physics, neutral: bool = False) -> Physics:
    return add(physics, effect(name), numbers=None if neutral else {name: NUMBERS[name]})


@cache
def program(name: str | None, backend: str, euler: bool):
    """The arm, and (its numbers, x, u) `[batch, ...]` with one effect to the next states and their outputs."""
    physics = arm(backend=backend, **({"integrator": "euler", "dt": DT, "limits": False} if euler else {}))
    whole = physics if name is None else changed(name, physics)

    def both(params, x, u):
        new = whole.step(params, x, u)
        return new, whole.measure(params, new, u)

    return physics, quick_jit(jax.vmap(both, (None, 0, 0)))


@cache
def mapped(name: str | None, backend: str = "pinocchio", neutral: bool = False, euler: bool = False):
    """(x, u) `[batch, ...]` to the next states and their outputs. Pinocchio's backend compiles in no time."""
    physics, step = program(name, backend, euler)
    physics = physics if name is None else changed(name, physics, neutral)
    return partial(step, jax.tree.map(np.asarray, physics.params))


def backend_of(name: str) -> str:
    return "jax" if name in MASSES else "pinocchio"
