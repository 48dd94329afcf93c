"""A stirred tank in which A reacts to B and heats it, with hidden effects: 900 + 900 samples, every 6 s.

    dc/dt = F (c_in - c) - r,   dT/dt = F (T_in - T) + b r + h (v_in - T),   r = k c exp(-E (1/T - 1/T_ref))

c in mol/l, temperatures in K; the coolant's is the input, that of the tank is measured. k, E and h within 10 % of the
nominal ones; the flow F, the feed and the heat of reaction b are known. A side reaction or a feed of another strength
would be another k. Source of the numbers: Seborg, Edgar, Mellichamp, Process Dynamics and Control, example 2.5, but for
half as much cooling surface again and a colder coolant, with which the reaction cannot ignite.
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

# at temperatures that vary by 1 or 2 %, all of these are a constant, but for a tenth of the noise
_CONSTANT = ("inflow", "input_dead_zone", "input_gain", "sensor_gain", "leak", "power_law")
CATALOGUE = Catalogue(
    acts_on={
        "input_offset": "constant",
        "sensor_offset": "constant",
        "input_saturation": "input",
        "input_delay": "delay",
        "input_lag": "delay",
        "sensor_saturation": "sensor",
    },
    noises=(0.01, 0.02, 0.05),
    identical={"input_offset": ("sensor_offset", *_CONSTANT), "sensor_offset": ("input_offset", *_CONSTANT)},
    family={"sensor_saturation": ("sensor_nonlinearity",)},
)
_MINUTE = 60.0  # s
_FLOW = 1.0 / _MINUTE  # 1/s, 100 l/min through 100 l
_FEED, _FEED_TEMPERATURE = 1.0, 350.0  # mol/l, K
_HEAT = 5e4 / 239.0  # K l/mol: 5e4 J/mol over density times heat capacity, 239 J/(l K)
_REFERENCE = 320.0  # K
NOMINAL = {
    "k": 7.2e10 * float(np.exp(-8750.0 / _REFERENCE)) / _MINUTE,  # 1/s at the reference, 7.2e10 per minute at E = 0
    "E": 8750.0,  # K, activation energy over the gas constant
    "h": 7.5e4 / 100.0 / 239.0 / _MINUTE,  # 1/s: 7.5e4 J/(min K) on 100 l
}
_DT = 6.0  # s


def reactor(k: float, E: float, h: float) -> Physics:  # noqa: N803 - the symbols of the field
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        c, t = x
        rate = p["k"] * c * jnp.exp(-p["E"] * (1 / t - 1 / _REFERENCE))
        heat = _FLOW * (_FEED_TEMPERATURE - t) + _HEAT * rate + p["h"] * (u[0] - t)
        return jnp.stack([_FLOW * (_FEED - c) - rate, heat])

    return continuous(
        "reactor",
        derivative,
        lambda p, x, u: x[1:],
        {"k": k, "E": E, "h": h},
        parameters={
            "k": Parameter("k", "1/s", bounds=(1e-5, 0.1)),
            "E": Parameter("E/R", "K", bounds=(1000.0, 30000.0)),
            "h": Parameter("h", "1/s", bounds=(0.001, 1.0)),
        },
        states=(Signal("concentration", "mol/l"), Signal("temperature", "K", like="temperature")),
        inputs=(Signal("coolant", "K"),),
        outputs=(Signal("temperature", "K"),),
        dt=_DT,
    )


def _slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    c, t = x
    rate = n["k"] * c * np.exp(-n["E"] * (1 / t - 1 / _REFERENCE))
    heat = _FLOW * (_FEED_TEMPERATURE - t) + _HEAT * rate + n["h"] * (u - t)
    return np.stack([_FLOW * (_FEED - c) - rate, heat])


_DRAWS: dict[str, Draw] = COMMON | {
    "input_offset": lambda rng: {"u_offset": either_sign(rng, 2.5, 3.0)},
    "sensor_offset": lambda rng: {"y_offset": either_sign(rng, 2.5, 3.0)},
    "input_lag": lambda rng: {"lag": uniform(rng, 2.0, 8.0)},
}


def _shape(rng: np.random.Generator, n: int) -> Wave:
    """Between -2 and 2, so that the reaction does not ignite."""
    return np.clip(smooth_steps(rng, n, 8, 40, 3.0), -2.0, 2.0)


PLANT = Plant(
    "reactor",
    reactor,
    NOMINAL,
    CATALOGUE,
    _slope,
    _DRAWS,
    _shape,
    start=lambda rng: [float(rng.uniform(0.85, 0.95)), float(rng.uniform(315.0, 322.0))],
    samples=900,
    size=4.0,
    mean=297.0,
    spread=0.10,
    measured=(1,),
    lowest=0.0,
)
build = partial(bench.build, PLANT)
