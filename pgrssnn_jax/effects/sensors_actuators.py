"""Effects of sensors and actuators that any system may have.

    sensor     y ← y + b        y ← g y        y ← min(max(y, low), high)
    input      u ← u + b        u ← g u        u ← min(max(u, low), high)        u ← sign(u) max(|u| - w, 0)
    memory     u ← u(t - d)     u ← z,  z_t = z_{t-1} + (1 - e^{-dt/τ}) (u_t - z_{t-1})

One number per channel, in the channel's unit; delays and time constants in s.
"""

from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Needs, Numbers, SignalRange, counted, on_input, on_output
from pgrssnn_jax.effects.characteristic import sensor_nonlinearity
from pgrssnn_jax.effects.delay import input_delay
from pgrssnn_jax.effects.memory import memory_signals, of_inputs, remembered_inputs, with_memory
from pgrssnn_jax.physics.base import Parameter, Physics, Signal
from pgrssnn_jax.physics.signals import unit_of_all

_INFINITE = float("inf")

Side = Literal["input", "output"]


def any_system_effects(physics: Physics) -> tuple[Effect, ...]:
    """The effects of this file for the signals of a physics; those of the inputs first. What is added later acts on an
    input earlier: it is late, then follows with a lag, and that is what a range or a dead zone bends, as in a pump."""
    return (
        offset(physics, "input", "what acts on the system differs from the recorded input by a constant"),
        gain(physics, "input", "the actuator is stronger or weaker than recorded"),
        input_dead_zone(physics),
        saturation(physics, "input", "Input saturation", "the actuator cannot follow beyond its limits"),
        input_lag(physics),
        input_delay(physics),
        sensor_nonlinearity(physics),
        offset(physics, "output", "the zero of the sensor has shifted"),
        gain(physics, "output", "the sensor is calibrated to another slope"),
        saturation(physics, "output", "End of the sensor's range", "the sensor cannot read beyond its range"),
    )


def _signals(physics: Physics, side: Side) -> tuple[Signal, ...]:
    return physics.inputs if side == "input" else physics.outputs


def _per_channel(
    physics: Physics, side: Side, what: str, law: str, change: Callable[..., Any], **fields: Any
) -> Effect:
    """u ← change(n, u) or y ← change(n, y), with one number of each parameter per channel. law: of u' or y, from `v`,
    the value as it was."""
    name = f"{'input' if side == 'input' else 'sensor'}_{what}"
    after, before = ("u'", "u") if side == "input" else ("y", "y'")
    on, n = on_input if side == "input" else on_output, len(_signals(physics, side))
    return Effect(
        name,
        equation=f"{after} = {law.format(v=before)}",
        acts_on="input" if side == "input" else "measurement",
        wrap=lambda inner: on(inner, name, change),
        needs=Needs(counted(n, side), lambda other: len(_signals(other, side)) == n),
        shapes=dict.fromkeys(fields["parameters"], (n,)),
        channels=side,
        **fields,
    )


def _spread(span: np.ndarray, share: float) -> np.ndarray:
    """The value at a share of the way from the lowest to the highest."""
    return span[0] + share * (span[1] - span[0])


def _span(span: SignalRange, side: Side) -> np.ndarray:
    return span.u if side == "input" else span.y


def offset(physics: Physics, side: Side, cause: str) -> Effect:
    def initial_guesses(span: SignalRange) -> list[Numbers]:
        low, high = _span(span, side)
        return [{"offset": share * (high - low)} for share in (0.05, -0.05)]

    return _per_channel(
        physics,
        side,
        "offset",
        "{v} + b",
        lambda n, value: value + n["offset"],
        title=f"{'Input' if side == 'input' else 'Sensor'} offset",
        cause=cause,
        parameters={"offset": Parameter("b", unit_of_all(_signals(physics, side)), neutral=0.0)},
        initial_guesses=initial_guesses,
    )


def gain(physics: Physics, side: Side, cause: str) -> Effect:
    n = len(_signals(physics, side))
    return _per_channel(
        physics,
        side,
        "gain",
        "g {v}",
        lambda n, value: n["gain"] * value,
        title=f"{'Input' if side == 'input' else 'Sensor'} gain",
        cause=cause,
        parameters={"gain": Parameter("g", bounds=(0.05, 20.0), neutral=1.0)},
        initial_guesses=lambda span: [{"gain": np.full(n, 1.0 + part)} for part in (0.05, -0.05)],
    )


