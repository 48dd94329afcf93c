"""Effects that a model of two cascaded tanks may lack. Levels x1, x2 and the pump voltage u in V, time in s.

    overflow     x1 > L: the excess leaves the upper tank; a share α of it lands in the lower one
    pump         u ← max(u - u0, 0)      u ← min(u, u_max)      u ← u (1 + c u / 10 V + d (u / 10 V)²)
    leak         dx1/dt ← dx1/dt - r x1
    bypass       dx1/dt ← dx1/dt - β k3 u,   dx2/dt ← dx2/dt + β k3 u
    outlet       k4 √x2 ← k4 x2^γ

Flows that an effect adds act once per sample, at the mean of the levels before and after it, less what the levels that
they change let out in the meantime (errors of second order).
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.effects.base import Effect, Needs, Numbers, SignalRange, after_step, on_input, own_of
from pgrssnn_jax.physics.base import Parameter, Physics
from pgrssnn_jax.physics.tanks import safe_sqrt

_INFINITE = float("inf")
_FULL_SCALE = 10.0  # V
_MEETS = 3.0  # V, where a power law and a straight line let the same flow through; the pump gain takes up any other
_SMALL = 1e-3  # of that voltage


def tank_effects(physics: Physics) -> tuple[Effect, ...]:
    """Flows first, limits of the levels after them, then what happens to the input."""
    return (
        leak_tank1(physics.dt),
        bypass(physics.dt),
        outlet_exponent(physics.dt),
        overflow_1to2(physics.dt),
        overflow_lost(physics.dt),
        tank2_overflow(),
        *pump_effects(),
    )


def _tanks(dt: float | None = None) -> Needs:
    """dt: sample time of the steps that the effect adds flows to, s."""
    words = "two cascaded tanks with k1 to k5, one pump" + ("" if dt is None else f" and dt={dt:g} s")

    def met(physics: Physics) -> bool:
        own = own_of(physics.params)
        known = {"k1", "k2", "k3", "k4", "k5"} <= set(own) and len(physics.states) >= 2
        return known and len(physics.inputs) == 1 and dt in (None, physics.dt)

    return Needs(words, met)


def _between(x: jax.Array, new: jax.Array) -> jax.Array:
    return jnp.maximum(0.5 * (x + new), 0.0)


def _slope(k: Any, level: jax.Array, linear: Any) -> jax.Array:
    """d/dx of the flow k √x - c x, 1/s; zero for an empty tank."""
    wet = level > 0.0
    return jnp.where(wet, 0.5 * k / jnp.sqrt(jnp.where(wet, level, 1.0)) - linear, 0.0)


def _kept(dt: float, slope: jax.Array) -> jax.Array:
    """What is left at the end of a step of a flow that came in during it: the level that it has raised, on average by
    half of it, lets out more."""
    return 1.0 - 0.5 * dt * jnp.clip(slope, 0.0, 1.0 / dt)


def _shares(name: str, signal: str, index: int, shares: Sequence[float]) -> Callable[[SignalRange], list[Numbers]]:
    """Initial guesses inside the range of one signal."""

    def initial_guesses(span: SignalRange) -> list[Numbers]:
        low, high = getattr(span, signal)[:, index]
        return [{name: np.asarray(low + share * (high - low))} for share in shares]

    return initial_guesses


def _spilled(own: Any, level: Any, x: jax.Array, new: jax.Array, dt: float) -> tuple[jax.Array, jax.Array]:
    """What runs over the rim in one step, and what the step let through the drain because the level stood above the rim
    in the meantime: dt f (q(L + e/2) - q(L)), f the share of the step above the rim, e the height reached."""
    over = jnp.maximum(new[0] - level, 0.0)
    spills = over > 0.0
    rim, rise = jnp.where(spills, level, 1.0), jnp.where(spills, jnp.maximum(new[0] - x[0], over), 1.0)
    half = rim + 0.5 * over
    through = own["k1"] * (safe_sqrt(half) - safe_sqrt(rim)) - own["k2"] * (half - rim)
    extra = jnp.where(spills, dt * over / rise * through, 0.0)
    return over + extra, extra


def _rim(name: str, tank: int, change: Callable[..., jax.Array], shares: Sequence[float], **fields: Any) -> Effect:
    """An overflow of tank 0 or 1; shares: of the range of its level, where fits look for the rim."""
    return Effect(
        name,
        {"level": Parameter("L", "V", bounds=(0.0, _INFINITE), neutral=_INFINITE)},
        lambda physics: after_step(physics, name, change),
        initial_guesses=_shares("level", "x", tank, shares),
        active=lambda n, x, u: x[:, tank] >= n["level"] - 1e-6,
        **fields,
    )


def overflow_1to2(dt: float) -> Effect:
    def change(n: Any, own: Any, x: jax.Array, u: jax.Array, new: jax.Array) -> jax.Array:
        spilled, extra = _spilled(own, n["level"], x, new, dt)
        return new.at[0].add(extra - spilled).at[1].add(n["share"] * spilled - extra)

    effect = _rim(
        "overflow_1to2",
        0,
        change,
        (0.55, 0.75, 0.9),
        needs=_tanks(dt),
        title="Overflow of the upper tank into the lower",
        equation="x1 ≤ L; x2 gains α times what spills",
        cause="the upper tank runs over its rim, and part of the water falls into the lower tank",
        simpler=("overflow_lost",),
    )
    levels = effect.guesses
    share = Parameter("α", "", bounds=(0.0, 1.0), neutral=1.0)
    return effect._replace(
        parameters={**effect.parameters, "share": share},
        initial_guesses=lambda span: [{**start, "share": np.asarray(0.7)} for start in levels(span)],
    )


def overflow_lost(dt: float) -> Effect:
    def change(n: Any, own: Any, x: jax.Array, u: jax.Array, new: jax.Array) -> jax.Array:
        spilled, extra = _spilled(own, n["level"], x, new, dt)
        return new.at[0].add(extra - spilled).at[1].add(-extra)

    return _rim(
        "overflow_lost",
        0,
        change,
        (0.55, 0.75, 0.9),
        needs=_tanks(dt),
        title="Overflow of the upper tank, lost",
        equation="x1 ≤ L",
        cause="the upper tank runs over its rim, and the water leaves the system",
    )


def tank2_overflow() -> Effect:
    return _rim(
        "tank2_overflow",
        1,
        lambda n, own, x, u, new: new.at[1].set(jnp.minimum(new[1], n["level"])),
        (0.65, 0.8, 0.93),
        needs=_tanks(),
        title="Overflow of the lower tank",
        equation="x2 ≤ L",
        cause="the lower tank runs over its rim",
    )


def pump_effects() -> tuple[Effect, ...]:
    """A negative voltage, which no pump of this kind has, meets no dead zone."""

    def effect(name: str, change: Callable[[Any, jax.Array], jax.Array], **fields: Any) -> Effect:
        return Effect(
            name, wrap=lambda physics: on_input(physics, name, change), needs=_tanks(), acts_on="input", **fields
        )

    def curved(n: Any, u: jax.Array) -> jax.Array:
        power = ((u / _MEETS) ** 2 + _SMALL**2) ** (0.5 * (n["exponent"] - 1.0))  # without the kink of |u| at zero
        return u * (1.0 + n["curvature"] * u / _FULL_SCALE) * power

    return (
        effect(
            "pump_nonlinearity",
            curved,
            title="Curved pump characteristic",
            equation="u' = u (1 + c u / 10 V) (|u| / 3 V)^(n - 1)",
            cause="the flow of the pump is not proportional to its voltage",
            parameters={
                "curvature": Parameter("c", "", bounds=(-5.0, 5.0), neutral=0.0),
                "exponent": Parameter("n", "", bounds=(0.3, 3.0), neutral=1.0),
            },
            initial_guesses=lambda span: [
                {"curvature": np.asarray(c), "exponent": np.asarray(1.0)} for c in (-0.3, 0.3)
            ],
        ),
        effect(
            "pump_dead_zone",
            lambda n, u: jnp.where(u > 0.0, jnp.maximum(u - n["voltage"], 0.0), u),
            title="Dead zone of the pump",
            equation="u' = max(u - u0, 0)",
            cause="the pump moves no water until its voltage has overcome friction and head",
            parameters={"voltage": Parameter("u0", "V", bounds=(0.0, _INFINITE), neutral=0.0)},
            initial_guesses=_shares("voltage", "u", 0, (0.1, 0.25, 0.45)),
            active=lambda n, x, u: u[:, 0] < n["voltage"],
        ),
        effect(
            "pump_saturation",
            lambda n, u: jnp.minimum(u, n["voltage"]),
            title="Saturation of the pump",
            equation="u' = min(u, u_max)",
            cause="the pump delivers no more above some voltage",
            parameters={"voltage": Parameter("u_max", "V", bounds=(0.0, _INFINITE), neutral=_INFINITE)},
            initial_guesses=_shares("voltage", "u", 0, (0.55, 0.7, 0.85)),
            active=lambda n, x, u: u[:, 0] > n["voltage"],
        ),
    )


def leak_tank1(dt: float) -> Effect:
    name = "leak_tank1"

    def change(n: Any, own: Any, x: jax.Array, u: jax.Array, new: jax.Array) -> jax.Array:
        level, rate = _between(x, new)[0], n["rate"]
        drain = _slope(own["k1"], level, own["k2"])
        lost = dt * rate * level
        less = (1.0 - _kept(dt, drain)) * lost  # that a lower level lets into the lower tank
        return new.at[0].add(-lost * _kept(dt, drain + rate)).at[1].add(-less)

    return Effect(
        name,
        needs=_tanks(dt),
        title="Leak of the upper tank",
        equation="dx1/dt = ... - r x1",
        cause="the upper tank loses water that does not reach the lower one",
        parameters={"rate": Parameter("r", "1/s", bounds=(0.0, 0.1), neutral=0.0)},
        initial_guesses=lambda span: [{"rate": np.asarray(r)} for r in (0.001, 0.005)],
        wrap=lambda physics: after_step(physics, name, change),
    )


def bypass(dt: float) -> Effect:
    name = "bypass"

    def wrap(physics: Physics) -> Physics:
        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            share, own = p.effects[name]["share"], p.own
            new = physics.step(p, x, (1.0 - share) * u)
            gain = dt * share * own["k3"] * u[0]
            return new.at[1].add(gain * _kept(dt, _slope(own["k4"], x[1], own["k5"])))

        return physics._replace(step=step)

    return Effect(
        name,
        needs=_tanks(dt),
        title="Bypass of the upper tank",
        equation="a share β of k3 u flows into the lower tank",
        cause="part of the pump's flow misses the upper tank",
        parameters={"share": Parameter("β", "", bounds=(0.0, 1.0), neutral=0.0)},
        initial_guesses=lambda span: [{"share": np.asarray(s)} for s in (0.05, 0.25)],
        wrap=wrap,
    )


def outlet_exponent(dt: float) -> Effect:
    name = "outlet_exponent"

    def change(n: Any, own: Any, x: jax.Array, u: jax.Array, new: jax.Array) -> jax.Array:
        level = _between(x, new)[1]
        wet = level > 0.0
        exponent, above = n["exponent"], jnp.where(wet, level, 1.0)  # no power of zero in the gradient
        root, power = jnp.sqrt(above), above ** (exponent - 0.5)
        slope = exponent * own["k4"] * power / root - own["k5"]
        return new.at[1].add(-dt * jnp.where(wet, own["k4"] * root * (power - 1.0) * _kept(dt, slope), 0.0))

    return Effect(
        name,
        needs=_tanks(dt),
        title="Outlet that is no sharp orifice",
        equation="outflow k4 x2^γ",
        cause="the outlet of the lower tank has a tube, or its flow is partly laminar",
        parameters={"exponent": Parameter("γ", "", bounds=(0.1, 1.5), neutral=0.5)},
        initial_guesses=lambda span: [{"exponent": np.asarray(g)} for g in (0.4, 0.65)],
        wrap=lambda physics: after_step(physics, name, change),
    )
