"""A linear system of second order with hidden effects: 1500 + 1500 samples (`linear_plant` below).

    v_t = sat(u_t + u_offset)                                   what acts on the system
    x_t = A x_{t-1} + B v_t - c |x_{t-1}| x_{t-1} e_1 + w_t,    A = [0.7 0.8; 0 0.1],  B = [-1; 0.1]
    y_t = C x_t + D v_t + y_offset + e_t,                       C = [1 0]

No units. The nominal physics is the published imperfect Model 1, or the true matrices with every entry off by up to
15 %. w: process noise, none unless asked for. Source of the matrices: Li, Seth, Kok, IFAC 2026, section 4.1.
"""

from math import inf
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.records.record import Channel, RecordInfo

from .case import Case, Catalogue, measured, rms, streams
from .draws import Quantile, either_sign, resolved, uniform
from .noise import errors
from .signals import low_pass, random_steps, standard

CATALOGUE = Catalogue(
    acts_on={
        "input_saturation": "input",
        "input_offset": "offset",
        "sensor_offset": "offset",
        "feedthrough": "output",
        "quadratic_damping": "state",
    },
    noises=(0.05, 0.1, 0.3),
    # with a free initial state a constant at the input is a constant at the output, seen through the gain at rest
    identical={"input_offset": ("sensor_offset",), "sensor_offset": ("input_offset",)},
    recalibrated=("feedthrough",),  # beside a fast pole: with A, B and C all free it is that pole moved to zero
)
SAMPLES = 1500
TRUE = {"A": [[0.7, 0.8], [0.0, 0.1]], "B": [[-1.0], [0.1]], "C": [[1.0, 0.0]]}
MODEL_1 = {"A": [[0.6, 0.7], [-0.1, 0.0]], "B": [[-1.1], [0.0]], "C": [[0.9, -0.1]]}
# beside it a constant at input and output is not the same; beside a saturation, whose two ends are free, it still is
_NONLINEAR = {"quadratic_damping"}
_SPREAD = 0.15
_LARGEST = 2.0


class Plant(NamedTuple):
    """Neutral: the linear system alone. damping: c, of the first state."""

    u_top: float = inf
    u_offset: float = 0.0
    y_offset: float = 0.0
    feedthrough: float = 0.0
    damping: float = 0.0


def linear_plant(
    plant: Plant, u: Float[np.ndarray, " time"], start: Float[np.ndarray, "2"], w: Float[np.ndarray, "time 2"]
) -> Float[np.ndarray, " time"]:
    """Noise-free readings after each sample."""
    a, b, c = (np.array(TRUE[name]) for name in "ABC")
    acting = np.clip(u + plant.u_offset, -plant.u_top, plant.u_top)
    pushes = acting[:, None] * b[:, 0] + w
    x, y = np.array(start), np.empty_like(u)
    for t, push in enumerate(pushes):
        loss = plant.damping * abs(x[0]) * x[0]
        x = a @ x + push
        x[0] -= loss
        y[t] = c[0] @ x
    return y + plant.feedthrough * acting + plant.y_offset


def build(
    seed: int,
    truth: tuple[str, ...] = (),
    *,
    noise: float = 0.1,
    noise_kind: str = "white",
    removed: tuple[str, ...] = (),
    process_noise: float = 0.0,
) -> Case:
    """process_noise: standard deviation of w, that of the noise where its kind is process.

    Raises `ValueError` for an unknown effect."""
    CATALOGUE.check(truth)
    process_noise = noise if noise_kind == "process" else process_noise
    rng = streams("lgssm", seed, "nominal effects input start noise process")
    draw = {k: v for name in truth for k, v in _draw(name, rng["effects"]).items()}
    inputs = [_input(rng["input"]) for _ in range(2)]
    starts = [rng["start"].normal(0, [1.0, 0.1]) for _ in range(2)]
    still = np.zeros((SAMPLES, 2))
    free = np.concatenate([linear_plant(Plant(), u, s, still) for u, s in zip(inputs, starts, strict=True)])
    sizes = resolved(draw, {"size": np.abs(np.concatenate(inputs)), "state": np.abs(free)})
    if "damping" in sizes:  # c takes this share of the state at the 95 % quantile of its size
        sizes["damping"] /= float(np.quantile(np.abs(free), 0.95))
    plant = Plant(**sizes)
    pushes = [process_noise * rng["process"].standard_normal((SAMPLES, 2)) for _ in range(2)]
    clean = [linear_plant(plant, u, s, still) for u, s in zip(inputs, starts, strict=True)]
    moved = [linear_plant(plant, u, s, w) for u, s, w in zip(inputs, starts, pushes, strict=True)]
    noisy = [y + errors(rng["noise"], noise_kind, noise, y) for y in moved]
    info = RecordInfo((Channel("u"),), (Channel("y"),), 1.0, "simulated", f"linear system, {seed}")
    train, test = (measured(u[:, None], y[:, None], info) for u, y in zip(inputs, noisy, strict=True))
    physics = _nominal(rng["nominal"])
    return Case(
        system="lgssm",
        seed=seed,
        truth=truth,
        accepted=tuple((name,) for name in truth) if _NONLINEAR & set(truth) else CATALOGUE.accepted(truth),
        removed=removed,
        magnitudes=sizes | {"parameters": TRUE, "start": [x.tolist() for x in starts], "process_noise": process_noise},
        noise=noise,
        physics=physics,
        train=train,
        test=test,
        floor=rms(noisy[1] - clean[1]),
        change=rms(clean[1] - linear_plant(Plant(), inputs[1], starts[1], still)),
        noise_kind=noise_kind,
    )


def _draw(name: str, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "input_saturation": lambda: {"u_top": Quantile(uniform(rng, 0.70, 0.85), "size")},
        "input_offset": lambda: {"u_offset": either_sign(rng, 0.15, 0.6)},
        "sensor_offset": lambda: {"y_offset": either_sign(rng, 0.4, 1.5)},
        "feedthrough": lambda: {"feedthrough": either_sign(rng, 0.5, 1.5)},
        "quadratic_damping": lambda: {"damping": uniform(rng, 0.1, 0.3)},
    }[name]()


def _input(rng: np.random.Generator) -> Float[np.ndarray, " time"]:
    """Random steps with rounded corners and a little that changes every sample."""
    steps = low_pass(random_steps(rng, SAMPLES, 3, 25), rng.uniform(1.0, 3.0))
    wave = 0.9 * standard(steps) + 0.3 * rng.standard_normal(SAMPLES)
    return np.clip(1.15 * wave, -_LARGEST, _LARGEST)


def _nominal(rng: np.random.Generator) -> dict[str, Any]:
    if rng.random() < 0.5:
        return MODEL_1
    off = {name: np.array(rows) * (1 + rng.uniform(-_SPREAD, _SPREAD, np.shape(rows))) for name, rows in TRUE.items()}
    return {name: rows.tolist() for name, rows in off.items()}
