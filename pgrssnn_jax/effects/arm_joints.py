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

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.arm_common import INFINITE, an_arm, at_neutral, largest
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, at_points
from pgrssnn_jax.physics.arms.points import ArmPoints, State
from pgrssnn_jax.physics.base import Parameter, Physics


def _on_stop(name: str, change: Callable[[Any, State], State]) -> Callable[[Physics], Physics]:
    """x ← change(n, x) once the step is done, n: numbers of the effect."""

    def changed(points: ArmPoints) -> ArmPoints:
        return points._replace(stop=lambda p, x: change(p.effects[name], points.stop(p, x)))

    return lambda physics: at_points(physics, changed)


def _stopped(n: Any, x: State) -> State:
    """The state with every joint that is beyond a stop held there."""
    (q, v), low, high = jnp.split(x, 2), n["lower"], n["upper"]
    into = ((q >= high) & (v > 0)) | ((q <= low) & (v < 0))
    return jnp.concatenate([jnp.clip(q, low, high), jnp.where(into, 0.0, v)])


def _stuck(n: Any, x: State) -> State:
    """The state with slow joints slower."""
    (q, v), speed = jnp.split(x, 2), n["speed"]
    sticks = speed > 0
    ratio = v / jnp.where(sticks, speed, 1.0)
    return jnp.concatenate([q, jnp.where(sticks, -jnp.expm1(-(ratio**2)), 1.0) * v])


def _disturbed(points: ArmPoints) -> ArmPoints:
    def disturbance(p: Any, x: State, new: State) -> State:
        n = len(x) // 2
        return points.disturbance(p, x, new).at[n:].add(p.effects["velocity_disturbance"]["S"] * x[n:])

    return points._replace(disturbance=disturbance)


def joint_limit(n: int) -> Effect:
    def initial_guesses(span: SignalRange) -> list[Numbers]:
        low, high = span.x[:, :n]
        return [
            {"lower": low + share * (high - low), "upper": high - share * (high - low)} for share in (0.03, 0.1, 0.25)
        ]

    def active(p: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        q = x[:, :n]
        return ((q >= p["upper"] - 1e-6) | (q <= p["lower"] + 1e-6)).any(-1)

    return Effect(
        "joint_limit",
        title="End stop of a joint",
        equation="q_low ≤ q ≤ q_high, q̇ = 0 at the stop",
        cause="a joint meets a mechanical stop inside its known range",
        acts_on="dynamics",
        parameters={
            "lower": Parameter("q_low", "rad", neutral=-INFINITE),
            "upper": Parameter("q_high", "rad", neutral=INFINITE),
        },
        initial_guesses=initial_guesses,
        wrap=_on_stop("joint_limit", _stopped),
        needs=an_arm(n),
        shapes={"lower": (n,), "upper": (n,)},
        active=active,
        channels="joint",
    )


def stiction(n: int) -> Effect:
    def initial_guesses(span: SignalRange) -> list[Numbers]:
        return [{"speed": share * largest(span.x, n)[:n]} for share in (0.02, 0.1)]

    return Effect(
        "stiction",
        title="Stiction",
        equation="q̇ = q̇' (1 - exp(-(q̇' / v_s)²))",
        cause="a joint that stands still is held until the torque breaks it loose",
        acts_on="dynamics",
        parameters={"speed": Parameter("v_s", "rad/s", bounds=(0.0, INFINITE), neutral=0.0)},
        initial_guesses=initial_guesses,
        wrap=_on_stop("stiction", _stuck),
        needs=an_arm(n),
        shapes={"speed": (n,)},
        active=lambda p, x, u: (np.abs(x[:, n : 2 * n]) < p["speed"]).any(-1),
        channels="joint",
    )


def velocity_disturbance(n: int) -> Effect:
    parameters = {"S": Parameter("S", "", bounds=(-1.0, 1.0), neutral=0.0)}
    return Effect(
        "velocity_disturbance",
        title="Disturbance of the velocities",
        equation="q̇_t = q̇'_t + S q̇_{t-1}",
        cause="a joint keeps or loses a part of its speed in every sample, beyond what its masses and friction say",
        acts_on="dynamics",
        parameters=parameters,
        initial_guesses=at_neutral(parameters, n),
        wrap=lambda physics: at_points(physics, _disturbed),
        needs=an_arm(n),
        shapes={"S": (n,)},
        channels="joint",
    )


def home_offset(n: int) -> Effect:
    """The state holds what the encoders read, so that a record says where a run starts whatever the offset."""
    name, parameters = "home_offset", {"offset": Parameter("b", "rad", bounds=(-np.pi, np.pi), neutral=0.0)}

    def wrap(physics: Physics) -> Physics:
        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            shift = jnp.zeros_like(x).at[:n].set(jnp.asarray(p.effects[name]["offset"], x.dtype))
            return physics.step(p, x - shift, u) + shift

        return physics._replace(step=step)

    return Effect(
        name,
        title="Zero of the encoders",
        equation="y = q + b",
        cause="the position at which an encoder reads zero is not the one of the description",
        acts_on="measurement",
        parameters=parameters,
        initial_guesses=at_neutral(parameters, n),
        wrap=wrap,
        needs=an_arm(n),
        shapes={"offset": (n,)},
        channels="joint",
    )
