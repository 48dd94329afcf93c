"""The effects that a model of a robot arm may lack: torques (`arm_torques.py`), and here on what an arm moves, on its
joints once a step is done, and on how they are read.

    payload                mass m, kg, its centre d m outwards from the tip along the last joint's axis, x and y m
                           across it; its radius of gyration κ m, the same about every axis
    link_mass              m_i ← (1 + s_i) m_i, its inertia in the same proportion, its centre where it was
    rotor_inertia          J kg m² on the motor side, felt as J G² by the links
    gravity_direction      base tilted by R = Ry(β) Rx(α): in the axes of the base gravity is Rᵀ g
    joint_limit            q ← min(max(q, q_low), q_high);   q̇ ← 0 where a joint at its stop moves into it
    stiction               q̇ ← q̇ (1 - e^{-(q̇/v_s)²})
    velocity_disturbance   q̇_t ← q̇_t + S q̇_{t-1}
    home_offset            y = q + b, where the state is y

Joints in rad and rad/s, one number per joint but for payload and gravity. Stops act on whole samples: one that is hard
has one number, its place; stiffness could not be told from it at these sample times. What motor and weight accelerate
within one sample to less than about v_s does not break loose: v_s is dt |G| Ts / M_jj for a breakaway torque Ts. A law
in speed is stable at any sample time, where a torque that is steep at standstill makes an explicit step chatter.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.effects.arm_common import INFINITE, an_arm, arm_effect, largest, points_of
from pgrssnn_jax.effects.arm_torques import torque_effects
from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange, at_point, own_of
from pgrssnn_jax.physics.arms.extra import Extra
from pgrssnn_jax.physics.arms.points import State
from pgrssnn_jax.physics.base import Parameter, Physics

PAYLOAD = ("mass", "distance", "x", "y", "gyration")
_KNOWN = {"S": "velocity_disturbance", "theta": "torque_bias"}


def arm_effects(physics: Physics) -> tuple[Effect, ...]:
    """The effects of an arm of any number of joints in the order in which they are added to it, but for those whose
    numbers the physics already knows: S and θ."""
    own, n = own_of(physics.params), len(physics.inputs)
    gear = np.abs(np.asarray(own["G"], np.float64))
    left_out = {name for symbol, name in _KNOWN.items() if symbol in own}
    points = points_of(physics)
    assert points is not None
    found = (*torque_effects(n, gear, wrist=points.wrist), *mass_effects(n, points.tables.mass), *joint_effects(n))
    return tuple(effect for effect in found if effect.name not in left_out)


def mass_effects(n: int, masses: Float[np.ndarray, " n"]) -> tuple[Effect, ...]:
    """masses: of the links, kg."""
    return (
        arm_effect(
            None,
            "payload",
            "masses",
            lambda n, own, extra: extra._replace(payload=jnp.stack([n[key] for key in PAYLOAD])),
            {
                "mass": Parameter("m", "kg", bounds=(0.0, INFINITE), neutral=0.0),
                **{
                    key: Parameter(symbol, "m", bounds=(-2.0, 2.0), neutral=0.0)
                    for key, symbol in (("distance", "d"), ("x", "x"), ("y", "y"))
                },
                "gyration": Parameter("κ", "m", bounds=(0.0, 2.0), neutral=0.0),
            },
            title="Payload",
            equation="m at d from the tip along the last joint's axis, x and y across it, inertia m κ²",
            cause="the arm carries a load that its description does not have",
            # a mass at a wrong distance would look like another mass and no inertia
            initial_guesses=lambda span: [
                {name: np.full((), value) for name, value in zip(PAYLOAD, (1.0, d, 0.0, 0.0, 0.1), strict=True)}
                for d in (0.1, 0.4)
            ],
        ),
        arm_effect(
            n,
            "link_mass",
            "masses",
            lambda n, own, extra: extra._replace(links=n["share"] * jnp.asarray(masses, n["share"].dtype)),
            {"share": Parameter("s", "", bounds=(-0.9, INFINITE), neutral=0.0)},
            title="Other masses of the links",
            equation="m_i (1 + s_i), inertia in the same proportion",
            cause="links are heavier or lighter than described: cables, covers, drives, another casting",
            elaborate=True,
        ),
        arm_effect(
            n,
            "rotor_inertia",
            "masses",
            lambda n, own, extra: extra._replace(rotor=n["J"] * own["G"] ** 2),
            {"J": Parameter("J", "kg m^2", bounds=(0.0, INFINITE), neutral=0.0)},
            title="More motor inertia",
            equation="M(q) + diag(J G²)",
            cause="rotor, brake or gear turn with the motor and weigh more than known",
        ),
        gravity_direction(),
    )


def tilted(gravity: Float[np.ndarray, "3"], about_x: jax.Array, about_y: jax.Array) -> Float[jax.Array, "3"]:
    """Rᵀ g."""
    gx, gy, gz = (float(g) for g in gravity)
    c, s = jnp.cos(about_y), jnp.sin(about_y)
    x, z = c * gx - s * gz, s * gx + c * gz
    c, s = jnp.cos(about_x), jnp.sin(about_x)
    return jnp.stack([x, c * gy + s * z, c * z - s * gy])


def gravity_direction() -> Effect:
    name, symbols = "gravity_direction", {"about_x": "α", "about_y": "β"}

    def wrap(physics: Physics) -> Physics:
        points = points_of(physics)
        assert points is not None  # `needs`

        def change(n: Any, own: Any, extra: Extra) -> Extra:
            return extra._replace(gravity=tilted(points.tables.gravity, n["about_x"], n["about_y"]))

        return at_point(physics, "masses", name, change)

    return Effect(
        name,
        title="Tilted base",
        equation="g' = (Ry(β) Rx(α))ᵀ g",
        cause="the base of the arm does not stand upright",
        parameters={key: Parameter(symbol, "rad", (-np.pi, np.pi), neutral=0.0) for key, symbol in symbols.items()},
        initial_guesses=lambda span: [{key: np.zeros(()) for key in symbols}],
        wrap=wrap,
        needs=an_arm(masses=True),
    )


def joint_effects(n: int) -> tuple[Effect, ...]:
    """What happens once a step is done, and how the joints are read."""

    def stuck(n: Any, own: Any, x: State, _: State) -> State:
        """The state with slow joints slower."""
        (q, v), speed = jnp.split(x, 2), n["speed"]
        sticks = speed > 0
        ratio = v / jnp.where(sticks, speed, 1.0)
        return jnp.concatenate([q, jnp.where(sticks, -jnp.expm1(-(ratio**2)), 1.0) * v])

    effect = partial(arm_effect, n)
    return (
        joint_limit(n),
        effect(
            "stiction",
            "stop",
            stuck,
            {"speed": Parameter("v_s", "rad/s", bounds=(0.0, INFINITE), neutral=0.0)},
            title="Stiction",
            equation="q̇ = q̇' (1 - exp(-(q̇' / v_s)²))",
            cause="a joint that stands still is held until the torque breaks it loose",
            initial_guesses=lambda span: [{"speed": share * largest(span.x, n)[:n]} for share in (0.02, 0.1)],
            active=lambda p, x, u: (np.abs(x[:, n : 2 * n]) < p["speed"]).any(-1),
        ),
        effect(
            "velocity_disturbance",
            "disturbance",
            lambda numbers, own, new, x, _: new.at[n:].add(numbers["S"] * x[n:]),
            {"S": Parameter("S", "", bounds=(-1.0, 1.0), neutral=0.0)},
            title="Disturbance of the velocities",
            equation="q̇_t = q̇'_t + S q̇_{t-1}",
            cause="a joint keeps or loses a part of its speed in every sample, beyond what its masses and friction say",
        ),
        home_offset(n),
    )


def joint_limit(n: int) -> Effect:
    def stopped(n: Any, own: Any, x: State, _: State) -> State:
        """The state with every joint that is beyond a stop held there."""
        (q, v), low, high = jnp.split(x, 2), n["lower"], n["upper"]
        into = ((q >= high) & (v > 0)) | ((q <= low) & (v < 0))
        return jnp.concatenate([jnp.clip(q, low, high), jnp.where(into, 0.0, v)])

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        low, high = span.x[:, :n]
        return [
            {"lower": low + share * (high - low), "upper": high - share * (high - low)} for share in (0.03, 0.1, 0.25)
        ]

    def active(p: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        q = x[:, :n]
        return ((q >= p["upper"] - 1e-6) | (q <= p["lower"] + 1e-6)).any(-1)

    return arm_effect(
        n,
        "joint_limit",
        "stop",
        stopped,
        {
            "lower": Parameter("q_low", "rad", neutral=-INFINITE),
            "upper": Parameter("q_high", "rad", neutral=INFINITE),
        },
        title="End stop of a joint",
        equation="q_low ≤ q ≤ q_high, q̇ = 0 at the stop",
        cause="a joint meets a mechanical stop inside its known range",
        initial_guesses=initial_guesses,
        active=active,
    )


def home_offset(n: int) -> Effect:
    """The state holds what the encoders read, so that a record says where a run starts whatever the offset. Limits and
    stops are places of the encoders too."""
    return arm_effect(
        n,
        "home_offset",
        "position",
        lambda n, own, q, reading: q - n["offset"],
        {"offset": Parameter("b", "rad", bounds=(-np.pi, np.pi), neutral=0.0)},
        title="Zero of the encoders",
        equation="y = q + b",
        cause="the position at which an encoder reads zero is not the one of the description",
        acts_on="measurement",
    )
