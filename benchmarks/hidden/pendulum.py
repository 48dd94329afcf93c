"""A pendulum that a user brings along, with hidden effects: 800 + 800 samples, every 0.05 s.

    angle'' = -g/l sin(angle) - d angle' + clip(dead(z + u_offset)) / l²,   unit mass
    lag z'  = u(t - delay) - z
    y       = clip(angle + y_offset + e)

dead(v) = sign(v) max(|v| - u_dead, 0). Torque in Nm, angle in rad. Limits of torque and reading are the same on both
sides, or the reading's on the upper side only. l within 10 %, d within 15 % of the nominal ones.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.base import Parameter, Physics, Signal, continuous
from pgrssnn_jax.records.record import Channel, RecordInfo

from .case import Case, Catalogue, measured, rms, streams
from .draws import Quantile, either_sign, resolved, uniform
from .noise import errors
from .pendulum_plant import GRAVITY, HISTORY, SAMPLE_TIME, SUB_STEPS, Plant, reading, swing
from .signals import smooth_steps

CATALOGUE = Catalogue(
    acts_on={
        "input_saturation": "input",
        "input_dead_zone": "input",
        "input_offset": "input",
        "input_delay": "delay",
        "input_lag": "delay",
        "sensor_offset": "sensor",
        "sensor_saturation": "sensor",
    },
    noises=(0.002, 0.005, 0.01),
    identical={"input_offset": ("constant_force",)},
    family={"sensor_saturation": ("sensor_nonlinearity",)},
)
SAMPLES = 800
NOMINAL = {"length": 1.0, "damping": 0.3, "dt": SAMPLE_TIME}  # m, 1/s, s
_REACH = 1.2  # rad, what the largest swing is scaled to


def pendulum(length: float = 1.0, damping: float = 0.3, dt: float = SAMPLE_TIME) -> Physics:
    """The base physics: what its owner knows of it."""

    def derivative(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        angle, rate = x
        return jnp.stack([rate, -GRAVITY / p["l"] * jnp.sin(angle) - p["d"] * rate + u[0] / p["l"] ** 2])

    return continuous(
        "pendulum",
        derivative,
        lambda p, x, u: x[:1],
        {"l": length, "d": damping},
        parameters={"l": Parameter("l", "m", bounds=(0.1, 10.0)), "d": Parameter("d", "1/s", bounds=(0.0, 10.0))},
        states=(Signal("angle", "rad", like="angle"), Signal("rate", "rad/s", rate_of="angle")),
        inputs=(Signal("torque", "Nm"),),
        outputs=(Signal("angle", "rad"),),
        dt=dt,
    )


def build(
    seed: int,
    truth: tuple[str, ...] = (),
    *,
    noise: float = 0.005,
    noise_kind: str = "white",
    removed: tuple[str, ...] = (),
) -> Case:
    """Raises `ValueError` for an unknown effect."""
    CATALOGUE.check(truth)
    rng = streams("pendulum", seed, "plant effects input start noise")
    own = Plant(
        length=NOMINAL["length"] * (1 + rng["plant"].uniform(-0.10, 0.10)),
        damping=NOMINAL["damping"] * (1 + rng["plant"].uniform(-0.15, 0.15)),
    )
    draw = {k: v for name in truth for k, v in _draw(name, rng["effects"]).items()}
    both_sides = draw.pop("both_sides", False)
    shapes = [smooth_steps(rng["input"], SAMPLES + HISTORY, 5, 30, 4.0) for _ in range(2)]
    starts = [tuple(rng["start"].normal(0, [0.2, 0.3]).tolist()) for _ in range(2)]
    size, inputs, angles = 2.0, shapes, shapes
    for _ in range(8):
        inputs = [size * shape for shape in shapes]
        plant = own._replace(**resolved(draw, {"torque": np.abs(np.concatenate(inputs))}))
        angles = [swing(plant, u, s) for u, s in zip(inputs, starts, strict=True)]
        size *= float(np.clip(_REACH / np.quantile(np.abs(np.concatenate(angles)), 0.999), 0.6, 1.5))
    both = np.concatenate(angles) + plant.y_offset
    signals = {"torque": np.abs(np.concatenate(inputs)), "reading": both, "reading size": np.abs(both)}
    sizes = resolved(draw, signals)
    if both_sides:
        sizes["y_bottom"] = -sizes["y_top"]
    plant = own._replace(**sizes)
    clean = [reading(plant, a) for a in angles]
    noisy = [reading(plant, a, errors(rng["noise"], noise_kind, noise, y)) for a, y in zip(angles, clean, strict=True)]
    info = RecordInfo(
        (Channel("torque", "Nm"),), (Channel("angle", "rad"),), SAMPLE_TIME, "simulated", f"pendulum, {seed}"
    )
    train, test = (measured(u[HISTORY:, None], y[:, None], info) for u, y in zip(inputs, noisy, strict=True))
    return Case(
        system="pendulum",
        seed=seed,
        truth=truth,
        accepted=CATALOGUE.accepted(truth),
        removed=removed,
        magnitudes=sizes | {"parameters": {"length": own.length, "damping": own.damping}, "start": starts},
        noise=noise,
        physics=dict(NOMINAL),
        train=train,
        test=test,
        floor=rms(noisy[1] - clean[1]),
        change=rms(clean[1] - swing(own, inputs[1], starts[1])),
        noise_kind=noise_kind,
    )


def _draw(name: str, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "input_saturation": lambda: {"u_top": Quantile(uniform(rng, 0.70, 0.88), "torque")},
        "input_dead_zone": lambda: {"u_dead": Quantile(uniform(rng, 0.06, 0.18), "torque")},
        "input_offset": lambda: {"u_offset": either_sign(rng, 0.4, 1.2)},
        "input_delay": lambda: {"delay": round(uniform(rng, 1.4, 3.5) * SUB_STEPS) / SUB_STEPS},
        "input_lag": lambda: {"lag": uniform(rng, 2.0, 8.0)},
        "sensor_offset": lambda: {"y_offset": either_sign(rng, 0.05, 0.3)},
        "sensor_saturation": lambda: _range(rng),
    }[name]()


def _range(rng: np.random.Generator) -> dict[str, Any]:
    both, q = bool(rng.random() < 0.5), uniform(rng, 0.75, 0.92)
    return {"y_top": Quantile(q, "reading size" if both else "reading"), "both_sides": both}
