"""KUKA KR300 with hidden effects: 12 + 4 motions of 30 s at 10 to 100 Hz (`arm_plant.py` has the equations).

    y = q + home + e,   e ~ N(0, noise² I)         nominal physics: the described arm, its friction up to 10 % wrong

Every motion starts and ends at rest at zero; the torque holds what the controller did against the effect. The
controller knows the described arm; where gravity or an encoder is far from what is described, it knows better.
"""

from typing import Any

import numpy as np

from pgrssnn_jax.data.arm_simulator import planned
from pgrssnn_jax.physics.arms.tables import described
from pgrssnn_jax.records.record import Channel, RecordInfo

from . import arm_effects
from .arm_plant import SAMPLE_TIME, Effects, controlled, free_run
from .case import Case, measured, rms, streams

CATALOGUE = arm_effects.CATALOGUE
TRAIN, TEST, SECONDS = 12, 4, 30.0
SAMPLE_TIMES = (0.1, 0.05, 0.02, 0.01)  # s
_SUB_STEPS = 5  # in 0.1 s, of the physics that is given, and where only the size of an error counts
_FAR = 1.0  # rad: nobody runs an arm whose controller is wrong about gravity or a zero by so much


def build(
    seed: int,
    truth: tuple[str, ...] = (),
    *,
    noise: float = 0.01,
    removed: tuple[str, ...] = (),
    physics: dict[str, Any] | None = None,
) -> Case:
    """physics: settings of the nominal arm beyond conf/physics/arm.yaml, passed on as they are (sub_steps, say).

    Raises `ValueError` for an unknown effect.
    """
    CATALOGUE.check(truth)
    rng = streams("arm", seed, "effects input noise friction time")
    known = described("kuka_kr300", "reference")
    dt = float(rng["time"].choice(SAMPLE_TIMES))
    tables, effects = arm_effects.rubbing(rng["friction"], known), Effects()
    sizes = {"viscous": tables.viscous.tolist(), "coulomb": tables.coulomb.tolist()}
    for name in truth:
        tables, effects, size = arm_effects.DRAWS[name](rng["effects"], tables, effects)
        sizes |= size
    effects = effects._replace(memory=effects.memory * dt / SAMPLE_TIME)
    plan = planned(rng["input"], known, TRAIN + TEST, round(SECONDS / dt), dt)
    structural = max(abs(sizes.get("tilt", 0.0)), np.abs(effects.home).max()) > _FAR
    u, clean = controlled(
        known._replace(gravity=tables.gravity) if structural else known, tables, effects, plan, dt,
        effects.home if structural else 0.0,
    )  # fmt: skip
    y = clean + noise * rng["noise"].standard_normal(clean.shape)
    channels = ([Channel(f"{what}_{i + 1}", unit) for i in range(known.n)] for what, unit in _SIGNALS)
    info = RecordInfo(*(tuple(c) for c in channels), dt, "simulated", f"arm, {seed}")
    without = free_run(known, Effects(), u[TRAIN:], dt, _SUB_STEPS)
    return Case(
        system="arm",
        seed=seed,
        truth=truth,
        accepted=CATALOGUE.accepted(truth),
        removed=removed,
        magnitudes=sizes,
        noise=noise,
        physics={"dt": dt, "sub_steps": max(1, round(_SUB_STEPS * dt / SAMPLE_TIME)), **(physics or {})},
        train=measured(u[:TRAIN], y[:TRAIN], info),
        test=measured(u[TRAIN:], y[TRAIN:], info),
        floor=rms(y[TRAIN:] - clean[TRAIN:]),
        change=rms(clean[TRAIN:] - without),
    )


_SIGNALS = (("torque", "Nm"), ("position", "rad"))
