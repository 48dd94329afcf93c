"""A motor that turns a load through a soft shaft, with hidden effects: 900 + 900 samples, every 0.02 s.

    j1 dw1/dt = v_in - f w1 - s - j1 dry sign(w1),   dq1/dt = w1,   s = k (q1 - q2) + d (w1 - w2)
    j2 dw2/dt = s - j2 drag |w2| w2,                 dq2/dt = w2

Torque in Nm, angles of motor and load in rad. Parameters within 15 % of the nominal ones. The torque is what moves a
stiff drive along smooth steps. Nothing holds the angles: an offset of both readings is another start, and one of the
load's reading alone twists the shaft, as constant forces on motor and load would. A gain of sensors or torque is none
of its own: the parameters take it up. No range of the encoders is
hidden, because nothing keeps both records at the same angles.
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
from .draws import COMMON, Draw, either_sign, humming, uniform
from .signals import Wave, low_pass, random_steps

CATALOGUE = Catalogue(
    acts_on={
        "backlash": "torque",
        "coulomb_friction": "friction",
        "quadratic_drag": "friction",
        "input_dead_zone": "torque",
        "input_offset": "constant",
        "sensor_offset": "constant",
        "input_delay": "delay",
        "periodic_disturbance": "disturbance",
    },
    noises=(0.001, 0.003, 0.01),
    identical={"input_offset": ("constant_force",), "sensor_offset": ("constant_force",)},
    family={
        "periodic_disturbance": ("periodic_sensor_error",),
        "coulomb_friction": ("stribeck_friction", "hysteresis"),
        "backlash": ("hysteresis",),
    },
)
NOMINAL = {"j1": 0.02, "j2": 0.03, "k": 2.0, "d": 0.02, "f": 0.1}  # kg m², kg m², Nm/rad, Nm s/rad, Nm s/rad
_DT = 0.02  # s
_TORQUE = 0.25  # Nm, its standard deviation


def drive(j1: float, j2: float, k: float, d: float, f: float) -> Physics:
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        q1, w1, q2, w2 = x
        shaft = p["k"] * (q1 - q2) + p["d"] * (w1 - w2)
        return jnp.stack([w1, (u[0] - p["f"] * w1 - shaft) / p["j1"], w2, shaft / p["j2"]])

    return continuous(
        "drive",
        derivative,
        lambda p, x, u: jnp.stack([x[0], x[2]]),
        {"j1": j1, "j2": j2, "k": k, "d": d, "f": f},
        parameters={
            "j1": Parameter("J1", "kg m²", bounds=(0.001, 1.0)),
            "j2": Parameter("J2", "kg m²", bounds=(0.001, 1.0)),
            "k": Parameter("k", "Nm/rad", bounds=(0.01, 100.0)),
            "d": Parameter("d", "Nm s/rad", bounds=(0.0, 1.0)),
            "f": Parameter("f", "Nm s/rad", bounds=(0.0, 5.0)),
        },
        states=(
            Signal("motor_angle", "rad", like="motor_angle"),
            Signal("motor_speed", "rad/s", rate_of="motor_angle"),
            Signal("load_angle", "rad", like="load_angle"),
            Signal("load_speed", "rad/s", rate_of="load_angle"),
        ),
        inputs=(Signal("torque", "Nm"),),
        outputs=(Signal("motor_angle", "rad"), Signal("load_angle", "rad")),
        dt=_DT,
    )


def _slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    q1, w1, q2, w2 = x
    shaft = n["k"] * (q1 - q2) + n["d"] * (w1 - w2)
    fan = n.get("drag", 0.0) * np.abs(w2) * w2
    return np.stack([w1, (u - n["f"] * w1 - shaft) / n["j1"], w2, shaft / n["j2"] - fan])


_DRAWS: dict[str, Draw] = COMMON | {
    "periodic_disturbance": lambda rng: humming(rng, uniform(rng, 0.02, 0.06)),
    "backlash": lambda rng: {"u_play": _TORQUE * uniform(rng, 0.05, 0.2)},
    "coulomb_friction": lambda rng: {"dry": uniform(rng, 0.1, 0.4) * _TORQUE / NOMINAL["j1"]},
    "quadratic_drag": lambda rng: {"drag": uniform(rng, 0.3, 1.2)},
    "input_dead_zone": lambda rng: {"u_dead": _TORQUE * uniform(rng, 0.12, 0.4)},
    "input_offset": lambda rng: {"u_offset": _TORQUE * either_sign(rng, 0.02, 0.06)},
    "sensor_offset": lambda rng: {"y_offset": np.array([0.0, either_sign(rng, 0.03, 0.1)])},
}


def _shape(rng: np.random.Generator, n: int) -> Wave:
    """Along r, around 0 and from 0 where the record begins: (j1 + j2) d²r/dt² + f dr/dt."""
    r = random_steps(rng, n, 25, 80)
    r[: bench.HISTORY] = 0.0
    for _ in range(3):
        r = low_pass(r, 4.0)
    speed = np.gradient(r, _DT)
    torque = (NOMINAL["j1"] + NOMINAL["j2"]) * np.gradient(speed, _DT) + NOMINAL["f"] * speed
    return torque / torque.std()


PLANT = Plant(
    "drive",
    drive,
    NOMINAL,
    CATALOGUE,
    _slope,
    _DRAWS,
    _shape,
    start=lambda rng: 2 * rng.normal(0, [0.2, 0.1]).tolist(),  # the shaft is not twisted
    samples=900,
    size=_TORQUE,
    measured=(0, 2),
    speed=1,
)
build = partial(bench.build, PLANT)
