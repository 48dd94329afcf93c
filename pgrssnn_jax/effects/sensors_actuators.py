"""Effects of sensors and actuators that any system may have.

    sensor     y ← y + b        y ← g y        y ← min(max(y, low), high)
    input      u ← u + b        u ← g u        u ← min(max(u, low), high)        u ← sign(u) max(|u| - w, 0)
    memory     u ← u(t - d)     u ← z,  z_t = z_{t-1} + (1 - e^{-dt/τ}) (u_t - z_{t-1})

One number per channel, in the channel's unit.
"""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Needs, SignalRange, counted, on_input, on_output, with_memory
from pgrssnn_jax.physics.base import Parameter, Physics, Signal

LONGEST_DELAY = 6  # samples that input_delay remembers
_INFINITE = float("inf")

Where = Literal["input", "measurement"]


def any_system_effects(physics: Physics) -> tuple[Effect, ...]:
    """The effects of this file for the signals of a physics; those of the inputs first. What is added later acts on an
    input earlier: it is late, then follows with a lag, and that is what a range or a dead zone bends, as in a pump."""
    return (
        input_offset(physics),
        input_gain(physics),
        input_dead_zone(physics),
        input_saturation(physics),
        input_lag(physics),
        input_delay(physics),
        sensor_offset(physics),
        sensor_gain(physics),
        sensor_saturation(physics),
    )


def _channels(where: Where, physics: Physics) -> Needs:
    """As many inputs or outputs as those that the effect has numbers for."""
    kind = "input" if where == "input" else "output"
    n = len(getattr(physics, f"{kind}s"))
    return Needs(counted(n, kind), lambda other: len(getattr(other, f"{kind}s")) == n)


def _remembered(physics: Physics) -> Needs:
    """The inputs that memory states are named after, in samples of the same length."""
    names, dt = [signal.name for signal in physics.inputs], physics.dt
    words = f"the input{'s' if len(names) > 1 else ''} {', '.join(names)} with dt={dt:g} s"
    return Needs(words, lambda other: [s.name for s in other.inputs] == names and other.dt == dt)


def _unit(signals: Sequence[Signal]) -> str:
    units = {signal.unit for signal in signals}
    return units.pop() if len(units) == 1 else ""


def _spread(span: np.ndarray, share: float) -> np.ndarray:
    """The value at a share of the way from the lowest to the highest."""
    return span[0] + share * (span[1] - span[0])


def _linear(
    where: Where, name: str, title: str, equation: str, cause: str, parameter: Parameter, change: Callable[..., Any]
) -> Callable[[Physics], Effect]:
    """An offset or a gain: two starting values about the neutral one."""

    def build(physics: Physics) -> Effect:
        signals = physics.inputs if where == "input" else physics.outputs
        (key,) = ("offset",) if parameter.neutral == 0.0 else ("gain",)
        meaning = parameter._replace(unit=_unit(signals) if key == "offset" else "")

        def initial_guesses(span: SignalRange) -> list[dict[str, np.ndarray]]:
            low, high = span.u if where == "input" else span.y
            size = 0.05 * (high - low) if key == "offset" else np.full(len(signals), 0.05)
            return [{key: parameter.neutral + size}, {key: parameter.neutral - size}]

        def wrap(inner: Physics) -> Physics:
            on = on_input if where == "input" else on_output
            return on(inner, name, lambda n, value: change(value, n[key]))

        return Effect(
            name,
            title=title,
            equation=equation,
            cause=cause,
            acts_on=where,
            parameters={key: meaning},
            initial_guesses=initial_guesses,
            wrap=wrap,
            needs=_channels(where, physics),
            shapes={key: (len(signals),)},
            channels="input" if where == "input" else "output",
        )

    return build


sensor_offset = _linear(
    "measurement",
    "sensor_offset",
    "Sensor offset",
    "y = y' + b",
    "the zero of the sensor has shifted",
    Parameter("b", neutral=0.0),
    lambda value, b: value + b,
)
sensor_gain = _linear(
    "measurement",
    "sensor_gain",
    "Sensor gain",
    "y = g y'",
    "the sensor is calibrated to another slope",
    Parameter("g", bounds=(0.05, 20.0), neutral=1.0),
    lambda value, g: g * value,
)
input_offset = _linear(
    "input",
    "input_offset",
    "Input offset",
    "u' = u + b",
    "what acts on the system differs from the recorded input by a constant",
    Parameter("b", neutral=0.0),
    lambda value, b: value + b,
)
input_gain = _linear(
    "input",
    "input_gain",
    "Input gain",
    "u' = g u",
    "the actuator is stronger or weaker than recorded",
    Parameter("g", bounds=(0.05, 20.0), neutral=1.0),
    lambda value, g: g * value,
)


