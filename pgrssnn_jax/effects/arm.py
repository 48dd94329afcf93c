"""Effects that a model of a robot arm may lack. Joints in rad, rad/s and Nm; the equations stand where they act:

    torques      `pgrssnn_jax.physics.arms.torques`: friction, bias, gain, counterbalance, coupling of the wrist
    masses       `pgrssnn_jax.physics.arms.changed`: payload, motor inertia, direction of gravity
    after a step `pgrssnn_jax.physics.arms.stops`: end stops, stiction;  q̇_t ← q̇_t + S q̇_{t-1} in `arm.py`
    measurement  y = q + b, where the state is y

An arm looks for the numbers of an effect by its name, so adding one is putting its numbers there; only the zero of the
encoders is changed from outside. Numbers are per joint unless said otherwise. Friction here is beside the known one.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Numbers, SignalRange
from pgrssnn_jax.physics.base import Parameter, Physics

_INFINITE = float("inf")
_PUSH = 0.05  # of the largest motor torque: where a fit of friction begins
_WRIST = 6  # joints of an arm whose last three are a wrist

InitialGuesses = Callable[[SignalRange], Sequence[Numbers]]


def arm_effects(physics: Physics) -> tuple[Effect, ...]:
    """The effects of an arm of any number of joints, but for those whose numbers the physics already knows: S and θ.

    The moving masses of an arm on Pinocchio are its own: its step raises `ValueError` with an effect on these.
    """
    known = {"S": "velocity_disturbance", "theta": "torque_bias"}
    left_out = {name for symbol, name in known.items() if symbol in physics.params}
    n, gear = len(physics.inputs), np.abs(np.asarray(physics.params["G"], np.float64))
    found = (
        torque_gain(n),
        *((wrist_coupling(),) if n == _WRIST else ()),
        torque_bias(n),
        gravity_counterbalance(n, gear),
        viscous_friction(n),
        coulomb_friction(n),
        stribeck_friction(n),
        payload(),
        rotor_inertia(n),
        gravity_direction(),
        joint_limit(n),
        stiction(n),
        velocity_disturbance(n),
        home_offset(n),
    )
    return tuple(effect for effect in found if effect.name not in left_out)


def _at_neutral(parameters: Mapping[str, Parameter], n: int) -> InitialGuesses:
    """Where the torque is linear in the numbers, a fit may begin at none."""
    return lambda span: [{name: np.full(n, p.neutral, np.float64) for name, p in parameters.items()}]


def _inside(physics: Physics) -> Physics:
    return physics


def _largest(span: np.ndarray, first: int = 0) -> np.ndarray:
    return np.maximum(np.abs(span[:, first:]).max(0), 1e-12)


def torque_gain(n: int) -> Effect:
    parameters = {"gain": Parameter("g", "", bounds=(0.05, 20.0), neutral=1.0)}
    return Effect(
        "torque_gain",
        "Gain of the motor torque",
        "τ = g G u",
        "a motor delivers more or less torque than its current says, or the gear loses some of it",
        "input",
        parameters,
        _at_neutral(parameters, n),
        _inside,
        {"gain": (n,)},
        channels="joint",
    )


def wrist_coupling() -> Effect:
    names = ("c45", "c46", "c56")
    return Effect(
        "wrist_coupling",
        "Coupling of the wrist's motors",
        "τ4 += c45 G5 u5 + c46 G6 u6,  τ5 += c56 G6 u6",
        "the drives of the last joints run through the wrist, and their torque turns the joints before as well",
        "input",
        {name: Parameter(name, "", bounds=(-2.0, 2.0), neutral=0.0) for name in names},
        lambda span: [{name: np.zeros(()) for name in names}],
        _inside,
    )


def torque_bias(n: int) -> Effect:
    parameters = {"theta": Parameter("θ", "Nm", neutral=0.0)}
    return Effect(
        "torque_bias",
        "Constant torque",
        "τ = G u + θ",
        "a constant torque on the link side that the motors do not deliver",
        "dynamics",
        parameters,
        _at_neutral(parameters, n),
        _inside,
        {"theta": (n,)},
        channels="joint",
    )


def gravity_counterbalance(n: int, gear: np.ndarray) -> Effect:
    """gear: its size gives the fit a torque to begin with."""
    joint = min(1, n - 1)

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        moment = 0.2 * gear[joint] * _largest(span.u)[joint]
        return [{"moment": np.asarray(moment), "angle": np.asarray(k * np.pi / 2)} for k in (0, 1, 2, -1)]

    return Effect(
        "gravity_counterbalance",
        "Counterbalance of the second joint",
        "τ2 = ... - k sin(q2 - φ)",
        "a spring or a weight bears part of the arm's weight at the second joint",
        "dynamics",
        {
            "moment": Parameter("k", "Nm", bounds=(0.0, _INFINITE), neutral=0.0),
            "angle": Parameter("φ", "rad", neutral=0.0),
        },
        initial_guesses,
        _inside,
    )


def viscous_friction(n: int) -> Effect:
    parameters = {"B": Parameter("B", "Nm s", bounds=(0.0, _INFINITE), neutral=0.0)}
    return Effect(
        "viscous_friction",
        "More viscous friction",
        "τ = ... - G² B q̇",
        "lubricant and seals brake a joint in proportion to its speed, beyond what is known",
        "dynamics",
        parameters,
        _at_neutral(parameters, n),
        _inside,
        {"B": (n,)},
        channels="joint",
    )


def coulomb_friction(n: int) -> Effect:
    parameters = {"Tc": Parameter("Tc", "Nm", bounds=(0.0, _INFINITE), neutral=0.0)}
    return Effect(
        "coulomb_friction",
        "More Coulomb friction",
        "τ = ... - |G| Tc tanh(q̇ / 0.02 rad/s)",
        "dry friction brakes a joint at any speed, beyond what is known",
        "dynamics",
        parameters,
        _at_neutral(parameters, n),
        _inside,
        {"Tc": (n,)},
        channels="joint",
    )


def stribeck_friction(n: int) -> Effect:
    """One speed for all joints: it is poorly told by one joint alone."""

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        fastest = float(_largest(span.x, n)[:n].max())
        return [{"torque": _PUSH * _largest(span.u)[:n], "speed": np.asarray(s * fastest)} for s in (0.03, 0.1, 0.3)]

    return Effect(
        "stribeck_friction",
        "Stribeck friction",
        "τ = ... - |G| Ts exp(-(q̇ / v_s)²) tanh(q̇ / 0.02 rad/s)",
        "a joint that starts to turn is braked more than one whose lubricant has built up a film",
        "dynamics",
        {
            "torque": Parameter("Ts", "Nm", bounds=(0.0, _INFINITE), neutral=0.0),
            "speed": Parameter("v_s", "rad/s", bounds=(1e-3, _INFINITE), neutral=0.1),
        },
        initial_guesses,
        _inside,
        {"torque": (n,)},
        active=lambda p, x, u: (np.abs(x[:, n : 2 * n]) < 2 * p["speed"]).any(-1),
        simpler=("coulomb_friction",),
        channels="joint",
    )


def payload() -> Effect:
    """From the last link's tip; a mass at a wrong distance would look like another mass and no inertia."""
    return Effect(
        "payload",
        "Payload",
        "m at d from the tip along the last joint's axis",
        "the arm carries a load that its description does not have",
        "dynamics",
        {
            "mass": Parameter("m", "kg", bounds=(0.0, _INFINITE), neutral=0.0),
            "distance": Parameter("d", "m", bounds=(-2.0, 2.0), neutral=0.0),
        },
        lambda span: [{"mass": np.asarray(1.0), "distance": np.asarray(d)} for d in (0.1, 0.4)],
        _inside,
    )


