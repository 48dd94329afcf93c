"""Effects on what turns the joints of an arm besides its weight, on the link side.

    τ = C (g G u) + θ - k q - m sin(q₂ - φ) - friction      what the motors deliver, a bias, a spring on each joint, the
                                                           counterbalance of the second one

u: motor torque, Nm; G: gear ratio; θ, m: Nm, k: Nm/rad, on the link side. C: the coupling of a wrist (`arm_wrist.py`);
friction: `arm_friction.py`. Numbers are per joint unless said otherwise.
"""

from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.arm_common import INFINITE, arm_effect, largest
from pgrssnn_jax.effects.arm_friction import friction_effects
from pgrssnn_jax.effects.arm_wrist import wrist_coupling
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange
from pgrssnn_jax.physics.arms.points import Joints
from pgrssnn_jax.physics.base import Parameter


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
        linear_spring(n),
        *friction_effects(n),
    )


def linear_spring(n: int) -> Effect:
    return arm_effect(
        n,
        "linear_spring",
        "torque",
        lambda n, own, tau, q, *_: tau - n["k"] * q,
        {"k": Parameter("k", "Nm/rad", bounds=(0.0, INFINITE), neutral=0.0)},
        title="Spring on a joint",
        equation="τ = ... - k q",
        cause="a spring, a cable or a hose pulls a joint to its zero; another rest angle shows as a constant torque",
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
