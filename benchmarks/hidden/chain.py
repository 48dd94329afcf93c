"""Five vessels in a row, each draining into the next by a square root, with hidden effects: 900 + 900 samples of 2 s.

    dx_i/dt = r_{i-1} √x_{i-1} - r_i √x_i - leak_i x_i + inflow_i,   the first is filled by v

Levels 3 and 5 in m are measured, the inflow is in m/s. r_i within 12 % of the nominal ones. An offset of the
inflow is an inflow of the first vessel, and a dead zone where it is negative.
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
        "leak": "vessel",
        "inflow": "vessel",
        "input_offset": "input",
        "input_saturation": "input",
        "input_delay": "delay",
        "sensor_offset": "sensor",
        "sensor_saturation": "sensor",
    },
    noises=(0.003, 0.01, 0.02),
    identical={"input_offset": ("inflow", "input_dead_zone")},  # the inflow is positive all the time
    family={"leak": ("power_law",), "sensor_saturation": ("sensor_nonlinearity",)},
)
RATES = ("r1", "r2", "r3", "r4", "r5")
NOMINAL: dict[str, float] = dict(zip(RATES, (0.10, 0.09, 0.11, 0.10, 0.09), strict=True))  # sqrt(m)/s
_DT = 2.0
_LEVELS = tuple(f"level_{i + 1}" for i in range(5))


def chain(**rates: float) -> Physics:
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        wet = x > 0.0
        root = jnp.where(wet, jnp.sqrt(jnp.where(wet, x, 1.0)), 0.0)
        out = jnp.stack([p[name] for name in RATES]) * root
        return jnp.concatenate([u, out[:-1]]) - out

    return continuous(
        "vessels",
        derivative,
        lambda p, x, u: jnp.stack([x[2], x[4]]),
        dict(rates),
        parameters={name: Parameter(name, "sqrt(m)/s", bounds=(0.0, 1.0)) for name in RATES},
        states=tuple(Signal(name, "m", like=name if name in ("level_3", "level_5") else "level_3") for name in _LEVELS),
        inputs=(Signal("inflow", "m/s"),),
        outputs=(Signal("level_3", "m"), Signal("level_5", "m")),
        dt=_DT,
    )


def _slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    level = np.maximum(x, 0.0)
    out = np.array([n[name] for name in RATES])[:, None] * np.sqrt(level)
    gained = np.reshape(n.get("inflow", np.zeros(5)), (5, 1)) - np.reshape(n.get("leak", np.zeros(5)), (5, 1)) * level
    return np.concatenate([u[None], out[:-1]]) - out + gained


def _at(vessel: int, value: float) -> np.ndarray:
    return value * np.eye(5)[vessel]


_DRAWS: dict[str, Draw] = COMMON | {
    "leak": lambda rng: {"leak": _at(int(rng.choice([1, 3])), uniform(rng, 0.004, 0.015))},
    "inflow": lambda rng: {"inflow": _at(3, either_sign(rng, 0.01, 0.03))},
    "input_offset": lambda rng: {"u_offset": either_sign(rng, 0.01, 0.03)},
    "sensor_offset": lambda rng: {"y_offset": _one_of_two(rng, either_sign(rng, 0.1, 0.4))},
}


def _one_of_two(rng: np.random.Generator, value: float) -> np.ndarray:
    return value * np.eye(2)[int(rng.integers(2))]


def _shape(rng: np.random.Generator, n: int) -> Wave:
    """Between -1.6 and 1.6, so that something always flows."""
    return np.clip(smooth_steps(rng, n, 15, 60, 4.0), -1.6, 1.6)


PLANT = Plant(
    "chain",
    chain,
    NOMINAL,
    CATALOGUE,
    _slope,
    _DRAWS,
    _shape,
    start=lambda rng: rng.uniform(1.5, 3.0, 5).tolist(),
    samples=900,
    size=0.055,
    mean=0.15,
    spread=0.12,
    measured=(2, 4),
    lowest=0.0,
)
build = partial(bench.build, PLANT)
