"""What turns the joints of an arm besides its weight, on the link side.

    τ = C (g G u) + θ - G² B q̇ - |G| Tc sign(q̇)                                  the documented terms, C = 1, g = 1
        - G² B' q̇ - |G| Tc' tanh(q̇/v0) - |G| Ts e^{-(q̇/v_s)²} tanh(q̇/v0)         friction beside the known one
        - k sin(q₂ - φ) + θ'                                                       counterbalance of the second joint

u: motor torque, Nm; G: gear ratio; B (Nm s), Tc, Ts (Nm): on the motor side; θ, k: Nm on the link side. v0 is small
and fixed: a tanh in place of a sign, so that a fit sees the friction of a joint that turns. C: the last motors of a
wrist drive the joints before them as well, c45 being the part of motor 5 that joint 4 feels:
C = 1 + c45 e₄e₅ᵀ + c46 e₄e₆ᵀ + c56 e₅e₆ᵀ. Every term of an effect is there when its name is among the parameters.
Source of the friction: Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

Joints = Float[jax.Array, " n"]
STANDSTILL = 0.02  # rad/s, v0


def link_torques(p: Any, q: Joints, v: Joints, u: Joints) -> Joints:
    """Nm on the link side. p: `G`, `B`, `Tc`, perhaps `theta`, and the numbers of effects by their names."""
    gear = p["G"]
    tau = _drive(p, gear * u) - (gear**2 * p["B"] * v + jnp.abs(gear) * p["Tc"] * jnp.sign(v))
    if "theta" in p:
        tau = tau + p["theta"]
    if "torque_bias" in p:
        tau = tau + p["torque_bias"]["theta"]
    if "gravity_counterbalance" in p:
        k, angle = p["gravity_counterbalance"]["moment"], p["gravity_counterbalance"]["angle"]
        tau = tau.at[min(1, len(tau) - 1)].add(-k * jnp.sin(q[min(1, len(tau) - 1)] - angle))
    return tau - _more_friction(p, jnp.abs(gear), v)


def _drive(p: Any, drive: Joints) -> Joints:
    if "torque_gain" in p:
        drive = p["torque_gain"]["gain"] * drive
    if "wrist_coupling" in p:
        c = p["wrist_coupling"]
        drive = drive.at[-3].add(c["c45"] * drive[-2] + c["c46"] * drive[-1]).at[-2].add(c["c56"] * drive[-1])
    return drive


def _more_friction(p: Any, gear: Joints, v: Joints) -> Joints:
    total, way = jnp.zeros_like(v), jnp.tanh(v / STANDSTILL)
    if "viscous_friction" in p:
        total = total + gear**2 * p["viscous_friction"]["B"] * v
    if "coulomb_friction" in p:
        total = total + gear * p["coulomb_friction"]["Tc"] * way
    if "stribeck_friction" in p:
        slow = jnp.exp(-((v / p["stribeck_friction"]["speed"]) ** 2))
        total = total + gear * p["stribeck_friction"]["torque"] * slow * way
    return total
