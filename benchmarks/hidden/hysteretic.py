"""A mass on a spring and damper, and on an element with hysteresis (Bouc and Wen) that its owner does not know:
800 + 800 samples, every 0.05 s.

    m dv/dt = v_in - c v - k q - alpha z - m (k3 q³ + drag |v| v),   dq/dt = v
    dz/dt   = v - beta |v| |z|^(n-1) z - gamma v |z|^n,   |z| < (beta + gamma)^(-1/n) = z_top

Force in N, position and z in m. m, c and k within 15 % of the nominal ones. beta >= |gamma|, so that the element loses
energy. As in a Duffing oscillator a constant at the force is one at the reading, and gains are taken up by m, c and k.
Source of the element: Ikhouane, Rodellar, Systems with Hysteresis, 2007.
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

CATALOGUE = Catalogue(
    acts_on={
        "hysteresis": "friction",
        "cubic_spring": "spring",
        "quadratic_drag": "friction",
        "input_offset": "constant",
        "input_saturation": "input",
        "input_delay": "delay",
        "sensor_saturation": "sensor",
    },
    noises=(0.002, 0.005, 0.01),
    identical={"input_offset": ("constant_force", "sensor_offset")},
    family={"hysteresis": ("coulomb_friction", "stribeck_friction", "linear_spring", "backlash")},
)
NOMINAL = {"m": 1.0, "c": 0.4, "k": 4.0}  # kg, N s/m, N/m
_DT = 0.05  # s


def hysteretic(m: float, c: float, k: float) -> Physics:
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        q, v = x
        return jnp.stack([v, (u[0] - p["c"] * v - p["k"] * q) / p["m"]])

    return continuous(
        "isolator",
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
    q, v, z = x
    own = (u - n["c"] * v - n["k"] * q - n.get("alpha", 0.0) * z) / n["m"]
    bent = n.get("beta", 0.0) * np.abs(v) * np.sign(z) + n.get("gamma", 0.0) * v
    dz = v - bent * np.abs(z) ** n.get("n", 1.0)
    return np.stack([v, own - n.get("cubic", 0.0) * q**3 - n.get("drag", 0.0) * np.abs(v) * v, dz])


def _draw(name: str, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "hysteresis": lambda: _element(rng),
        "cubic_spring": lambda: {"cubic": uniform(rng, 1.0, 4.0) if rng.random() < 0.6 else -uniform(rng, 0.75, 0.95)},
        "quadratic_drag": lambda: {"drag": uniform(rng, 0.25, 0.8)},
        "input_offset": lambda: {"u_offset": either_sign(rng, 0.3, 1.0)},
        "input_saturation": lambda: {"u_top": Quantile(uniform(rng, 0.70, 0.88), "input")},
        "input_delay": lambda: {"delay": round(uniform(rng, 1.4, 3.5) * bench.SUB_STEPS) / bench.SUB_STEPS},
        "sensor_saturation": lambda: {"y_top": Quantile(uniform(rng, 0.75, 0.92), "reading")},
    }[name]()


def _element(rng: np.random.Generator) -> dict[str, float]:
    """Of force alpha z_top in N; the share of beta in beta + gamma is what bends unloading."""
    n, top, force, share = (
        uniform(rng, 1.0, 2.0),
        uniform(rng, 0.08, 0.3),
        uniform(rng, 0.4, 1.2),
        uniform(rng, 0.5, 0.8),
    )
    return {"alpha": force / top, "beta": share * top**-n, "gamma": (1 - share) * top**-n, "n": n}


def _shape(rng: np.random.Generator, n: int) -> Wave:
    return standard(low_pass(random_steps(rng, n, 5, 30), 4.0))


PLANT = bench.driven_body(
    "hysteretic",
    CATALOGUE,
    NOMINAL,
    _slope,
    draw=_draw,
    shape=_shape,
    start=lambda rng: [*rng.normal(0, [0.2, 0.3]).tolist(), 0.0],
    dt=_DT,
    samples=800,
    size=1.0,
    reach=1.2,
)
build = partial(bench.build, PLANT)