def rotor_inertia(n: int) -> Effect:
    parameters = {"J": Parameter("J", "kg m^2", bounds=(0.0, _INFINITE), neutral=0.0)}
    return Effect(
        "rotor_inertia",
        "More motor inertia",
        "M(q) + diag(J G²)",
        "rotor, brake or gear turn with the motor and weigh more than known",
        "dynamics",
        parameters,
        _at_neutral(parameters, n),
        _inside,
        {"J": (n,)},
        channels="joint",
    )


def gravity_direction() -> Effect:
    names = ("about_x", "about_y")
    return Effect(
        "gravity_direction",
        "Tilted base",
        "g' = (Ry(β) Rx(α))ᵀ g",
        "the base of the arm does not stand upright",
        "dynamics",
        {
            name: Parameter(symbol, "rad", bounds=(-np.pi, np.pi), neutral=0.0)
            for name, symbol in zip(names, ("α", "β"), strict=True)
        },
        lambda span: [{name: np.zeros(()) for name in names}],
        _inside,
    )


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
        "End stop of a joint",
        "q_low ≤ q ≤ q_high, q̇ = 0 at the stop",
        "a joint meets a mechanical stop inside its known range",
        "dynamics",
        {
            "lower": Parameter("q_low", "rad", neutral=-_INFINITE),
            "upper": Parameter("q_high", "rad", neutral=_INFINITE),
        },
        initial_guesses,
        _inside,
        {"lower": (n,), "upper": (n,)},
        active=active,
        channels="joint",
    )


def stiction(n: int) -> Effect:
    def initial_guesses(span: SignalRange) -> list[Numbers]:
        return [{"speed": share * _largest(span.x, n)[:n]} for share in (0.02, 0.1)]

    return Effect(
        "stiction",
        "Stiction",
        "q̇ = q̇' (1 - exp(-(q̇' / v_s)²))",
        "a joint that stands still is held until the torque breaks it loose",
        "dynamics",
        {"speed": Parameter("v_s", "rad/s", bounds=(0.0, _INFINITE), neutral=0.0)},
        initial_guesses,
        _inside,
        {"speed": (n,)},
        active=lambda p, x, u: (np.abs(x[:, n : 2 * n]) < p["speed"]).any(-1),
        channels="joint",
    )


def velocity_disturbance(n: int) -> Effect:
    parameters = {"S": Parameter("S", "", bounds=(-1.0, 1.0), neutral=0.0)}
    return Effect(
        "velocity_disturbance",
        "Disturbance of the velocities",
        "q̇_t = q̇'_t + S q̇_{t-1}",
        "a joint keeps or loses a part of its speed in every sample, beyond what its masses and friction say",
        "dynamics",
        parameters,
        _at_neutral(parameters, n),
        _inside,
        {"S": (n,)},
        channels="joint",
    )


def home_offset(n: int) -> Effect:
    """The state holds what the encoders read, so that a record says where a run starts whatever the offset."""
    name, parameters = "home_offset", {"offset": Parameter("b", "rad", bounds=(-np.pi, np.pi), neutral=0.0)}

    def wrap(physics: Physics) -> Physics:
        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            shift = jnp.zeros_like(x).at[:n].set(jnp.asarray(p[name]["offset"], x.dtype))
            return physics.step(p, x - shift, u) + shift

        return physics._replace(step=step)

    return Effect(
        name,
        "Zero of the encoders",
        "y = q + b",
        "the position at which an encoder reads zero is not the one of the description",
        "measurement",
        parameters,
        _at_neutral(parameters, n),
        wrap,
        {"offset": (n,)},
        channels="joint",
    )
