"""Effects on an arm once a step is done: joints that meet a stop, and joints that stick.

    joint_limit   q ← min(max(q, q_low), q_high);   q̇ ← 0 where a joint at its stop moves into it
    stiction      q̇ ← q̇ (1 - e^{-(q̇/v_s)²})

Both act on whole samples. A stop that is hard has one number, its place; stiffness could not be told from it at these
sample times. What motor and weight accelerate within one sample to less than about v_s does not break loose: v_s is
dt |G| Ts / M_jj for a breakaway torque Ts. A law in speed is stable at any sample time, where a torque that is steep at
standstill makes an explicit step chatter.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Float

State = Float[jax.Array, " x"]


def stopped_joints(p: Any, x: State) -> State:
    """The state with every joint that is beyond a stop held there."""
    if "joint_limit" not in p:
        return x
    (q, v), low, high = jnp.split(x, 2), p["joint_limit"]["lower"], p["joint_limit"]["upper"]
    into = ((q >= high) & (v > 0)) | ((q <= low) & (v < 0))
    return jnp.concatenate([jnp.clip(q, low, high), jnp.where(into, 0.0, v)])


def stuck_joints(p: Any, x: State) -> State:
    """The state with slow joints slower."""
    if "stiction" not in p:
        return x
    q, v = jnp.split(x, 2)
    speed = p["stiction"]["speed"]
    sticks = speed > 0
    ratio = v / jnp.where(sticks, speed, 1.0)
    return jnp.concatenate([q, jnp.where(sticks, -jnp.expm1(-(ratio**2)), 1.0) * v])
