"""An oscillator with a hardening spring, and the same in steps so small that nothing is lost."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from toys import quick_jit

from pgrssnn_jax.physics.base import Physics, Signal, continuous

SAMPLES, DT, TINY = 200, 0.05, 4000
START = (0.3, -0.5)


def slope(q: Any, v: Any, u: Any) -> Any:
    return u - 0.4 * v - 4.0 * q - 2.0 * q**3


def oscillator(dt: float = DT, **settings: Any) -> Physics:
    return continuous(
        "oscillator",
        lambda p, x, u: jnp.stack([x[1], slope(x[0], x[1], u[0])]),
        lambda p, x, u: x[:1],
        {"one": 1.0},
        states=(Signal("q", "m", like="q"), Signal("v", "m/s", rate_of="q")),
        inputs=(Signal("u"),),
        outputs=(Signal("q", "m"),),
        dt=dt,
        **settings,
    )


def forces() -> np.ndarray:
    """Held for 2.5 s, in which friction brings the oscillator to rest."""
    return np.repeat(np.random.default_rng(3).normal(0.0, 1.5, SAMPLES // 50), 50)


def solved(tiny: Callable[[Any, Any, float], Any], start: tuple[float, ...] = START) -> np.ndarray:
    """States after each sample. tiny(x, u, h): x after one of the TINY steps per sample."""

    def sample(x: Any, u: Any) -> Any:
        x = jax.lax.fori_loop(0, TINY, lambda _, x: tiny(x, u, DT / TINY), x)
        return x, jnp.stack(x)

    first = tuple(jnp.asarray(one) for one in start)
    return np.asarray(quick_jit(lambda u: jax.lax.scan(sample, first, u)[1])(jnp.asarray(forces())))


def freely(q: Any, v: Any, u: Any, h: float) -> tuple[Any, Any]:
    """One tiny step of the oscillator alone."""
    after = v + h * slope(q + 0.5 * h * v, v + 0.5 * h * slope(q, v, u), u)
    return q + 0.5 * h * (v + after), after


def simulated(physics: Physics) -> np.ndarray:
    """States after each sample; those beyond the oscillator's own begin at zero."""

    def run(params: Any, u: Any) -> Any:
        def sample(x: Any, u: Any) -> Any:
            x = physics.step(params, x, u[None])
            return x, x

        return jax.lax.scan(sample, jnp.zeros(len(physics.states)).at[:2].set(jnp.asarray(START)), u)[1]

    return np.asarray(quick_jit(run)(jax.tree.map(jnp.asarray, physics.params), jnp.asarray(forces())))
