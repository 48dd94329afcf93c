"""Small records for tests of discovery: tanks simulated in plain NumPy with fine steps, and short settings."""

from typing import Any

import numpy as np

from pgrssnn_jax.discovery.corrected import Corrected
from pgrssnn_jax.discovery.discover import Discovery, discover_in
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, record
from pgrssnn_jax.training.settings import training_settings

PUBLISHED = {"k1": 0.0464, "k2": 0.0003, "k3": 0.0412, "k4": 0.0586, "k5": 0.0039}
TANKS = RecordInfo((Channel("pump_voltage", "V"),), (Channel("level_voltage", "V"),), 4.0, "simulated")
INFINITE = float("inf")


def pump(samples: int, seed: int, low: float = 0.5, high: float = 4.5, hold: int = 12) -> np.ndarray:
    """Steps of the pump voltage, smoothed over a few samples, `[time]`."""
    steps = np.repeat(np.random.default_rng(seed).uniform(low, high, samples // hold + 2), hold)
    return np.convolve(steps, np.ones(4) / 4, "valid")[:samples]


def fine_tanks(
    u: np.ndarray,
    start: tuple[float, float] = (4.0, 4.0),
    *,
    k: dict[str, float] = PUBLISHED,
    rim: Any = INFINITE,
    share: Any = 0.0,
    rim2: Any = INFINITE,
    dead: Any = 0.0,
    most: Any = INFINITE,
    curve: Any = 0.0,
    power: Any = 1.0,
    leak: Any = 0.0,
    bypass: Any = 0.0,
    exponent: Any = 0.5,
    push: np.ndarray | None = None,
    sub: int = 40,
) -> np.ndarray:
    """Levels `[time, 2, case]` by the midpoint rule in `sub` steps per sample; limits act in every one of them.

    Numbers of effects may be arrays over cases; push `[time]`: what dx2/dt gains.
    """
    h = 4.0 / sub
    voltage = np.where(u[:, None] > 0, np.maximum(u[:, None] - dead, 0.0), u[:, None])
    voltage = np.minimum(voltage, most)
    voltage = voltage * (1 + curve * voltage / 10) * (np.abs(voltage) / 3.0) ** (power - 1.0)
    push = np.zeros(len(u)) if push is None else push
    numbers = (voltage[0], rim, share, rim2, leak, bypass, exponent)
    x1, x2 = (np.full(np.broadcast_shapes(*map(np.shape, numbers)), s) for s in start)
    out = []

    def rate(x1, x2, v, d):
        x1, x2 = np.maximum(x1, 0.0), np.maximum(x2, 0.0)
        q = k["k1"] * np.sqrt(x1) - k["k2"] * x1
        inflow = k["k3"] * v
        return (1 - bypass) * inflow - q - leak * x1, bypass * inflow + q - k["k4"] * x2**exponent + k["k5"] * x2 + d

    for v, d in zip(voltage, push, strict=True):
        for _ in range(sub):
            a1, a2 = rate(x1, x2, v, d)
            b1, b2 = rate(x1 + 0.5 * h * a1, x2 + 0.5 * h * a2, v, d)
            x1, x2 = x1 + h * b1, x2 + h * b2
            spilled = np.maximum(x1 - rim, 0.0)
            x1, x2 = x1 - spilled, np.minimum(x2 + share * spilled, rim2)
        out.append(np.stack([x1, x2]))
    return np.stack(out)


def tank_record(u: np.ndarray, noise: float = 0.01, seed: int = 0, **numbers: Any) -> Record:
    """The lower level with white noise."""
    y = fine_tanks(u, sub=10, **numbers)[:, 1].reshape(-1, 1)
    return record(u[:, None], y + noise * np.random.default_rng(seed).standard_normal(y.shape), TANKS)


def choices(**changes: Any) -> DiscoverySettings:
    """Settings of a short discovery on whole records."""
    standard = {
        "replace": {}, "fixed": [], "tolerance": 0.5, "stretches": [], "without": [], "starts": 1, "folds": 3,
        "block": 20, "n_init": 30, "steps": 15, "p_value": 0.01, "share": 0.02, "most": 2, "draws": 199, "seed": 0,
        "network_epochs": 0,
    }  # fmt: skip
    return DiscoverySettings(**{**standard, **changes})


def setup_of(
    problem: Problem, train: Record, test: Record, settings: DiscoverySettings, start: Start = Start.SHARED
) -> Setup:
    """As `set_up` makes it, of records that are one realisation and settings that need no choice."""
    physics, training = problem.physics, training_settings(ModelSpec())
    return Setup(physics, physics, problem.effects, train, train, train, test, start, settings, training)


def discovered(
    problem: Problem,
    train: Record,
    test: Record,
    settings: DiscoverySettings,
    start: Start = Start.SHARED,
    corrected: Corrected | None = None,
) -> Discovery:
    return discover_in(problem, setup_of(problem, train, test, settings, start), lambda line: None, corrected)
