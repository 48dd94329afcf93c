"""A coil, a resistor and a capacitor in series behind an amplifier, with hidden effects: 900 + 900 samples of 2 ms.

    L(i) di/dt = v_in - R i - v,   dv/dt = i / C - leak v,   L(i) = L / (1 + (i / i_top)²)

Voltages in V, current in A; the capacitor's voltage v is measured. L and C within 15 % of the nominal ones; R is known,
because v tells of R, L and C no more than R C and L C. At rest v = v_in, so a gain is none of L and C; a leak of the
capacitor is a gain with other L and C, but few gains are a leak. A constant of v_in, of the reading or of a derivative
are the same. The library has no name for the core of the coil, which saturates by L(i).
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.base import Parameter, Physics, Signal, continuous
from pgrssnn_jax.records.record import Channel

from . import bench
from .bench import Numbers, Plant
from .case import Catalogue
from .draws import Quantile, either_sign, uniform
from .signals import Wave, low_pass, random_steps, standard

CATALOGUE = Catalogue(
    acts_on={
        "input_offset": "constant",
        "sensor_offset": "constant",
        "sensor_gain": "gain",
        "leak": "gain",
        "input_saturation": "amplifier",
        "input_dead_zone": "amplifier",
        "input_delay": "delay",
        "sensor_saturation": "sensor",
        "coil_saturation": "coil",
    },
    noises=(0.01, 0.03, 0.06),
    identical={
        "input_offset": ("sensor_offset", "inflow"),
        "sensor_offset": ("input_offset", "inflow"),
        "sensor_gain": ("input_gain",),
        "leak": ("input_gain", "sensor_gain"),
    },
    family={"leak": ("power_law",)},
    unnamed=("coil_saturation",),
)
NOMINAL = {"L": 0.1, "C": 1e-3}  # H, F
_RESISTANCE = 4.0  # ohm
_DT = 0.002  # s


def circuit(L: float, C: float) -> Physics:  # noqa: N803 - the symbols of the field
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        v, i = x
        return jnp.stack([i / p["C"], (u[0] - _RESISTANCE * i - v) / p["L"]])

    return continuous(
        "circuit",
        derivative,
        lambda p, x, u: x[:1],
        {"L": L, "C": C},
        parameters={
            "L": Parameter("L", "H", bounds=(0.001, 10.0)),
            "C": Parameter("C", "F", bounds=(1e-5, 0.1)),
        },
        states=(Signal("voltage", "V", like="voltage"), Signal("current", "A")),
        inputs=(Signal("source", "V"),),
        outputs=(Signal("voltage", "V"),),
        dt=_DT,
    )


def _slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    v, i = x
    softer = 1 + (i / n.get("i_top", np.inf)) ** 2
    return np.stack([i / n["C"] - n.get("leak", 0.0) * v, (u - _RESISTANCE * i - v) * softer / n["L"]])


def _draw(name: str, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "input_offset": lambda: {"u_offset": either_sign(rng, 0.3, 1.0)},
        "sensor_offset": lambda: {"y_offset": either_sign(rng, 0.3, 1.0)},
        "sensor_gain": lambda: {"y_gain": 1 + either_sign(rng, 0.06, 0.2)},
        "leak": lambda: {"leak": uniform(rng, 15.0, 60.0)},
        "input_saturation": lambda: {"u_top": Quantile(uniform(rng, 0.70, 0.88), "input")},
        "input_dead_zone": lambda: {"u_dead": uniform(rng, 0.2, 0.8)},
        "input_delay": lambda: {"delay": round(uniform(rng, 1.4, 3.5) * bench.SUB_STEPS) / bench.SUB_STEPS},
        "sensor_saturation": lambda: {"y_top": Quantile(uniform(rng, 0.75, 0.92), "reading")},
        "coil_saturation": lambda: {"i_top": uniform(rng, 0.2, 0.4)},
    }[name]()


def _shape(rng: np.random.Generator, n: int) -> Wave:
    return standard(low_pass(random_steps(rng, n, 5, 30), 4.0))


PLANT = Plant(
    "circuit",
    CATALOGUE,
    NOMINAL,
    0.15,
    _slope,
    _draw,
    _shape,
    start=lambda rng: rng.normal(0, [1.0, 0.1]).tolist(),
    inputs=(Channel("source", "V"),),
    outputs=(Channel("voltage", "V"),),
    measured=(0,),
    dt=_DT,
    samples=900,
    size=3.0,
    reach=np.inf,
)
build = partial(bench.build, PLANT)
