"""The drives of a wrist run through it: the last motors turn, and are felt, by more joints than their own.

    C = 1 + c45 e₄e₅ᵀ + c46 e₄e₆ᵀ + c56 e₅e₆ᵀ,     τ = C G u                  torque of the motors
    w = q̇₆ + r q̇₅                                                            speed of motor 6, in turns of joint 6
    (τ₅, τ₆) ← (τ₅, τ₆) - (r, 1) (G₆² J ẇ + G₆² B w + |G₆| Tc tanh(w/v0))     its inertia and friction

c45: the part of motor 5 that joint 4 feels. J kg m², B Nm s, Tc Nm: on the side of motor 6, what it has beside the
inertia and friction of joint 6; r = ±1 where the gears of the last two joints are equal.
Source: Gautier, Dynamic identification of robots with power model, ICRA 1997 (coupled joints of the Stäubli RX-90).
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.arm_common import INFINITE, STANDSTILL, arm_effect, points_of
from pgrssnn_jax.effects.base import Effect, at_point
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.points import Joints
from pgrssnn_jax.physics.base import Parameter, Physics

_NAME = "wrist_coupling"


def wrist_coupling(n: int) -> Effect:
    """Of an arm of n joints, the last three of which are a wrist; the inertia of motor 6 needs masses that an
    effect may change."""

    def driven(n: Any, own: Any, drive: Joints, u: Joints) -> Joints:
        return drive.at[-3].add(n["c45"] * drive[-2] + n["c46"] * drive[-1]).at[-2].add(n["c56"] * drive[-1])

    def braked(n: Any, own: Any, tau: Joints, q: Joints, v: Joints, drive: Joints) -> Joints:
        gear, speed = own["G"][-1], v[-1] + n["ratio"] * v[-2]
        brake = gear**2 * n["B"] * speed + jnp.abs(gear) * n["Tc"] * jnp.tanh(speed / STANDSTILL)
        return tau.at[-2:].add(-brake * jnp.stack([n["ratio"], jnp.ones_like(speed)]))

    def heavier(n: Any, own: Any, extra: Extra) -> Extra:
        return extra._replace(wrist=jnp.stack([n["J"] * own["G"][-1] ** 2, n["ratio"]]))

    def wrap(physics: Physics) -> Physics:
        points = points_of(physics)
        assert points is not None  # `needs`
        coupled = at_point(at_point(physics, "drive", _NAME, driven), "torque", _NAME, braked)
        return at_point(coupled, "masses", _NAME, heavier) if points.masses else coupled

    return arm_effect(
        n,
        _NAME,
        "drive",
        driven,
        {
            **{name: Parameter(name, "", bounds=(-2.0, 2.0), neutral=0.0) for name in ("c45", "c46", "c56")},
            "ratio": Parameter("r", "", bounds=(-2.0, 2.0), neutral=1.0),
            "J": Parameter("J", "kg m^2", bounds=(0.0, INFINITE), neutral=0.0),
            "B": Parameter("B", "Nm s", bounds=(0.0, INFINITE), neutral=0.0),
            "Tc": Parameter("Tc", "Nm", bounds=(0.0, INFINITE), neutral=0.0),
        },
        per_joint=False,
        wrap=wrap,
        title="Coupling of the wrist's motors",
        equation="τ4 += c45 G5 u5 + c46 G6 u6, τ5 += c56 G6 u6; inertia J, friction B and Tc of motor 6 on q̇6 + r q̇5",
        cause="the drives of the last joints run through the wrist: their torque, inertia and friction act on the "
        "joints before as well",
        acts_on="input",
        initial_guesses=lambda span: [{**_nothing(), "ratio": np.asarray(ratio)} for ratio in (1.0, -1.0)],
    )


def _nothing() -> dict[str, Float[np.ndarray, ""]]:
    return {name: np.zeros(()) for name in ("c45", "c46", "c56", "J", "B", "Tc")}
