"""From the equations of a plant to a case: inputs, thresholds where the signals are, noise, records.

    v = clip(dead(play(z) + u_offset), -u_top, u_top) + hum sin(2π (t / period + φ)),   z: u late by `delay`, with a lag
    y = clip(z + y_bend z² / y_span + y_offset + e, -y_top, y_top),   z: y_gain measured, one offset per output

dead(v) = sign(v) max(|v| - u_dead, 0), play(z)_t = min(max(play(z)_{t-1}, z_t - u_play), z_t + u_play). A plant is
integrated by Runge-Kutta 4 in SUB_STEPS steps per sample; dry friction is the exact solution under the force of each of
them.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Channel, RecordInfo

from .case import Case, Catalogue, measured, rms, streams
from .draws import SUB_STEPS, Draw, resolved
from .noise import errors
from .signals import Wave, command

HISTORY = 8  # samples before a record starts: what a delayed actuator still has to run
_TRIES = 6
Numbers = Mapping[str, Any]
Slope = Callable[[Numbers, np.ndarray, np.ndarray], np.ndarray]


class Plant(NamedTuple):
    """physics: the base physics by its nominal numbers, which says what it reads and measures, and how often.

    spread: of the true numbers about the nominal ones. slope(numbers, x, v): dx/dt, of states `[x, record]` and inputs
    `[record]`; states after those of the base physics belong to an effect. draws: sizes of an effect by its name.
    shape: an input as a wave of deviation 1; size, mean: its deviation and mean. reach: 99.9 % of the first output's
    readings lie within, on average over both records. measured: which states are; speed: which state dry friction
    slows, if there is any; the state before it is its position. lowest: that a state can have."""

    name: str
    physics: Callable[..., Physics]
    nominal: Numbers
    catalogue: Catalogue
    slope: Slope
    draws: Mapping[str, Draw]
    shape: Callable[[np.random.Generator, int], Wave]
    start: Callable[[np.random.Generator], list[float]]
    samples: int
    size: float
    mean: float = 0.0
    spread: float = 0.15
    reach: float = np.inf
    measured: tuple[int, ...] = (0,)
    speed: int | None = None
    lowest: float = -np.inf


def build(
    plant: Plant,
    seed: int,
    truth: tuple[str, ...] = (),
    *,
    noise: float | None = None,
    noise_kind: str = "white",
    removed: tuple[str, ...] = (),
) -> Case:
    """noise: None for the middle of the plant's levels. Raises `ValueError` for an unknown effect."""
    plant.catalogue.check(truth)
    noise = plant.catalogue.noises[1] if noise is None else noise
    rng = streams(plant.name, seed, "plant effects input start noise process")
    own = {k: v * (1 + rng["plant"].uniform(-plant.spread, plant.spread)) for k, v in plant.nominal.items()}
    draw = {k: v for name in truth for k, v in plant.draws[name](rng["effects"]).items()}
    shapes = [plant.shape(rng["input"], plant.samples + HISTORY) for _ in range(2)]
    start = np.array([plant.start(rng["start"]) for _ in range(2)]).T
    u, sizes = _excited(plant, own, draw, shapes, start)
    truly, none = {**own, **sizes}, np.zeros((2, plant.samples))
    w = _disturbance(plant, truly, u, start, noise, rng["process"]) if noise_kind == "process" else none
    still = simulate(plant, truly, u, start, none)
    clean, states = reading(plant, truly, still), simulate(plant, truly, u, start, w) if w.any() else still
    at = reading(plant, truly, states)
    e = [errors(rng["noise"], noise_kind, noise, one) for record in at for one in record.T]
    noisy = reading(plant, truly, states, np.reshape(e, (2, len(plant.measured), -1)).swapaxes(1, 2))
    known = plant.physics(**plant.nominal)
    inputs, outputs = (tuple(Channel(s.name, s.unit) for s in signals) for signals in (known.inputs, known.outputs))
    info = RecordInfo(inputs, outputs, known.dt, "simulated", f"{plant.name}, {seed}")
    train, test = (measured(a[HISTORY:, None], b, info) for a, b in zip(u, noisy, strict=True))
    without = reading(plant, own, simulate(plant, own, u, start, none, 2)) if truth else clean
    return Case(
        system=plant.name,
        seed=seed,
        truth=truth,
        accepted=plant.catalogue.accepted(truth),
        removed=removed,
        magnitudes={**sizes, "parameters": own, "start": start.T.tolist()},
        noise=noise,
        physics=dict(plant.nominal),
        train=train,
        test=test,
        floor=rms(noisy[1] - clean[1]),
        change=rms(clean[1] - without[1]),
        noise_kind=noise_kind,
    )


def _excited(
    plant: Plant, own: Numbers, draw: dict[str, Any], shapes: list[Wave], start: np.ndarray
) -> tuple[np.ndarray, dict[str, Any]]:
    """Inputs `[record, time]` whose size takes the plant to its reach, and the sizes of the effects."""
    size, sizes, u, none = plant.size, {}, np.array(shapes), np.zeros((2, plant.samples))
    free = none
    for _ in range(_TRIES):
        u = plant.mean + size * np.array(shapes)
        sizes = resolved(draw, {"input": np.abs(u)})
        with np.errstate(over="ignore", invalid="ignore"):  # a softer spring can let go
            free = reading(plant, {**own, **sizes}, simulate(plant, {**own, **sizes}, u, start, none, 2))
        if plant.reach == np.inf:
            break
        reached = np.nan_to_num(np.quantile(np.abs(free[..., 0]), 0.999), nan=np.inf)
        size *= float(np.clip(plant.reach / max(reached, 1e-9), 0.6, 1.4))
    sizes = resolved(draw, {"input": np.abs(u), "reading": np.abs(free)})
    return u, sizes


