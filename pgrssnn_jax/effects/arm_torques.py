"""Effects on what turns the joints of an arm besides its weight, on the link side.

    τ = C (g G u) + ...                                                      what the motors deliver
        + θ - G² B q̇ - |G| Tc tanh(q̇/v0) - |G| Ts e^{-(q̇/v_s)²} tanh(q̇/v0)    bias, and friction beside the known one
        - k sin(q₂ - φ)                                                      counterbalance of the second joint

u: motor torque, Nm; G: gear ratio; B (Nm s), Tc, Ts (Nm): on the motor side; θ, k: Nm on the link side. v0 is small
and fixed: a tanh in place of a sign, so that a fit sees the friction of a joint that turns. C: the coupling of a wrist
(`arm_wrist.py`). Numbers are per joint unless said otherwise.
Source of the friction: Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994).
"""

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.arm_common import INFINITE, STANDSTILL, arm_effect, largest
from pgrssnn_jax.effects.arm_wrist import wrist_coupling
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange
from pgrssnn_jax.physics.arms.points import Joints
from pgrssnn_jax.physics.base import Parameter

_PUSH = 0.05  # of the largest motor torque: where a fit of friction begins


def torque_effects(n: int, gear: np.ndarray, *, wrist: bool = False) -> tuple[Effect, ...]:
    """Of an arm of n joints. wrist: the last three are one. gear: its size gives the fit of a counterbalance a
    torque to begin with."""
    effect = partial(arm_effect, n)
    return (
        effect(
            "torque_gain",
            "drive",
            lambda n, own, drive, u: n["gain"] * drive,
            {"gain": Parameter("g", "", bounds=(0.05, 20.0), neutral=1.0)},
            title="Gain of the motor torque",
            equation="τ = g G u",
            cause="a motor delivers more or less torque than its current says, or the gear loses some of it",
            acts_on="input",
        ),
        *((wrist_coupling(n),) if wrist else ()),
        effect(
            "torque_bias",
            "torque",
            lambda n, own, tau, *_: tau + n["theta"],
            {"theta": Parameter("θ", "Nm", neutral=0.0)},
            title="Constant torque",
            equation="τ = G u + θ",
            cause="a constant torque on the link side that the motors do not deliver",
        ),
        gravity_counterbalance(n, gear),
        effect(
            "viscous_friction",
            "torque",
            lambda n, own, tau, q, v, drive: tau - own["G"] ** 2 * n["B"] * v,
            {"B": Parameter("B", "Nm s", bounds=(0.0, INFINITE), neutral=0.0)},
            title="More viscous friction",
            equation="τ = ... - G² B q̇",
            cause="lubricant and seals brake a joint in proportion to its speed, beyond what is known",
        ),
        effect(
            "coulomb_friction",
            "torque",
            lambda n, own, tau, q, v, drive: tau - jnp.abs(own["G"]) * n["Tc"] * jnp.tanh(v / STANDSTILL),
            {"Tc": Parameter("Tc", "Nm", bounds=(0.0, INFINITE), neutral=0.0)},
            title="More Coulomb friction",
            equation="τ = ... - |G| Tc tanh(q̇ / 0.02 rad/s)",
            cause="dry friction brakes a joint at any speed, beyond what is known",
        ),
        stribeck_friction(n),
    )


def gravity_counterbalance(n: int, gear: np.ndarray) -> Effect:
    joint = min(1, n - 1)

    def balanced(n: Any, own: Any, tau: Joints, q: Joints, *_: Joints) -> Joints:
        return tau.at[joint].add(-n["moment"] * jnp.sin(q[joint] - n["angle"]))

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        moment = 0.2 * gear[joint] * largest(span.u)[joint]
        return [{"moment": np.asarray(moment), "angle": np.asarray(k * np.pi / 2)} for k in (0, 1, 2, -1)]

    return arm_effect(
        n,
        "gravity_counterbalance",
        "torque",
        balanced,
        {
            "moment": Parameter("k", "Nm", bounds=(0.0, INFINITE), neutral=0.0),
            "angle": Parameter("φ", "rad", neutral=0.0),
        },
        per_joint=False,
        title="Counterbalance of the second joint",
        equation="τ2 = ... - k sin(q2 - φ)",
        cause="a spring or a weight bears part of the arm's weight at the second joint",
        initial_guesses=initial_guesses,
    )


def stribeck_friction(n: int) -> Effect:
    """One speed for all joints: it is poorly told by one joint alone."""

    def braked(n: Any, own: Any, tau: Joints, q: Joints, v: Joints, drive: Joints) -> Joints:
        slow = jnp.exp(-((v / n["speed"]) ** 2))
        return tau - jnp.abs(own["G"]) * n["torque"] * slow * jnp.tanh(v / STANDSTILL)

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        fastest = float(largest(span.x, n)[:n].max())
        return [{"torque": _PUSH * largest(span.u)[:n], "speed": np.asarray(s * fastest)} for s in (0.03, 0.1, 0.3)]

    return arm_effect(
        n,
        "stribeck_friction",
        "torque",
        braked,
        {
            "torque": Parameter("Ts", "Nm", bounds=(0.0, INFINITE), neutral=0.0),
            "speed": Parameter("v_s", "rad/s", bounds=(1e-3, INFINITE), neutral=0.1),
        },
        title="Stribeck friction",
        equation="τ = ... - |G| Ts exp(-(q̇ / v_s)²) tanh(q̇ / 0.02 rad/s)",
        cause="a joint that starts to turn is braked more than one whose lubricant has built up a film",
        initial_guesses=initial_guesses,
        shapes={"torque": (n,)},
        active=lambda p, x, u: (np.abs(x[:, n : 2 * n]) < 2 * p["speed"]).any(-1),
        simpler=("coulomb_friction",),
    )
