"""Cascaded tanks with hidden effects: 1024 + 1024 samples, every 4 s (`rig.py` has the equations).

    k_i = published k_i · (1 + N_i),   N_i uniform in ±15 %       nominal physics: the published k_i

The pump voltage is scaled until the lower tank fills and empties between about 1.2 and 9.3 V with the smooth effects in
place; thresholds are then set where the signals are (`tanks_effects.py`).
"""

from typing import Any

import numpy as np

from pgrssnn_jax.records.record import Channel, RecordInfo

from . import tanks_effects
from .case import Case, measured, rms, streams
from .draws import Quantile, resolved
from .noise import errors
from .rig import HISTORY, REFERENCE_LEVEL, SAMPLE_TIME, Rig, Wave, flow, levels, reading
from .signals import multisine, smooth_steps

CATALOGUE = tanks_effects.CATALOGUE
SAMPLES = 1024
PUBLISHED = {name: getattr(Rig(), name) for name in ("k1", "k2", "k3", "k4", "k5")}
_SPREAD = 0.15
_RANGE = (1.2, 9.3)  # V, of the lower tank's reading
_LARGEST = 10.0  # V, of the pump
_ACTIVE = 0.03  # share of each record in which a threshold must have been passed
_BEYOND = 100.0  # V, which no level of a rig within its range comes near
_TRIES = 20
_COARSE = 2  # sub-steps where only the range of a signal counts


def build(
    seed: int,
    truth: tuple[str, ...] = (),
    *,
    noise: float = 0.02,
    noise_kind: str = "white",
    removed: tuple[str, ...] = (),
    spread: float = _SPREAD,
) -> Case:
    """spread: of the true parameters about the published ones. Raises `ValueError` for an unknown effect."""
    CATALOGUE.check(truth)
    rng = streams("tanks", seed, "plant effects input start noise")
    plant = Rig(**{name: k * (1 + rng["plant"].uniform(-spread, spread)) for name, k in PUBLISHED.items()})

    def drawn() -> dict[str, Any]:
        return {k: v for name in truth for k, v in tanks_effects.DRAWS[name](rng["effects"], plant).items()}

    draw = drawn()
    starts = [tuple(rng["start"].uniform(2.0, 8.0, 2).tolist()) for _ in range(2)]
    if rng["start"].random() < 0.5:
        starts[1] = starts[0]
    for _ in range(_TRIES):
        rig, inputs, found = _excited(plant, draw, _shapes(rng["input"], "u_dead" in draw), starts)
        if not _bounded(found):
            draw = drawn()
        elif _active(draw, found):
            break
    clean = [reading(rig, lower) for _, lower in found]
    without = levels(plant, inputs[1], starts[1], _COARSE)[1]
    noisy = [
        reading(rig, lower, errors(rng["noise"], noise_kind, noise, y))
        for (_, lower), y in zip(found, clean, strict=True)
    ]
    info = RecordInfo(
        (Channel("pump_voltage", "V"),), (Channel("level_voltage", "V"),), SAMPLE_TIME, "simulated", f"tanks, {seed}"
    )
    train, test = (measured(u[HISTORY:, None], y[:, None], info) for u, y in zip(inputs, noisy, strict=True))
    sizes = {k: getattr(rig, k) for k in draw} | {
        "parameters": {k: getattr(plant, k) for k in PUBLISHED},
        "start": starts,
    }
    return Case(
        system="tanks",
        seed=seed,
        truth=truth,
        accepted=CATALOGUE.accepted(truth),
        removed=removed,
        magnitudes=sizes,
        noise=noise,
        physics=dict(PUBLISHED),
        train=train,
        test=test,
        floor=rms(noisy[1] - clean[1]),
        change=rms(clean[1] - without),
        noise_kind=noise_kind,
    )


