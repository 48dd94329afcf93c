"""A mass on a spring of which its owner knows the linear part, with hidden effects: 800 + 800 samples, every 0.05 s.

    m dv/dt = v_in - c v - k q - m (k3 q³ + drag |v| v + dry sign(v)),   dq/dt = v

Force in N, position in m. m, c and k within 15 % of the nominal ones. With a linear spring a constant at the force is
one at the reading. A gain of sensor or force is none of its own: m, c and k take it up.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.base import Parameter, Physics, Signal, continuous

from . import bench
from .bench import Numbers, Plant
from .case import Catalogue
from .draws import COMMON, Draw, either_sign, uniform
from .signals import Wave, smooth_steps

_CONSTANT = ("input_offset", "constant_force", "sensor_offset")
CATALOGUE = Catalogue(
    acts_on={
        "cubic_spring": "spring",
        "quadratic_drag": "friction",
        "coulomb_friction": "friction",
        "input_offset": "constant",
        "sensor_offset": "constant",
        "input_saturation": "input",
        "input_delay": "delay",
        "sensor_saturation": "sensor",
        "periodic_disturbance": "disturbance",
    },
    noises=(0.002, 0.005, 0.01),
    identical={"input_offset": _CONSTANT[1:], "sensor_offset": _CONSTANT[:2]},
    family={
        "periodic_disturbance": ("periodic_sensor_error",),
        "coulomb_friction": ("stribeck_friction",),
        "sensor_saturation": ("sensor_nonlinearity",),
    },
)
NOMINAL = {"m": 1.0, "c": 0.4, "k": 4.0}  # kg, N s/m, N/m
_DT = 0.05


def duffing(m: float, c: float, k: float) -> Physics:
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        q, v = x
        return jnp.stack([v, (u[0] - p["c"] * v - p["k"] * q) / p["m"]])

    return continuous(
        "oscillator",
        derivative,
        lambda p, x, u: x[:1],
        {"m": m, "c": c, "k": k},
        parameters={
            "m": Parameter("m", "kg", bounds=(0.05, 20.0)),
            "c": Parameter("c", "N s/m", bounds=(0.0, 20.0)),
            "k": Parameter("k", "N/m", bounds=(0.0, 100.0)),
        },
        states=(Signal("position", "m", like="position"), Signal("velocity", "m/s", rate_of="position")),
        inputs=(Signal("force", "N"),),
        outputs=(Signal("position", "m"),),
        dt=_DT,
    )


def slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    q, v = x
    own = (u - n["c"] * v - n["k"] * q) / n["m"]
    return np.stack([v, own - n.get("cubic", 0.0) * q**3 - n.get("drag", 0.0) * np.abs(v) * v])


_DRAWS: dict[str, Draw] = COMMON | {
    "cubic_spring": lambda rng: {"cubic": uniform(rng, 1.0, 4.0) if rng.random() < 0.6 else -uniform(rng, 0.3, 0.7)},
    "quadratic_drag": lambda rng: {"drag": uniform(rng, 0.2, 0.8)},
    "coulomb_friction": lambda rng: {"dry": uniform(rng, 0.15, 0.6)},
    "input_offset": lambda rng: {"u_offset": either_sign(rng, 0.3, 1.0)},
    "sensor_offset": lambda rng: {"y_offset": either_sign(rng, 0.08, 0.25)},
}


def shape(rng: np.random.Generator, n: int) -> Wave:
    return smooth_steps(rng, n, 5, 30, 4.0)


PLANT = Plant(
    "duffing",
    duffing,
    NOMINAL,
    CATALOGUE,
    slope,
    _DRAWS,
    shape,
    start=lambda rng: rng.normal(0, [0.2, 0.3]).tolist(),
    samples=800,
    size=1.5,
    reach=1.2,
    speed=1,
)
build = partial(bench.build, PLANT)
