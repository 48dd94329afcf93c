"""A mass on a spring and damper, and on an element with hysteresis (Bouc and Wen) that its owner does not know:
800 + 800 samples, every 0.05 s.

    m dv/dt = v_in - c v - k q - alpha z - m (k3 q³ + drag |v| v),   dq/dt = v
    dz/dt   = v - beta |v| |z|^(n-1) z - gamma v |z|^n,   |z| < (beta + gamma)^(-1/n) = z_top

Force in N, position and z in m. m, c and k within 15 % of the nominal ones. beta >= |gamma|, so that the element loses
energy. As in a Duffing oscillator a constant at the force is one at the reading, and gains are taken up by m, c and k.
Source of the element: Ikhouane, Rodellar, Systems with Hysteresis, 2007.
"""

from functools import partial

import numpy as np

from . import bench, duffing
from .bench import Numbers, Plant
from .case import Catalogue
from .draws import COMMON, Draw, either_sign, uniform

CATALOGUE = Catalogue(
    acts_on={
        "hysteresis": "friction",
        "cubic_spring": "spring",
        "quadratic_drag": "friction",
        "input_offset": "constant",
        "input_saturation": "input",
        "input_delay": "delay",
        "sensor_saturation": "sensor",
        "periodic_disturbance": "disturbance",
    },
    noises=(0.002, 0.005, 0.01),
    identical={"input_offset": ("constant_force", "sensor_offset")},
    family={
        "periodic_disturbance": ("periodic_sensor_error",),
        "sensor_saturation": ("sensor_nonlinearity",),
        "hysteresis": ("coulomb_friction", "stribeck_friction", "linear_spring", "backlash"),
    },
)


def _slope(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    v, z = x[1:]
    bent = n.get("beta", 0.0) * np.abs(v) * np.sign(z) + n.get("gamma", 0.0) * v
    dz = v - bent * np.abs(z) ** n.get("n", 1.0)
    return np.stack([*duffing.slope(n, x[:2], u - n.get("alpha", 0.0) * z), dz])


def _element(rng: np.random.Generator) -> dict[str, float]:
    """Of force alpha z_top in N; the share of beta in beta + gamma is what bends unloading."""
    n, top, force, share = (
        uniform(rng, 1.0, 2.0),
        uniform(rng, 0.08, 0.3),
        uniform(rng, 0.4, 1.2),
        uniform(rng, 0.5, 0.8),
    )
    return {"alpha": force / top, "beta": share * top**-n, "gamma": (1 - share) * top**-n, "n": n}


_DRAWS: dict[str, Draw] = COMMON | {
    "hysteresis": _element,
    "cubic_spring": lambda rng: {"cubic": uniform(rng, 1.0, 4.0) if rng.random() < 0.6 else -uniform(rng, 0.75, 0.95)},
    "quadratic_drag": lambda rng: {"drag": uniform(rng, 0.25, 0.8)},
    "input_offset": lambda rng: {"u_offset": either_sign(rng, 0.3, 1.0)},
}

PLANT = Plant(
    "hysteretic",
    duffing.duffing,
    duffing.NOMINAL,
    CATALOGUE,
    _slope,
    _DRAWS,
    duffing.shape,
    start=lambda rng: [*rng.normal(0, [0.2, 0.3]).tolist(), 0.0],
    samples=800,
    size=1.0,
    reach=1.2,
)
build = partial(bench.build, PLANT)