def _disturbance(
    plant: Plant, numbers: Numbers, u: np.ndarray, start: np.ndarray, deviation: float, rng: np.random.Generator
) -> np.ndarray:
    """White, held over a sample, at the input, of such a size that the readings depart by `deviation`."""
    w, none = rng.standard_normal((2, plant.samples)), np.zeros((2, plant.samples))
    still = simulate(plant, numbers, u, start, none, 2)
    size = 1e-2 * plant.size
    for _ in range(3):
        moved = simulate(plant, numbers, u, start, size * w, 2)
        size *= deviation / max(rms(reading(plant, numbers, moved) - reading(plant, numbers, still)), 1e-12)
    return size * w


def simulate(
    plant: Plant, numbers: Numbers, u: np.ndarray, start: np.ndarray, w: np.ndarray, sub_steps: int = SUB_STEPS
) -> np.ndarray:
    """States `[record, time, x]` after each sample of records that start HISTORY samples after u does."""
    h, dry = plant.physics(**plant.nominal).dt / sub_steps, numbers.get("dry", 0.0)
    late = [command(one, SUB_STEPS, numbers.get("delay", 0.0), numbers.get("lag", 0.0), 0) for one in u]
    moved = _played(np.array(late), numbers.get("u_play", 0.0))[:, HISTORY * SUB_STEPS :]
    v = moved.reshape(2, -1, SUB_STEPS).reshape(2, -1, sub_steps, SUB_STEPS // sub_steps).mean(-1)
    v = _acting(numbers, v) + w[..., None] + _humming(numbers, v.shape)
    x, found = start, np.empty((2, plant.samples, len(start)))
    for t in range(plant.samples):
        for one in v[:, t].T:
            a = plant.slope(numbers, x, one)
            b = plant.slope(numbers, x + h / 2 * a, one)
            c = plant.slope(numbers, x + h / 2 * b, one)
            d = plant.slope(numbers, x + h * c, one)
            before, x = x, np.maximum(x + h / 6 * (a + 2 * (b + c) + d), plant.lowest)
            if dry and plant.speed is not None:
                speed, way = _rubbed(before[plant.speed], x[plant.speed], h, dry)
                x[plant.speed], x[plant.speed - 1] = speed, x[plant.speed - 1] + way
        found[:, t] = x.T
    return found


def _rubbed(v0: Wave, free: Wave, h: float, dry: float) -> tuple[Wave, Wave]:
    """Speed after h seconds with dry friction, and by how much the position changes more, under the otherwise constant
    force that takes v0 to `free` without friction: it stops at τ, and stays or turns around."""
    force = (free - v0) / h
    sign = np.where(v0 != 0.0, np.sign(v0), np.sign(force))
    slows = np.maximum(dry - sign * force, 1e-300)
    stop = np.where(sign * force < dry, np.minimum(np.abs(v0) / slows, h), h)
    rest, turns = h - stop, np.abs(force) > dry
    held = stop < h
    v = np.where(held, np.where(turns, (force + sign * dry) * rest, 0.0), free - sign * dry * h)
    still = -sign * dry * stop * rest - np.where(turns, -sign * dry, force) * rest**2 / 2
    return v, -sign * dry * stop**2 / 2 + np.where(held, still, 0.0)


def _played(u: np.ndarray, half_width: float) -> np.ndarray:
    """What a link with play passes on of u `[record, time]`; it begins in the middle of its play."""
    if not half_width:
        return u
    z = u.copy()
    for t in range(1, u.shape[1]):
        z[:, t] = np.clip(z[:, t - 1], u[:, t] - half_width, u[:, t] + half_width)
    return z


def _acting(numbers: Numbers, u: np.ndarray) -> np.ndarray:
    v = u + numbers.get("u_offset", 0.0)
    v = np.sign(v) * np.maximum(np.abs(v) - numbers.get("u_dead", 0.0), 0.0)
    top = numbers.get("u_top", np.inf)
    return np.clip(v, -top, top)


def _humming(numbers: Numbers, shape: tuple[int, ...]) -> np.ndarray | float:
    """Of both records `[record, time, sub step]`, each with a phase of its own, at the middle of every sub step."""
    if "hum" not in numbers:
        return 0.0
    _, time, sub_steps = shape
    t = np.arange(time)[:, None] + (np.arange(sub_steps) + 0.5) / sub_steps
    turns = t / numbers["period"] + np.array(numbers["phases"])[:, None, None]
    return numbers["hum"] * np.sin(2 * np.pi * turns)


def reading(plant: Plant, numbers: Numbers, states: np.ndarray, e: np.ndarray | float = 0.0) -> np.ndarray:
    """`[record, time, y]`; the range of a sensor ends after its noise."""
    top = numbers.get("y_top", np.inf)
    z = numbers.get("y_gain", 1.0) * states[..., list(plant.measured)]
    curved = z + numbers.get("y_bend", 0.0) * z**2 / numbers.get("y_span", 1.0)
    return np.clip(curved + numbers.get("y_offset", 0.0) + e, -top, top)
