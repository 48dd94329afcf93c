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
from .bench import Numbers
from .case import Catalogue
from .draws import Quantile, either_sign, uniform
from .signals import Wave, low_pass, random_steps, standard

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
    },
    noises=(0.002, 0.005, 0.01),
    identical={"input_offset": _CONSTANT[1:], "sensor_offset": _CONSTANT[:2]},
    family={"coulomb_friction": ("stribeck_friction",)},
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


def _slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    q, v = x
    own = (u - n["c"] * v - n["k"] * q) / n["m"]
    return np.stack([v, own - n.get("cubic", 0.0) * q**3 - n.get("drag", 0.0) * np.abs(v) * v])


def _draw(name: str, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "cubic_spring": lambda: {"cubic": uniform(rng, 1.0, 4.0) if rng.random() < 0.6 else -uniform(rng, 0.3, 0.7)},
        "quadratic_drag": lambda: {"drag": uniform(rng, 0.2, 0.8)},
        "coulomb_friction": lambda: {"dry": uniform(rng, 0.15, 0.6)},
        "input_offset": lambda: {"u_offset": either_sign(rng, 0.3, 1.0)},
        "sensor_offset": lambda: {"y_offset": either_sign(rng, 0.08, 0.25)},
        "input_saturation": lambda: {"u_top": Quantile(uniform(rng, 0.70, 0.88), "input")},
        "input_delay": lambda: {"delay": round(uniform(rng, 1.4, 3.5) * bench.SUB_STEPS) / bench.SUB_STEPS},
        "sensor_saturation": lambda: {"y_top": Quantile(uniform(rng, 0.75, 0.92), "reading")},
    }[name]()


def _shape(rng: np.random.Generator, n: int) -> Wave:
    return standard(low_pass(random_steps(rng, n, 5, 30), 4.0))


PLANT = bench.driven_body(
    "duffing",
    CATALOGUE,
    NOMINAL,
    _slope,
    draw=_draw,
    shape=_shape,
    start=lambda rng: rng.normal(0, [0.2, 0.3]).tolist(),
    dt=_DT,
    samples=800,
    size=1.5,
    reach=1.2,
)
build = partial(bench.build, PLANT)
