"""Effects on the joints of an arm once a step is done, and on how they are read.

    joint_limit            q ← min(max(q, q_low), q_high);   q̇ ← 0 where a joint at its stop moves into it
    stiction               q̇ ← q̇ (1 - e^{-(q̇/v_s)²})
    velocity_disturbance   q̇_t ← q̇_t + S q̇_{t-1}
    home_offset            y = q + b, where the state is y

One number per joint. Stops act on whole samples: one that is hard has one number, its place; stiffness could not be
told from it at these sample times. What motor and weight accelerate within one sample to less than about v_s does not
break loose: v_s is dt |G| Ts / M_jj for a breakaway torque Ts. A law in speed is stable at any sample time, where a
torque that is steep at standstill makes an explicit step chatter.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.arm_common import INFINITE, largest, per_joint
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, at_point
from pgrssnn_jax.physics.arms.points import State
from pgrssnn_jax.physics.base import Parameter, Physics


def _stopped(n: Any, own: Any, x: State, _: State) -> State:
    """The state with every joint that is beyond a stop held there."""
    (q, v), low, high = jnp.split(x, 2), n["lower"], n["upper"]
    into = ((q >= high) & (v > 0)) | ((q <= low) & (v < 0))
    return jnp.concatenate([jnp.clip(q, low, high), jnp.where(into, 0.0, v)])


def _stuck(n: Any, own: Any, x: State, _: State) -> State:
    """The state with slow joints slower."""
    (q, v), speed = jnp.split(x, 2), n["speed"]
    sticks = speed > 0
    ratio = v / jnp.where(sticks, speed, 1.0)
    return jnp.concatenate([q, jnp.where(sticks, -jnp.expm1(-(ratio**2)), 1.0) * v])


def _disturbed(n: Any, own: Any, new: State, x: State, _: State) -> State:
    joints = len(x) // 2
    return new.at[joints:].add(n["S"] * x[joints:])


def joint_limit(n: int) -> Effect:
    def initial_guesses(span: SignalRange) -> list[Numbers]:
        low, high = span.x[:, :n]
        return [
            {"lower": low + share * (high - low), "upper": high - share * (high - low)} for share in (0.03, 0.1, 0.25)
        ]

    def active(p: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        q = x[:, :n]
        return ((q >= p["upper"] - 1e-6) | (q <= p["lower"] + 1e-6)).any(-1)

    return per_joint(
        n,
        {
            "lower": Parameter("q_low", "rad", neutral=-INFINITE),
            "upper": Parameter("q_high", "rad", neutral=INFINITE),
        },
        name="joint_limit",
        title="End stop of a joint",
        equation="q_low ≤ q ≤ q_high, q̇ = 0 at the stop",
        cause="a joint meets a mechanical stop inside its known range",
        initial_guesses=initial_guesses,
        wrap=lambda physics: at_point(physics, "stop", "joint_limit", _stopped),
        active=active,
    )


def stiction(n: int) -> Effect:
    def initial_guesses(span: SignalRange) -> list[Numbers]:
        return [{"speed": share * largest(span.x, n)[:n]} for share in (0.02, 0.1)]

    return per_joint(
        n,
        {"speed": Parameter("v_s", "rad/s", bounds=(0.0, INFINITE), neutral=0.0)},
        name="stiction",
        title="Stiction",
        equation="q̇ = q̇' (1 - exp(-(q̇' / v_s)²))",
        cause="a joint that stands still is held until the torque breaks it loose",
        initial_guesses=initial_guesses,
        wrap=lambda physics: at_point(physics, "stop", "stiction", _stuck),
        active=lambda p, x, u: (np.abs(x[:, n : 2 * n]) < p["speed"]).any(-1),
    )


def velocity_disturbance(n: int) -> Effect:
    return per_joint(
        n,
        {"S": Parameter("S", "", bounds=(-1.0, 1.0), neutral=0.0)},
        name="velocity_disturbance",
        title="Disturbance of the velocities",
        equation="q̇_t = q̇'_t + S q̇_{t-1}",
        cause="a joint keeps or loses a part of its speed in every sample, beyond what its masses and friction say",
        wrap=lambda physics: at_point(physics, "disturbance", "velocity_disturbance", _disturbed),
    )


def home_offset(n: int) -> Effect:
    """The state holds what the encoders read, so that a record says where a run starts whatever the offset."""
    name = "home_offset"

    def wrap(physics: Physics) -> Physics:
        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            shift = jnp.zeros_like(x).at[:n].set(jnp.asarray(p.effects[name]["offset"], x.dtype))
            return physics.step(p, x - shift, u) + shift

        return physics._replace(step=step)

    return per_joint(
        n,
        {"offset": Parameter("b", "rad", bounds=(-np.pi, np.pi), neutral=0.0)},
        name=name,
        title="Zero of the encoders",
        equation="y = q + b",
        cause="the position at which an encoder reads zero is not the one of the description",
        acts_on="measurement",
        wrap=wrap,
    )
