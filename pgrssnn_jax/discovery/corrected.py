"""Problems with a nonparametric correction beside effects that are already there.

    x_i ← x_i + dt f(s)      u_j ← u_j + f(u_j)      y_k ← y_k + f(y_k)      f = Σ c_j φ_j

One effect for all equations and signals: which ones is a matter of numbers that no fit moves, so that one compiled
program fits any of them. Corrections by the history of an input remember it and have programs of their own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.discovery.flexible import KNOTS, continued, families, flexible_effects, hats
from pgrssnn_jax.discovery.problem import Problem, build_problem
from pgrssnn_jax.effects.base import Effect
from pgrssnn_jax.physics.base import Parameter, Physics

CURVE = "correction"


@dataclass(frozen=True, eq=False)
class Corrected:
    """Of one physics and catalogue; each is built when first asked for, and kept for other numbers of them."""

    built: dict[tuple[tuple[str, ...], str], Problem] = field(default_factory=dict)

    def by(self, problem: Problem, name: str, active: Sequence[str]) -> Problem:
        """The physics with these effects of the problem and one family of corrections (`flexible.families`); see
        `numbers_of` for which one it is. Without the rest of the catalogue it is soon compiled."""
        own = _effect_of(problem.physics, name)
        return self._kept(problem, own.name, (*map(problem.effect, active), own))

    def by_all(self, problem: Problem, active: Sequence[str]) -> Problem:
        """With every family as an effect of its own."""
        return self._kept(problem, "all", (*map(problem.effect, active), *flexible_effects(problem.physics)))

    def with_catalogue(self, problem: Problem, effects: tuple[Effect, ...]) -> Problem:
        """With another catalogue."""
        return self._kept(problem, "", effects)

    def _kept(self, problem: Problem, name: str, effects: tuple[Effect, ...]) -> Problem:
        key = (tuple(effect.name for effect in effects), name)
        if key not in self.built:
            fixed = {slot.path[0] for slot in problem.slots if slot.effect is None and not slot.meaning.trainable}
            accelerate = problem.code.accelerate
            self.built[key] = build_problem(problem.physics, effects, fixed=sorted(fixed), accelerate=accelerate)
        return self.built[key].with_numbers(problem.physics.params)


def numbers_of(physics: Physics, name: str, low: float, high: float) -> tuple[str, dict[str, Any]]:
    """The effect of a family and its numbers before a fit, for a signal between low and high."""
    where, own = families(physics)[name], _effect_of(physics, name)
    numbers: dict[str, Any] = own.neutral()
    if where.kind == "history":
        return own.name, numbers
    kind, index = where.by
    numbers |= {"low": np.asarray(low), "high": np.asarray(high)}
    to = {"state": "to_x", "input": "to_u", "output": "to_y"}[where.kind]
    for chosen, at in ((to, where.target), (f"by_{kind}", index)):
        numbers[chosen] = np.eye(len(numbers[chosen]))[at]
    return own.name, numbers


def _effect_of(physics: Physics, name: str) -> Effect:
    if families(physics)[name].kind == "history":
        return next(effect for effect in flexible_effects(physics) if effect.name == name)
    return _curve(physics)


def _curve(physics: Physics) -> Effect:
    n_x, n_u, n_y = len(physics.states), len(physics.inputs), len(physics.outputs)

    def curve(n: Any, value: jax.Array, shape: Callable[..., jax.Array] = continued) -> jax.Array:
        return shape(value, n["low"], n["high"], n["c"])

    def on_input(n: Any, u: jax.Array) -> jax.Array:
        return u + n["to_u"] * curve(n, (n["by_u"] * u).sum())

    def wrap(inner: Physics) -> Physics:
        def step(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            n = p.effects[CURVE]
            new = inner.step(p, x, on_input(n, u))
            value = (n["by_x"] * 0.5 * (x[:n_x] + new[:n_x])).sum() + (n["by_u"] * u).sum()
            return jnp.concatenate([new[:n_x] + physics.dt * n["to_x"] * curve(n, value, hats), new[n_x:]])

        def measure(p: Any, x: jax.Array, u: jax.Array) -> jax.Array:
            n = p.effects[CURVE]
            y = inner.measure(p, x, on_input(n, u))
            return y + n["to_y"] * curve(n, (n["by_y"] * y).sum())

        return inner._replace(step=step, measure=measure)

    fixed = Parameter(neutral=0.0, trainable=False)
    sizes = {"to_x": n_x, "to_u": n_u, "to_y": n_y, "by_x": n_x, "by_u": n_u, "by_y": n_y}
    return Effect(
        CURVE,
        {
            "c": Parameter("c", neutral=0.0),
            "high": fixed._replace(neutral=1.0),
            "low": fixed,
            **dict.fromkeys(sizes, fixed),
        },
        wrap,
        title="Nonparametric correction",
        equation="Σ c_j φ_j",
        shapes={"c": (KNOTS,), **{name: (size,) for name, size in sizes.items()}},
    )
