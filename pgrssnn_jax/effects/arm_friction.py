"""Friction of the joints of an arm beside the known one, on the link side.

    τ = ... - G² B q̇ - |G| Tc s                     s = tanh(q̇ / v0)
            - |G| Ts e^{-(q̇/v_s)²} s
            - μ |G u| s                                   the gear loses more, the more torque it passes on
            - |G| ΔTc s² - G² ΔB |q̇|               more in the positive direction, less in the negative one

u: motor torque, Nm; μ: none; G: gear ratio; B, ΔB (Nm s), Tc, Ts, ΔTc (Nm): on the motor side. v0 is small and fixed:
a tanh in place of a sign, so that a fit sees the friction of a joint that turns. Numbers are per joint unless said
otherwise.
Source: Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994).
"""

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.arm_common import INFINITE, STANDSTILL, arm_effect, largest
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange
from pgrssnn_jax.physics.arms.points import Joints
from pgrssnn_jax.physics.base import Parameter

_PUSH = 0.05  # of the largest motor torque: where a fit of friction begins


def friction_effects(n: int) -> tuple[Effect, ...]:
    """Of an arm of n joints."""
    effect = partial(arm_effect, n)
    return (
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
        effect(
            "load_friction",
            "torque",
            lambda n, own, tau, q, v, drive: tau - n["mu"] * jnp.abs(drive) * jnp.tanh(v / STANDSTILL),
            {"mu": Parameter("μ", "", bounds=(0.0, 0.9), neutral=0.0)},
            title="Friction that grows with the load",
            equation="τ = ... - μ |G u| tanh(q̇ / 0.02 rad/s)",
            cause="teeth and bearings of a gear rub the harder, the more torque they pass on",
            elaborate=True,
        ),
        effect(
            "asymmetric_friction",
            "torque",
            lambda n, own, tau, q, v, drive: (
                tau
                - jnp.abs(own["G"]) * n["dTc"] * jnp.tanh(v / STANDSTILL) ** 2
                - own["G"] ** 2 * n["dB"] * jnp.abs(v)
            ),
            {"dTc": Parameter("ΔTc", "Nm", neutral=0.0), "dB": Parameter("ΔB", "Nm s", neutral=0.0)},
            title="Friction that depends on the direction",
            equation="τ = ... - |G| ΔTc tanh²(q̇ / 0.02 rad/s) - G² ΔB |q̇|",
            cause="gears and seals brake a joint more in one direction than in the other",
            simpler=("coulomb_friction",),
            elaborate=True,
        ),
    )


def stribeck_friction(n: int) -> Effect:
    """One speed for all joints: it is poorly told by one joint alone. Below v0 it would correct the tanh."""

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
            "speed": Parameter("v_s", "rad/s", bounds=(STANDSTILL, INFINITE), neutral=0.1),
        },
        title="Stribeck friction",
        equation="τ = ... - |G| Ts exp(-(q̇ / v_s)²) tanh(q̇ / 0.02 rad/s)",
        cause="a joint that starts to turn is braked more than one whose lubricant has built up a film",
        initial_guesses=initial_guesses,
        shapes={"torque": (n,)},
        active=lambda p, x, u: (np.abs(x[:, n : 2 * n]) < 2 * p["speed"]).any(-1),
        simpler=("coulomb_friction",),
    )
