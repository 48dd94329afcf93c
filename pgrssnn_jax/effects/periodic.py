"""Periodic disturbances that no signal records: beside an input, or in the reading of a sensor.

    φ_t = φ_{t-1} + 2π f dt  mod 2π
    input     u'_t = u_t + a sin(φ_t - π f dt) sin(π f dt) / (π f dt)        the mean of u + a sin(φ) over the sample
    sensor    y_t = y'_t + a sin(φ)                                          at the time of the reading

One amplitude a and one phase φ per channel, one frequency f for all. The phases are states: every record begins at its
own. Of a linear system both say the same. The disturbance of the input is preferred, unless it would be larger than all
that the input does.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Needs, Numbers, SignalRange, counted
from pgrssnn_jax.effects.memory import remembered_inputs, with_memory
from pgrssnn_jax.physics.base import Parameter, Physics, Signal
from pgrssnn_jax.physics.signals import unit_of_all

_TURN = 2.0 * np.pi
_PHASES = (0.0, _TURN / 3.0, 2.0 * _TURN / 3.0)  # rad: one is within 60° of any phase, from where its fit finds it
_SIZES = (0.02, 0.2)  # of the range of the signal


def periodic_disturbance(physics: Physics) -> Effect:
    name, dt = "periodic_disturbance", physics.dt
    phases = _phases(physics.inputs)

    def advance(n: Any, phase: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        half = 0.5 * _TURN * dt * n["frequency"]
        turns = half > 0.0
        mean = jnp.where(turns, jnp.sin(half) / jnp.where(turns, half, 1.0), 1.0)
        return u + n["amplitude"] * mean * jnp.sin(phase + half), _turned(phase, 2.0 * half)

    return Effect(
        name,
        _meanings(physics.inputs, dt),
        lambda inner: with_memory(inner, name, phases, advance),
        title="Periodic disturbance",
        equation="u' = u + a sin(2π f t + φ)",
        cause="something turns or swings beside the input: an unbalance, a pulsating supply, a rippling torque",
        acts_on="input",
        shapes={"amplitude": (len(phases),)},
        initial_guesses=lambda span: _guesses(span, span.u),
        needs=remembered_inputs(physics),
        channels="input",
        elaborate=True,
        memory_guesses={phase.name: _PHASES for phase in phases},
        credible=lambda n, span: bool(np.all(n["amplitude"] <= np.ptp(span.u, axis=0))),
    )


def periodic_sensor_error(physics: Physics) -> Effect:
    name, dt, n_y = "periodic_sensor_error", physics.dt, len(physics.outputs)
    phases = _phases(physics.outputs)

    def wrap(inner: Physics) -> Physics:
        n = len(inner.states)

        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            angle = _TURN * dt * p.effects[name]["frequency"]
            return jnp.concatenate([inner.step(p, x[:n], u), _turned(x[n:], angle)])

        def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            return inner.measure(p, x[:n], u) + p.effects[name]["amplitude"] * jnp.sin(x[n : n + n_y])

        return inner._replace(step=step, measure=measure, states=(*inner.states, *phases))

    return Effect(
        name,
        _meanings(physics.outputs, dt),
        wrap,
        title="Periodic error of the sensor",
        equation="y = y' + a sin(2π f t + φ)",
        cause="the reading picks up a hum: mains, an unbalance under the sensor",
        acts_on="measurement",
        shapes={"amplitude": (n_y,)},
        initial_guesses=lambda span: _guesses(span, span.y),
        needs=Needs(
            f"{counted(n_y, 'output')} and dt={dt:g} s", lambda other: len(other.outputs) == n_y and other.dt == dt
        ),
        simpler=("periodic_disturbance",),
        channels="output",
        elaborate=True,
        memory_guesses={phase.name: _PHASES for phase in phases},
    )


def _phases(channels: tuple[Signal, ...]) -> list[Signal]:
    return [Signal(f"{one.name}_phase", "rad", start=0.0, fit_initial=True, inner=True) for one in channels]


def _turned(phase: jax.Array, angle: jax.Array) -> jax.Array:
    """Within one turn: in single precision a growing angle would lose its digits."""
    phase = phase + angle
    return phase - _TURN * jnp.floor(phase / _TURN)


def _meanings(channels: tuple[Signal, ...], dt: float) -> dict[str, Parameter]:
    return {
        "amplitude": Parameter("a", unit_of_all(channels), bounds=(0.0, float("inf")), neutral=0.0),
        "frequency": Parameter("f", "Hz", bounds=(0.0, 0.5 / dt), neutral=0.0),
    }


def _guesses(span: SignalRange, ends: np.ndarray) -> list[Numbers]:
    """None where the errors have no line."""
    sizes = [share * np.ptp(ends, axis=0) for share in _SIZES]
    return [{"amplitude": size, "frequency": np.asarray(one)} for one in span.lines for size in sizes]
