"""What may be hidden in the tanks, and how large it is drawn.

Every draw gives fields of `Rig`: plain numbers, or thresholds as quantiles of the signals the plant reaches.
An offset of the pump voltage is positive only: a negative one, where the pump stops, is a dead zone.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from .case import Catalogue
from .draws import Quantile, either_sign, uniform
from .rig import REFERENCE_LEVEL, SUB_STEPS, Rig

CATALOGUE = Catalogue(
    acts_on={
        "overflow_1to2": "upper tank",
        "overflow_lost": "upper tank",
        "leak_tank1": "upper tank",
        "tank2_overflow": "lower tank",
        "outlet_exponent": "lower tank",
        "bypass": "inflow",
        "pump_dead_zone": "pump",
        "pump_saturation": "pump",
        "pump_nonlinearity": "pump",
        "input_offset": "pump",
        "input_delay": "delay",
        "input_lag": "delay",
        "sensor_offset": "sensor",
        "sensor_saturation": "sensor",
        "sensor_nonlinearity": "sensor",
    },
    noises=(0.005, 0.02, 0.05),
    identical={"pump_saturation": ("input_saturation",), "pump_dead_zone": ("input_dead_zone",)},
    # overflow_1to2 with share 0 is overflow_lost; the other way round they are kin
    family={
        "overflow_1to2": ("overflow_lost",),
        "overflow_lost": ("overflow_1to2",),
        "sensor_saturation": ("sensor_nonlinearity",),
    },
    clashes=(("tank2_overflow", "sensor_saturation"),),  # what spills at one level never reads above another
)

Draw = Callable[[np.random.Generator, Rig], dict[str, Any]]


def _nonlinearity(rng: np.random.Generator, plant: Rig) -> dict[str, Any]:
    """Of either sign, as a parabola or as a power law that meets the straight line at 3 V."""
    up, parabola = rng.random(2) < 0.5
    bend = uniform(rng, 0.3, 0.8) if up else -uniform(rng, 0.3, 0.6)  # at -0.6 the parabola still rises up to 8 V
    return {"curvature": bend} if parabola else {"power": 1 + 0.6 * bend}


def _outlet_exponent(rng: np.random.Generator, plant: Rig) -> dict[str, Any]:
    """Only where more level means more flow up to 10 V, because k5 works against the outlet."""
    while True:
        g = uniform(rng, 0.3, 0.4) if rng.random() < 0.5 else uniform(rng, 0.62, 0.8)
        if plant.k4 * g * REFERENCE_LEVEL ** (0.5 - g) * 10.0 ** (g - 1) - plant.k5 > 1e-3:
            return {"exponent": g}


def _leak(rng: np.random.Generator, plant: Rig) -> dict[str, Any]:
    """A share of the drain's linearised rate k1 / (2 √x1) at 4 V."""
    return {"leak": uniform(rng, 0.1, 0.4) * plant.k1 / (2 * REFERENCE_LEVEL**0.5)}


def _delay(rng: np.random.Generator, plant: Rig) -> dict[str, Any]:
    return {"delay": round(uniform(rng, 1.4, 3.5) * SUB_STEPS) / SUB_STEPS}


DRAWS: dict[str, Draw] = {
    "overflow_1to2": lambda rng, _: {
        "rim_1": Quantile(uniform(rng, 0.70, 0.92), "upper"),
        "share": uniform(rng, 0.4, 1.0),
    },
    "overflow_lost": lambda rng, _: {"rim_1": Quantile(uniform(rng, 0.70, 0.92), "upper"), "share": 0.0},
    "leak_tank1": _leak,
    "tank2_overflow": lambda rng, _: {"rim_2": Quantile(uniform(rng, 0.70, 0.92), "lower")},
    "outlet_exponent": _outlet_exponent,
    "bypass": lambda rng, _: {"bypass": uniform(rng, 0.1, 0.35)},
    "pump_dead_zone": lambda rng, _: {
        "u_dead": Quantile(uniform(rng, 0.08, 0.25), "voltage", at=uniform(rng, 0.8, 1.8))
    },
    "pump_saturation": lambda rng, _: {"u_top": Quantile(uniform(rng, 0.70, 0.90), "voltage")},
    "pump_nonlinearity": _nonlinearity,
    "input_offset": lambda rng, _: {"u_offset": uniform(rng, 0.3, 1.0)},
    "input_delay": _delay,
    "input_lag": lambda rng, _: {"lag": uniform(rng, 4.0, 12.0)},
    "sensor_offset": lambda rng, _: {"y_offset": either_sign(rng, 0.4, 1.5)},
    "sensor_saturation": lambda rng, _: {"y_top": Quantile(uniform(rng, 0.75, 0.93), "reading")},
    "sensor_nonlinearity": lambda rng, _: {"y_bend": either_sign(rng, 0.25, 0.4)},
}