def _saturation(where: Where, physics: Physics) -> Effect:
    signals = physics.inputs if where == "input" else physics.outputs
    name = f"{'input' if where == 'input' else 'sensor'}_saturation"
    n, unit = len(signals), _unit(signals)

    def initial_guesses(span: SignalRange) -> list[dict[str, np.ndarray]]:
        found = span.u if where == "input" else span.y
        none = np.full(n, _INFINITE)
        above = [{"low": -none, "high": _spread(found, share)} for share in (0.65, 0.8, 0.93)]
        below = [{"low": _spread(found, share), "high": none} for share in (0.07, 0.25)]
        return [*above, *below, {"low": _spread(found, 0.2), "high": _spread(found, 0.8)}]

    def wrap(inner: Physics) -> Physics:
        on = on_input if where == "input" else on_output
        return on(inner, name, lambda p, value: jnp.clip(value, p["low"], p["high"]))

    def active(p: Any, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        if where == "input":
            return ((u > p["high"]) | (u < p["low"])).any(-1)
        y = np.asarray(_measured(physics, x, u))
        return ((y > p["high"]) | (y < p["low"])).any(-1)

    v = "u" if where == "input" else "y"
    return Effect(
        name,
        title="Input saturation" if where == "input" else "End of the sensor's range",
        equation=f"{v}' = min(max(u, low), high)" if where == "input" else "y = min(max(y', low), high)",
        cause="the actuator cannot follow beyond its limits"
        if where == "input"
        else "the sensor cannot read beyond its range",
        acts_on=where,
        parameters={
            "low": Parameter(f"{v}_min", unit, neutral=-_INFINITE),
            "high": Parameter(f"{v}_max", unit, neutral=_INFINITE),
        },
        initial_guesses=initial_guesses,
        wrap=wrap,
        needs=_channels(where, physics),
        shapes={"low": (n,), "high": (n,)},
        active=active,
        channels="input" if where == "input" else "output",
    )


def _measured(physics: Physics, x: np.ndarray, u: np.ndarray) -> jax.Array:
    """Outputs `[time, y]` before the sensor's own effects; x may hold memory states behind those of the physics."""
    own = jnp.asarray(x[:, : len(physics.states)])
    return jax.vmap(physics.measure, (None, 0, 0))(physics.params, own, jnp.asarray(u))


def input_saturation(physics: Physics) -> Effect:
    return _saturation("input", physics)


def sensor_saturation(physics: Physics) -> Effect:
    return _saturation("measurement", physics)


def input_dead_zone(physics: Physics) -> Effect:
    n = len(physics.inputs)

    def initial_guesses(span: SignalRange) -> list[dict[str, np.ndarray]]:
        largest = np.abs(span.u).max(0)
        return [{"width": share * largest} for share in (0.08, 0.2, 0.4)]

    return Effect(
        "input_dead_zone",
        title="Input dead zone",
        equation="u' = sign(u) max(|u| - w, 0)",
        cause="a small input has no effect: friction in a valve, a pump that must first build up pressure",
        acts_on="input",
        parameters={"width": Parameter("w", _unit(physics.inputs), bounds=(0.0, _INFINITE), neutral=0.0)},
        initial_guesses=initial_guesses,
        wrap=lambda inner: on_input(
            inner, "input_dead_zone", lambda p, u: jnp.sign(u) * jnp.maximum(jnp.abs(u) - p["width"], 0.0)
        ),
        needs=_channels("input", physics),
        shapes={"width": (n,)},
        active=lambda p, x, u: (np.abs(u) < p["width"]).any(-1),
        channels="input",
    )


def _memory(physics: Physics, words: str, count: int) -> list[Signal]:
    """Memory states of every input, oldest last."""
    return [
        Signal(f"{signal.name}_{words}{i + 1 if count > 1 else ''}", signal.unit, memory_of=signal.name)
        for i in range(count)
        for signal in physics.inputs
    ]


def input_delay(physics: Physics) -> Effect:
    n, dt = len(physics.inputs), physics.dt

    def advance(p: Any, past: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Linear interpolation between the two samples about t - d."""
        kept = jnp.concatenate([u, past])
        samples = kept.reshape(LONGEST_DELAY + 1, n)
        lags = jnp.arange(LONGEST_DELAY + 1, dtype=u.dtype)
        weights = jnp.maximum(1.0 - jnp.abs(lags - p["delay"] / dt), 0.0)
        return (weights[:, None] * samples).sum(0), kept[: LONGEST_DELAY * n]

    return Effect(
        "input_delay",
        title="Input delay",
        equation="u'(t) = u(t - d)",
        cause="transport, communication or computation takes time",
        acts_on="input",
        parameters={"delay": Parameter("d", "s", bounds=(0.0, LONGEST_DELAY * dt), neutral=0.0)},
        initial_guesses=lambda span: [{"delay": np.asarray(k * dt)} for k in (0.5, 1.5, 2.5, 3.5, 5.0)],
        wrap=lambda inner: with_memory(inner, "input_delay", _memory(physics, "delayed_", LONGEST_DELAY), advance),
        needs=_remembered(physics),
    )


def input_lag(physics: Physics) -> Effect:
    dt, memory = physics.dt, _memory(physics, "lagged", 1)

    def advance(p: Any, past: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        """What acts is the mean over the sample: its value at the end would be half a sample ahead."""
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
        initial_guesses=lambda span: [{"time_constant": np.asarray(k * dt)} for k in (1.0, 3.0, 8.0)],
        wrap=lambda inner: with_memory(inner, "input_lag", [s._replace(fit_initial=True) for s in memory], advance),
        needs=_remembered(physics),
        simpler=("input_delay",),  # a lag below one sample is a delay
    )
