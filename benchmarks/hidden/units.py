"""The same case in other units: every signal times a power of ten, and the physics by conjugation.

    u' = c_u u,  y' = c_y y,  x' = c_x x,  p' = c_p p        step'(p', x', u') = c_x step(p' / c_p, x' / c_x, u' / c_u)

c_x = c_y for states that are like an output or its rate, else 1. c_p = c_u^a c_y^b by the dimension of a parameter, so
that what effects make of it is in the new units too. Time stays in s. Units are not said any more: no name of one tells
what was done.
"""

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from pgrssnn_jax.physics.base import Parameter, Physics, Signal, extended, extension_of, is_parameter, measured_rate
from pgrssnn_jax.physics.integrate import DerivativePoints
from pgrssnn_jax.records.record import Channel, Record

from .case import SYSTEMS, Case

_LARGEST = 6  # power of ten
# exponents of the units of input and output in that of a parameter
_DIMENSIONS: dict[str, dict[str, tuple[float, float]]] = {
    "tanks": {"k1": (0, 0.5), "k3": (-1, 1), "k4": (0, 0.5)},
    "lgssm": {"B": (-1, 0), "C": (0, 1)},
    "servo": dict.fromkeys("mf", (1, -1)),
    "duffing": dict.fromkeys("mck", (1, -1)),
    "chain": dict.fromkeys(("r1", "r2", "r3", "r4", "r5"), (0, 0.5)),
    "hysteretic": dict.fromkeys("mck", (1, -1)),
    "drive": dict.fromkeys(("j1", "j2", "k", "d", "f"), (1, -1)),
    "circuit": {"L": (0, 1), "C": (0, -1)},  # of a current that is in A
    "reactor": {"E": (0, 1), "b": (0, 1)},  # in K, as the reading
}
Units = tuple[float, float]


def drawn(system: str, seed: int) -> Units:
    """c_u and c_y."""
    rng = np.random.default_rng([seed, SYSTEMS.index(system), _LARGEST])
    u, y = rng.integers(-_LARGEST, _LARGEST + 1, 2)
    return 10.0 ** float(u), 10.0 ** float(y)


def parameter_factor(system: str, name: str, units: Units) -> float:
    a, b = _DIMENSIONS.get(system, {}).get(name, (0, 0))
    return units[0] ** a * units[1] ** b


def case_in(case: Case, units: Units) -> Case:
    """Magnitudes stay in the units of the simulator."""
    train, test = (_record_in(one, units) for one in (case.train, case.test))
    sizes = {name: getattr(case, name) * units[1] for name in ("noise", "floor", "change")}
    return case._replace(train=train, test=test, units=units, **sizes)


def _record_in(record: Record, units: Units) -> Record:
    info = replace(
        record.info,
        inputs=tuple(Channel(one.name) for one in record.info.inputs),
        outputs=tuple(Channel(one.name) for one in record.info.outputs),
    )
    return record._replace(u=record.u * units[0], y=record.y * units[1], info=info)


def physics_in(physics: Physics, system: str, units: Units) -> Physics:
    own = {name: parameter_factor(system, name, units) for name in physics.params}
    of_x = np.array([units[1] if _like_output(physics, state) else 1.0 for state in physics.states])

    def back(p: Any) -> dict[str, Any]:
        return {name: p[name] / factor for name, factor in own.items()}

    def dynamics(function: Any) -> Any:
        return lambda p, x, u: function(back(p), x / of_x, u / units[0]) * of_x

    def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return physics.measure(back(p), x / of_x, u / units[0]) * units[1]

    def meaning(parameter: Parameter, factor: float) -> Parameter:
        low, high = parameter.bounds
        return parameter._replace(unit="", bounds=(low * factor, high * factor))

    meanings = {
        name: jax.tree.map(lambda one, f=factor: meaning(one, f), physics.parameters[name], is_leaf=is_parameter)
        for name, factor in own.items()
    }
    found = physics._replace(
        step=dynamics(physics.step),
        measure=measure,
        params={name: np.asarray(physics.params[name], float) * factor for name, factor in own.items()},
        parameters=meanings,
        states=tuple(_signal_in(one, c) for one, c in zip(physics.states, of_x, strict=True)),
        inputs=tuple(_signal_in(one, units[0]) for one in physics.inputs),
        outputs=tuple(_signal_in(one, units[1]) for one in physics.outputs),
        origin=None,
        extension=None,
    )
    known = extension_of(physics)
    if known is None or not isinstance(known.points, DerivativePoints):
        return found
    points = known.points

    def advance(p: Any, field: Any, x: jax.Array, u: jax.Array) -> jax.Array:
        return points.advance(back(p), lambda state: field(state * of_x) / of_x, x / of_x, u / units[0]) * of_x

    inside = points._replace(derivative=dynamics(points.derivative), advance=advance, measure=measure)
    return extended(found, inside, known.assemble)


def _like_output(physics: Physics, state: Signal) -> bool:
    return state.like is not None or measured_rate(physics, state) is not None


def _signal_in(signal: Signal, factor: float) -> Signal:
    low, high = signal.range
    start = None if signal.start is None else signal.start * factor
    return signal._replace(unit="", range=(low * factor, high * factor), start=start)
