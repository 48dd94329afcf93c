"""KUKA KR300 with hidden effects: 12 + 4 motions of 30 s, 300 samples each (`arm_plant.py` has the equations).

    y = q + home + e,   e ~ N(0, noise² I)         nominal physics: the described arm, nothing of it wrong by numbers

Every motion starts and ends at rest at zero; the torque holds what the controller did against the effect.
"""

from typing import Any

from pgrssnn_jax.data.arm_simulator import planned
from pgrssnn_jax.physics.arms.tables import described
from pgrssnn_jax.records.record import Channel, RecordInfo

from . import arm_effects
from .arm_plant import SAMPLE_TIME, Effects, controlled, free_run
from .case import Case, measured, rms, streams

CATALOGUE = arm_effects.CATALOGUE
TRAIN, TEST, SAMPLES = 12, 4, 300
_QUICK = 5  # sub-steps where only the size of an error counts


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
    rng = streams("arm", seed, "effects input noise")
    known = described("kuka_kr300", "reference")
    tables, effects, sizes = known, Effects(), {}
    for name in truth:
        tables, effects, size = arm_effects.DRAWS[name](rng["effects"], tables, effects)
        sizes |= size
    plan = planned(rng["input"], known, TRAIN + TEST, SAMPLES)
    u, clean = controlled(known, tables, effects, plan)
    y = clean + noise * rng["noise"].standard_normal(clean.shape)
    channels = ([Channel(f"{what}_{i + 1}", unit) for i in range(known.n)] for what, unit in _SIGNALS)
    info = RecordInfo(*(tuple(c) for c in channels), SAMPLE_TIME, "simulated", f"arm, {seed}")
    without = free_run(known, Effects(), u[TRAIN:], _QUICK)
    return Case(
        system="arm",
        seed=seed,
        truth=truth,
        accepted=CATALOGUE.accepted(truth),
        removed=removed,
        magnitudes=sizes,
        noise=noise,
        physics=dict(physics or {}),
        train=measured(u[:TRAIN], y[:TRAIN], info),
        test=measured(u[TRAIN:], y[TRAIN:], info),
        floor=rms(y[TRAIN:] - clean[TRAIN:]),
        change=rms(clean[TRAIN:] - without),
    )


_SIGNALS = (("torque", "Nm"), ("position", "rad"))