def saturation(physics: Physics, side: Side, title: str, cause: str) -> Effect:
    signals, v = _signals(physics, side), "u" if side == "input" else "y"

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        found, none = _span(span, side), np.full(len(signals), _INFINITE)
        above = [{"low": -none, "high": _spread(found, share)} for share in (0.65, 0.8, 0.93)]
        below = [{"low": _spread(found, share), "high": none} for share in (0.07, 0.25)]
        return [*above, *below, {"low": _spread(found, 0.2), "high": _spread(found, 0.8)}]

    def active(n: Numbers, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        value = u
        if side == "output":  # before the sensor's own effects; x may hold memory states behind those of the physics
            own = jnp.asarray(x[:, : len(physics.states)])
            value = np.asarray(jax.vmap(physics.measure, (None, 0, 0))(physics.params, own, jnp.asarray(u)))
        return ((value > n["high"]) | (value < n["low"])).any(-1)

    return _per_channel(
        physics,
        side,
        "saturation",
        "min(max({v}, low), high)",
        lambda n, value: jnp.clip(value, n["low"], n["high"]),
        title=title,
        cause=cause,
        parameters={
            "low": Parameter(f"{v}_min", unit_of_all(signals), neutral=-_INFINITE),
            "high": Parameter(f"{v}_max", unit_of_all(signals), neutral=_INFINITE),
        },
        initial_guesses=initial_guesses,
        active=active,
    )


def _dead_zone(n: Any, u: jax.Array) -> jax.Array:
    """Beyond its edge, and at it, the derivative is 1: without a width of no input too."""
    width = n["width"]
    return jnp.where(u >= width, u - width, jnp.where(u <= -width, u + width, 0.0))


def input_dead_zone(physics: Physics) -> Effect:
    return _per_channel(
        physics,
        "input",
        "dead_zone",
        "sign({v}) max(|{v}| - w, 0)",
        _dead_zone,
        title="Input dead zone",
        cause="a small input has no effect: friction in a valve, a pump that must first build up pressure",
        parameters={"width": Parameter("w", unit_of_all(physics.inputs), bounds=(0.0, _INFINITE), neutral=0.0)},
        initial_guesses=lambda span: [{"width": share * np.abs(span.u).max(0)} for share in (0.08, 0.2, 0.4)],
        active=lambda n, x, u: (np.abs(u) < n["width"]).any(-1),
        simpler=("input_offset",),  # the same where the input keeps its sign and never enters the zone
    )


def input_lag(physics: Physics) -> Effect:
    n, dt = len(physics.inputs), physics.dt
    memory = [signal._replace(fit_initial=True) for signal in memory_signals(physics, "lagged", 1)]

    def advance(p: Any, past: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        """What moves the state is the mean over the sample: the value at its end would be half a sample ahead."""
        tau = p["time_constant"]
        slow = tau > 0.0
        samples = jnp.where(slow, tau, 1.0) / dt  # no 0/0 in the gradient at τ = 0
        kept = jnp.where(slow, jnp.exp(-1.0 / samples), 0.0)
        mean = jnp.where(slow, samples * (1.0 - kept), 0.0)
        return u + mean * (past - u), u + kept * (past - u)

    return Effect(
        "input_lag",
        title="Actuator lag",
        equation="τ dz/dt = u - z, u' = z",
        cause="the actuator follows its command with a first-order lag",
        acts_on="input",
        parameters={"time_constant": Parameter("τ", "s", bounds=(0.0, 50.0 * dt), neutral=0.0)},
        shapes={"time_constant": of_inputs(n)},
        channels="input" if n > 1 else "",
        initial_guesses=lambda span: [{"time_constant": np.full(of_inputs(n), k * dt)} for k in (1.0, 3.0, 8.0)],
        wrap=lambda inner: with_memory(inner, "input_lag", memory, advance, lambda p, past, u: advance(p, past, u)[1]),
        needs=remembered_inputs(physics),
        simpler=("input_delay",),  # a lag below one sample is a delay
    )