def _shapes(rng: np.random.Generator, fast: bool) -> list[Wave]:
    """Standardised voltages of both records: one kind of signal, two realisations.

    fast: the pump stops at times, and should run again before the tanks are empty for long.
    """
    n, steps = SAMPLES + HISTORY, rng.random() < 0.5
    if steps:
        spans, lag = ((8, 35), 3.0) if fast else ((20, 90), 6.0)
        return [smooth_steps(rng, n, *spans, lag) for _ in range(2)]
    strong = int(rng.integers(25, 45) if fast else rng.integers(12, 25))
    return [multisine(rng, n, strong, 60) for _ in range(2)]


def _excited(
    plant: Rig, draw: dict[str, Any], shapes: list[Wave], starts: list[tuple[float, ...]]
) -> tuple[Rig, list[Wave], list[tuple[Wave, Wave]]]:
    """The rig with its thresholds, the voltages, and the levels in both tanks.

    Mean and size of the voltage are corrected by the flow that the lower tank lacks at either end of its range.
    """
    mean, size = 2.4, 0.9
    inputs, rig = shapes, plant
    anchor = draw.get("u_dead")
    bend = draw.get("curvature", 0.0)
    highest = _LARGEST if bend >= 0 else min(_LARGEST, 4.9 / -bend)  # below the vertex of the parabola, 5 / -a
    for _ in range(8):
        if anchor is not None:
            mean = anchor.at - size * np.quantile(np.concatenate(shapes), anchor.q)
        inputs = [np.clip(mean + size * shape, 0.0, highest) for shape in shapes]
        rig = plant._replace(**resolved(draw, {"voltage": np.concatenate(inputs)}))
        lower = np.concatenate([levels(rig, u, s, 1)[1] for u, s in zip(inputs, starts, strict=True)])
        want, have = (_outlet(rig, np.array(ends)) for ends in (_targets(rig), np.quantile(lower, [0.02, 0.98])))
        lift = (want[1] - want[0]) / max(have[1] - have[0], 1e-4) if anchor is None else want[1] / have[1]
        size = np.clip(size * np.clip(lift, 0.6, 1.6), 0.2, 4.0)
        gain = np.mean([np.mean(flow(rig, u + 0.05) - flow(rig, u - 0.05)) for u in inputs]) / 0.1
        mean = np.clip(mean + 0.8 * np.mean(want - have) / gain, 0.5, 7.0)
    free = [levels(rig, u, s, _COARSE) for u, s in zip(inputs, starts, strict=True)]
    upper, lower = (np.concatenate(tank) for tank in zip(*free, strict=True))
    signals = {"voltage": np.concatenate(inputs), "upper": upper, "lower": lower}
    rig = plant._replace(**resolved(draw, signals))
    found = [levels(rig, u, s) for u, s in zip(inputs, starts, strict=True)]
    signals["reading"] = np.concatenate([reading(rig, lower) for _, lower in found])
    return plant._replace(**resolved(draw, signals)), inputs, found


def _targets(rig: Rig) -> tuple[float, float]:
    """An offset of the sensor shifts the levels so that its readings stay in the range."""
    return _RANGE[0] - min(rig.y_offset, 0.0), _RANGE[1] - max(rig.y_offset, 0.0)


def _outlet(rig: Rig, x2: np.ndarray) -> np.ndarray:
    return rig.k4 * REFERENCE_LEVEL**0.5 * (x2 / REFERENCE_LEVEL) ** rig.exponent - rig.k5 * x2


def _bounded(found: list[tuple[Wave, Wave]]) -> bool:
    """Has no tank run away? Beyond some level a bent outlet, against which k5 works, lets through less and less."""
    return max(level.max() for tanks in found for level in tanks) < _BEYOND


def _active(draw: dict[str, Any], found: list[tuple[Wave, Wave]]) -> bool:
    """Has each record come to the level of every threshold of a level in some of its samples?"""
    for limit in (v for v in draw.values() if isinstance(v, Quantile)):
        if limit.of in ("upper", "lower", "reading"):
            tanks = [x[0] if limit.of == "upper" else x[1] for x in found]
            top = np.quantile(np.concatenate(tanks), limit.q)
            if min(np.mean(x >= top) for x in tanks) < _ACTIVE:
                return False
    return True
