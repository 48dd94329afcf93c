"""A linear servo axis with hidden effects, of the kind of the EMPS benchmark: 1000 + 1000 samples, every 0.02 s.

    m dv/dt = v_in - f v - m (dry sign(v) + drag |v| v),   dq/dt = v

Force in N, position in m. m and f within 15 % of the nominal ones. The force is what moves an axis without dry friction
along smooth steps. Nothing holds the position, so an offset of its sensor shows as another start, and is not hidden.
Source of the numbers: Janot, Gautier, Brunot, Data set and reference models of EMPS, 2019.
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
from .draws import COMMON, Draw, Quantile, either_sign, humming, uniform
from .signals import Wave, low_pass, random_steps

CATALOGUE = Catalogue(
    acts_on={
        "coulomb_friction": "friction",
        "quadratic_drag": "friction",
        "input_offset": "force",
        "input_saturation": "force",
        "input_dead_zone": "force",
        "input_delay": "delay",
        "periodic_disturbance": "disturbance",
    },
    noises=(0.0005, 0.001, 0.003),
    identical={"input_offset": ("constant_force",)},
    family={"periodic_disturbance": ("periodic_sensor_error",), "coulomb_friction": ("stribeck_friction",)},
)
NOMINAL = {"m": 95.0, "f": 203.0}  # kg, N s/m
_DT = 0.02


def servo(m: float, f: float) -> Physics:
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.stack([x[1], (u[0] - p["f"] * x[1]) / p["m"]])

    return continuous(
        "axis",
        derivative,
        lambda p, x, u: x[:1],
        {"m": m, "f": f},
        parameters={
            "m": Parameter("m", "kg", bounds=(1.0, 1000.0)),
            "f": Parameter("f", "N s/m", bounds=(0.0, 5000.0)),
        },
        states=(Signal("position", "m", like="position"), Signal("speed", "m/s", rate_of="position")),
        inputs=(Signal("force", "N"),),
        outputs=(Signal("position", "m"),),
        dt=_DT,
    )


def _slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    v = x[1]
    return np.stack([v, (u - n["f"] * v) / n["m"] - n.get("drag", 0.0) * np.abs(v) * v])


_DRAWS: dict[str, Draw] = COMMON | {
    "coulomb_friction": lambda rng: {"dry": uniform(rng, 0.1, 0.3)},
    "quadratic_drag": lambda rng: {"drag": uniform(rng, 1.5, 6.0)},
    "input_offset": lambda rng: {"u_offset": either_sign(rng, 4.0, 15.0)},
    "input_saturation": lambda rng: {"u_top": Quantile(uniform(rng, 0.75, 0.90), "input")},
    "input_dead_zone": lambda rng: {"u_dead": uniform(rng, 5.0, 20.0)},
    "periodic_disturbance": lambda rng: humming(rng, uniform(rng, 20.0, 50.0)),
}


def _shape(rng: np.random.Generator, n: int) -> Wave:
    """Along r: m d²r/dt² + f dr/dt."""
    r = random_steps(rng, n, 25, 80)
    for _ in range(3):
        r = low_pass(r - r[0], 6.0)
    speed = np.gradient(r, _DT)
    force = NOMINAL["m"] * np.gradient(speed, _DT) + NOMINAL["f"] * speed
    return force / force.std()


PLANT = Plant(
    "servo",
    servo,
    NOMINAL,
    CATALOGUE,
    _slope,
    _DRAWS,
    _shape,
    start=lambda rng: rng.normal(0, [0.05, 0.02]).tolist(),
    samples=1000,
    size=60.0,
    reach=0.25,
    speed=1,
)
build = partial(bench.build, PLANT)
