"""What is missing but has no name: which equation, by which signal, and the shortest formula that says so.

A flexible correction is fitted by free run for every equation and signal (`flexible.py`); the curve of the best one is
then written as a sum of few terms, and the formula is put in the curve's place and simulated again.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.candidates import Candidate, Screening
from pgrssnn_jax.discovery.estimate import evaluate
from pgrssnn_jax.discovery.flexible import KNOTS, Where, families, nearness
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.physics.base import Physics

_ENOUGH = 0.97  # of the curve's weighted variance that a formula must explain


class Formula(NamedTuple):
    """text: for people; target and by: names of the corrected quantity and of the signal; curve: values of signal and
    correction; closed: part of what the flexible correction closes that the formula closes too, in free run."""

    text: str
    target: str
    by: str
    curve: Float[np.ndarray, "2 knots"]
    closed: float


def formula(
    flexible: Problem, signals: Signals, screening: Screening, best: Candidate, x: Float[np.ndarray, "seq time x"]
) -> Formula:
    """The curve of a flexible correction in words. flexible: the problem that it was fitted in; x: states of the free
    run with it."""
    physics, guess = flexible.physics, best.model.estimate.guess if best.model else best.guess
    where = families(physics)[best.name]
    effect = guess.active[-1]
    numbers = flexible.params(guess.theta).effects[effect]
    target = _target(physics, where)
    if where.kind == "history":
        lags = ", ".join(f"{c:+.3g} at {k + 1}" for k, c in enumerate(numbers["c"]))
        text = f"{target} depends on its past: weights {lags} samples ago"
        return Formula(text, target, target, np.stack([np.arange(len(numbers["c"])) + 1.0, numbers["c"]]), 1.0)
    signal = _signal(physics, where)
    low, high, c = float(numbers["low"]), float(numbers["high"]), np.asarray(numbers["c"])
    at = np.linspace(low, high, KNOTS)
    visits = _visits(_values(where, signals, x), low, high)
    terms, values = _sparse(at, c, visits, signal)
    simulated = evaluate(
        flexible,
        signals,
        guess._replace(theta=flexible.put(guess.theta, effect, {**numbers, "c": values})),
    )
    base, fitted = screening.base.estimate.cost**0.5, (best.model or screening.base).estimate.cost ** 0.5
    closed = (base - simulated.cost**0.5) / (base - fitted) if base > fitted else 0.0
    left = f"d({target})/dt" if where.kind == "state" else target
    return Formula(f"{left} gains {terms}", target, signal, np.stack([at, c]), float(closed))


def _target(physics: Physics, where: Where) -> str:
    if where.kind == "state":
        return physics.states[where.target].name
    return (physics.outputs if where.kind == "output" else physics.inputs)[where.target].name


def _signal(physics: Physics, where: Where) -> str:
    kind, index = where.by
    return {"x": physics.states, "u": physics.inputs, "y": physics.outputs}[kind][index].name


def _values(where: Where, signals: Signals, x: np.ndarray) -> np.ndarray:
    kind, index = where.by
    return {"x": x, "u": signals.u, "y": signals.y}[kind][..., index].ravel()


def _visits(values: np.ndarray, low: float, high: float) -> Float[np.ndarray, " knots"]:
    """How often the signal is near each knot."""
    return nearness(values, low, high).sum(0)


def _sparse(at: np.ndarray, c: np.ndarray, visits: np.ndarray, name: str) -> tuple[str, Float[np.ndarray, " knots"]]:
    """As few terms as explain the curve where it was visited."""
    weight = np.sqrt(visits / visits.sum())
    library = _library(at, name)
    chosen: list[tuple[str, np.ndarray]] = []
    total = float(((c - np.average(c, weights=visits)) ** 2 * visits).sum() / visits.sum()) or 1.0
    values, coefficients = np.zeros_like(c), np.zeros(0)
    for _ in range(3):
        tried = []
        for term in library:
            columns = np.stack([column for _, column in (*chosen, term)], 1)
            found, *_ = np.linalg.lstsq(columns * weight[:, None], c * weight, rcond=None)
            tried.append((float(((c - columns @ found) ** 2 * visits).sum() / visits.sum()), term, found, columns))
        left, term, coefficients, columns = min(tried, key=lambda t: t[0])
        chosen.append(term)
        values = columns @ coefficients
        if left <= (1.0 - _ENOUGH) * total:
            break
    text = " ".join(f"{k:+.3g} {word}".rstrip() for k, (word, _) in zip(coefficients, chosen, strict=True))
    return text, values


def _library(at: np.ndarray, name: str) -> list[tuple[str, np.ndarray]]:
    terms: list[tuple[str, np.ndarray]] = [
        ("", np.ones_like(at)),
        (name, at),
        (f"{name}²", at**2),
        (f"{name}³", at**3),
        (f"|{name}|", np.abs(at)),
        (f"{name}|{name}|", at * np.abs(at)),
        (f"sqrt(max({name}, 0))", np.sqrt(np.maximum(at, 0.0))),
        (f"sin({name})", np.sin(at)),
    ]
    for bend in at[1:-1]:
        terms.append((f"max({name} - {bend:.3g}, 0)", np.maximum(at - bend, 0.0)))
        terms.append((f"max({bend:.3g} - {name}, 0)", np.maximum(bend - at, 0.0)))
    return terms
