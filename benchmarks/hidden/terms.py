"""What a sparse regression may put into an equation, and which hidden effect each of these terms stands for.

    φ(z): 1, z_i, z_i z_j, z_i z_j z_k; sign(z) and |z| z where z changes its sign, sqrt(z) where it does not

z: the signals that the equation has, its own state, the integral of that state, and all inputs. In which equation a
term stands is not asked, and several effects share a term: whatever it may stand for counts.
"""

from collections.abc import Callable
from functools import partial, reduce
from itertools import combinations_with_replacement
from operator import mul
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.physics.base import Physics, extension_of

_INPUT = ("input_saturation", "input_dead_zone", "pump_saturation", "pump_dead_zone", "pump_nonlinearity")
_LEVEL = ("overflow_1to2", "overflow_lost", "tank2_overflow", "power_law", "outlet_exponent")
# Hidden effects that a term stands for, by the role of its signal and its shape; a product stands for none.
MEANING: dict[tuple[str, str], tuple[str, ...]] = {
    ("", "1"): ("input_offset", "constant_force", "inflow"),
    ("input", "z"): ("input_gain", "bypass"),
    **{("input", shape): _INPUT for shape in ("z^2", "z^3", "|z|z", "sign(z)", "sqrt(z)")},
    ("rate", "z"): ("viscous_friction",),
    ("rate", "sign(z)"): ("coulomb_friction", "stribeck_friction"),
    ("rate", "|z|z"): ("quadratic_drag",),
    ("rate", "z^3"): ("quadratic_drag",),
    ("position", "z"): ("linear_spring",),
    ("position", "z^3"): ("cubic_spring",),
    ("position", "|z|z"): ("cubic_spring",),
    ("level", "z"): ("leak", "leak_tank1"),
    **{("level", shape): _LEVEL for shape in ("z^2", "z^3", "|z|z", "sqrt(z)")},
}
_LAWS = {
    ("coulomb_friction", "sign(z)"),
    ("quadratic_drag", "|z|z"),
    ("cubic_spring", "z^3"),
    ("leak", "z"),
    ("leak_tank1", "z"),
    ("inflow", "1"),
}
CAN_NAME = {name for names in MEANING.values() for name in names}
Values = Any  # of all signals z `[signal, ...]`, states before inputs


class Term(NamedTuple):
    """equation: of which state; role and shape as in MEANING, shape "" for a product; text: as a person writes it."""

    equation: int
    role: str
    shape: str
    text: str
    value: Callable[[Values], Values]


def library(physics: Physics, z: np.ndarray) -> list[Term]:
    """Those of every equation whose state is no mere integral of another one; z: signals `[signal, time]`."""
    n, rates = len(physics.states), {state.rate_of: i for i, state in enumerate(physics.states)}
    signals, found = [*physics.states, *physics.inputs], []
    points = extension_of(physics).points
    slopes = jax.vmap(jax.jacobian(points.derivative, 1), (None, 1, 1))
    acts = np.abs(np.asarray(slopes(physics.params, z[:n], z[n:]))).max(0) > 0
    for i in range(n):
        if signals[i].name in rates:
            continue
        near = [k for k in range(n) if k == i or acts[i, k] or signals[i].rate_of in (signals[k].name, "")]
        used = [*near, *range(n, len(signals))]
        roles = {k: "input" if k >= n else "rate" if signals[k].rate_of else "level" for k in used}
        roles |= {k: "position" for k in used if signals[k].name in rates}
        found.append(Term(i, "", "1", f"1 in {signals[i].name}'", lambda z: jnp.ones_like(z[0])))
        for order in (1, 2, 3):
            for several in combinations_with_replacement(used, order):
                alone, text = len(set(several)) == 1, " ".join(signals[k].name for k in several)
                shape = ("z" if order == 1 else f"z^{order}") if alone else ""
                value = partial(_product, several)
                found.append(Term(i, roles[several[0]] if alone else "", shape, f"{text} in {signals[i].name}'", value))
        for k in used:
            crosses = z[k].min() < 0.0 < z[k].max()
            for shape in ("sign(z)", "|z|z") if crosses else ("sqrt(z)",):
                text = f"{shape.replace('z', signals[k].name)} in {signals[i].name}'"
                found.append(Term(i, roles[k], shape, text, partial(_BENT[shape], k)))
    return found


def _product(several: tuple[int, ...], z: Values) -> Values:
    return reduce(mul, (z[k] for k in several))


_BENT: dict[str, Callable[[int, Values], Values]] = {
    "sign(z)": lambda k, z: jnp.sign(z[k]),
    "|z|z": lambda k, z: jnp.abs(z[k]) * z[k],
    "sqrt(z)": lambda k, z: jnp.sqrt(jnp.maximum(z[k], 0.0)),
}


def size_of(name: str, term: Term, c: float, physics: Physics, nominal: Physics) -> float | None:
    """The size of an effect by the coefficient of its term, where the term is its law; physics: with the terms."""
    if name == "input_offset":
        points, n = extension_of(nominal).points, len(nominal.states)
        gain = jax.jacobian(points.derivative, 2)(physics.params, jnp.ones(n), jnp.ones(len(nominal.inputs)))
        return c / float(gain[term.equation, 0]) if gain[term.equation, 0] else None
    if name == "bypass":
        return c / (c + float(physics.params["k3"]))  # of the whole pump flow
    return {"inflow": c}.get(name, -c) if (name, term.shape) in _LAWS else None
