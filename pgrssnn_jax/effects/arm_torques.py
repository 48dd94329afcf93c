"""Effects on what turns the joints of an arm besides its weight, on the link side.

    τ = C (g G u) + ...                                                      what the motors deliver
        + θ - G² B q̇ - |G| Tc tanh(q̇/v0) - |G| Ts e^{-(q̇/v_s)²} tanh(q̇/v0)    bias, and friction beside the known one
        - k sin(q₂ - φ)                                                      counterbalance of the second joint

u: motor torque, Nm; G: gear ratio; B (Nm s), Tc, Ts (Nm): on the motor side; θ, k: Nm on the link side. v0 is small
and fixed: a tanh in place of a sign, so that a fit sees the friction of a joint that turns. C: the last motors of a
wrist drive the joints before them as well, c45 being the part of motor 5 that joint 4 feels:
C = 1 + c45 e₄e₅ᵀ + c46 e₄e₆ᵀ + c56 e₅e₆ᵀ. Numbers are per joint unless said otherwise.
Source of the friction: Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994).
"""

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.arm_common import INFINITE, arm_effect, largest
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange
from pgrssnn_jax.physics.arms.points import Joints
from pgrssnn_jax.physics.base import Parameter

WRIST = 6  # joints of an arm whose last three are a wrist
_STANDSTILL = 0.02  # rad/s, v0
_PUSH = 0.05  # of the largest motor torque: where a fit of friction begins


def torque_effects(n: int, gear: np.ndarray) -> tuple[Effect, ...]:
    """Of an arm of n joints. gear: its size gives the fit of a counterbalance a torque to begin with."""
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
        *((wrist_coupling(),) if n == WRIST else ()),
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
            lambda n, own, tau, q, v, drive: tau - jnp.abs(own["G"]) * n["Tc"] * jnp.tanh(v / _STANDSTILL),
            {"Tc": Parameter("Tc", "Nm", bounds=(0.0, INFINITE), neutral=0.0)},
            title="More Coulomb friction",
            equation="τ = ... - |G| Tc tanh(q̇ / 0.02 rad/s)",
            cause="dry friction brakes a joint at any speed, beyond what is known",
        ),
        stribeck_friction(n),
    )


def wrist_coupling() -> Effect:
    def coupled(n: Any, own: Any, drive: Joints, u: Joints) -> Joints:
        return drive.at[-3].add(n["c45"] * drive[-2] + n["c46"] * drive[-1]).at[-2].add(n["c56"] * drive[-1])

    return arm_effect(
        WRIST,
        "wrist_coupling",
        "drive",
        coupled,
        {name: Parameter(name, "", bounds=(-2.0, 2.0), neutral=0.0) for name in ("c45", "c46", "c56")},
        per_joint=False,
        title="Coupling of the wrist's motors",
        equation="τ4 += c45 G5 u5 + c46 G6 u6,  τ5 += c56 G6 u6",
        cause="the drives of the last joints run through the wrist, and their torque turns the joints before as well",
        acts_on="input",
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
        return tau - jnp.abs(own["G"]) * n["torque"] * slow * jnp.tanh(v / _STANDSTILL)

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
