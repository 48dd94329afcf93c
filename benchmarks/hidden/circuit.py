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

from . import bench
from .bench import Numbers, Plant
from .case import Catalogue
from .draws import COMMON, Draw, either_sign, uniform
from .signals import Wave, smooth_steps

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
        "sensor_nonlinearity": "sensor",
        "coil_saturation": "coil",
        "periodic_disturbance": "disturbance",
    },
    noises=(0.01, 0.03, 0.06),
    identical={
        "input_offset": ("sensor_offset", "inflow"),
        "sensor_offset": ("input_offset", "inflow"),
        "sensor_gain": ("input_gain",),
        "leak": ("input_gain", "sensor_gain"),
    },
    family={
        "periodic_disturbance": ("periodic_sensor_error",),
        "leak": ("power_law",),
        "sensor_saturation": ("sensor_nonlinearity",),
    },
    # its curve holds them
    clashes=tuple((name, "sensor_nonlinearity") for name in ("input_offset", "sensor_offset", "sensor_gain")),
    unnamed=("coil_saturation",),
)
NOMINAL = {"L": 0.1, "C": 1e-3}  # H, F
_RESISTANCE = 4.0  # ohm
_DT = 0.002  # s
_SPAN = 10.0  # V


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


_DRAWS: dict[str, Draw] = COMMON | {
    "input_offset": lambda rng: {"u_offset": either_sign(rng, 0.3, 1.0)},
    "sensor_offset": lambda rng: {"y_offset": either_sign(rng, 0.3, 1.0)},
    "sensor_gain": lambda rng: {"y_gain": 1 + either_sign(rng, 0.06, 0.2)},
    "sensor_nonlinearity": lambda rng: {"y_bend": either_sign(rng, 0.1, 0.25), "y_span": _SPAN},
    "leak": lambda rng: {"leak": uniform(rng, 15.0, 60.0)},
    "input_dead_zone": lambda rng: {"u_dead": uniform(rng, 0.2, 0.8)},
    "coil_saturation": lambda rng: {"i_top": uniform(rng, 0.2, 0.4)},
}


def _shape(rng: np.random.Generator, n: int) -> Wave:
    return smooth_steps(rng, n, 5, 30, 4.0)


PLANT = Plant(
    "circuit",
    circuit,
    NOMINAL,
    CATALOGUE,
    _slope,
    _DRAWS,
    _shape,
    start=lambda rng: rng.normal(0, [1.0, 0.1]).tolist(),
    samples=900,
    size=3.0,
)
build = partial(bench.build, PLANT)
