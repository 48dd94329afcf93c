"""One-step integrators of dx/dt = f(params, x, u) with the input held over the sample.

Euler:       x⁺ = x + h f(x)                                                     error O(h)
RK4:         x⁺ = x + h/6 (k1 + 2 k2 + 2 k3 + k4), k_i the classical four stages error O(h⁴)
Rosenbrock:  x⁺ = x + h/2 (3 k1 + k2),  W k1 = f(x),  W k2 = f(x + h k1) - 2 k1  error O(h²)
             W = I - γ h ∂f/∂x,  γ = 1 - 1/√2: L-stable, for stiff systems; two linear solves in place of iterations
Sources: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, II.1; Verwer, Spee, Blom, Hundsdorfer, A
second-order Rosenbrock method applied to photochemical dispersion problems, SIAM J. Sci. Comput. 20, 1999.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from pgrssnn_jax.records.arguments import positive, shown

_MOST = 10**6  # sub-steps of a sample: more take minutes
State = Float[jax.Array, " x"]
Derivative = Callable[[Any, State, Float[jax.Array, " u"]], State]
Integrator = Callable[[Callable[[State], State], State, float], State]
_GAMMA = 1.0 - 0.5**0.5  # of Rosenbrock's method: the smaller of the two for which it is L-stable


def euler(f: Callable[[State], State], x: State, h: float) -> State:
    return x + h * f(x)


def rk4(f: Callable[[State], State], x: State, h: float) -> State:
    k1 = f(x)
    k2 = f(x + 0.5 * h * k1)
    k3 = f(x + 0.5 * h * k2)
    k4 = f(x + h * k3)
    return x + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)


def rk4_looped(f: Callable[[State], State], x: State, h: float) -> State:
    """The same as `rk4` with its stages as a loop: f is compiled once, not four times. For an f of many operations."""

    def stage(carry: tuple[State, State], numbers: Float[jax.Array, "2"]) -> tuple[tuple[State, State], None]:
        slope, total = carry
        at, weight = numbers
        slope = f(x + h * at * slope)
        return (slope, total + weight * slope), None

    tableau = jnp.asarray([[0.0, 1.0], [0.5, 2.0], [0.5, 2.0], [1.0, 1.0]], x.dtype)
    (_, total), _ = jax.lax.scan(stage, (jnp.zeros_like(x), jnp.zeros_like(x)), tableau)
    return x + (h / 6.0) * total


def rosenbrock(f: Callable[[State], State], x: State, h: float) -> State:
    slope = jnp.eye(len(x), dtype=x.dtype) - _GAMMA * h * jax.jacfwd(f)(x)
    factors = jax.scipy.linalg.lu_factor(slope)
    k1 = jax.scipy.linalg.lu_solve(factors, f(x))
    k2 = jax.scipy.linalg.lu_solve(factors, f(x + h * k1) - 2.0 * k1)
    return x + 0.5 * h * (3.0 * k1 + k2)


INTEGRATORS: dict[str, Integrator] = {
    "euler": euler,
    "rk4": rk4,
    "rk4_looped": rk4_looped,
    "rosenbrock": rosenbrock,
}


EXPLICIT = ("euler", "rk4", "rk4_looped")  # leave the range where a step is long against the fastest mode


def named(integrator: Integrator | str) -> Integrator:
    """Raises `ValueError` for an unknown name."""
    if callable(integrator):
        return integrator
    if not isinstance(integrator, str) or integrator not in INTEGRATORS:
        raise ValueError(f"physics: integrator: expected one of {sorted(INTEGRATORS)}, found {integrator!r}")
    return INTEGRATORS[integrator]


def repeated(one: Callable[[State], State], x: State, times: int) -> State:
    """one(one(... x))"""
    return one(x) if times == 1 else jax.lax.fori_loop(0, times, lambda _, state: one(state), x)


def zero_order_hold(
    derivative: Derivative, *, dt: float, integrator: Integrator | str, sub_steps: int = 1
) -> Derivative:
    """x_t = step(params, x_{t-1}, u_t): `sub_steps` steps of h = dt / sub_steps seconds with u_t held.

    Raises `ValueError` for an unknown integrator or fewer than one sub-step.
    """
    points = derivative_points(derivative, lambda p, x, u: x, dt=dt, integrator=integrator, sub_steps=sub_steps)
    return held(points)


class DerivativePoints(NamedTuple):
    """Extension points of dx/dt = derivative(p, x, u), for effects inside a step. p: the physics' params.

    derivative(p, x, u) -> dx/dt; advance(p, field, x, u) -> x after h seconds of dx/dt = field(x), in which u has its
    place already: the integrator; measure(p, x, u) -> y. h: s; sub_steps: advances per sample.
    """

    derivative: Derivative
    advance: Callable[[Any, Callable[[State], State], State, Float[jax.Array, " u"]], State]
    measure: Derivative
    h: float
    sub_steps: int


def derivative_points(
    derivative: Derivative, measure: Derivative, *, dt: float, integrator: Integrator | str, sub_steps: int
) -> DerivativePoints:
    """Those of a physics without effects.

    Raises `ValueError` for an unknown integrator or fewer than one sub-step."""
    one = named(integrator)
    if not isinstance(sub_steps, int):
        raise ValueError(f"physics: sub_steps: expected a whole number of at least 1, found {sub_steps!r}")
    if sub_steps < 1:
        raise ValueError(f"physics: sub_steps: expected at least 1, found {sub_steps}")
    if sub_steps > _MOST:
        raise ValueError(f"physics: sub_steps: expected at most {_MOST}, found {shown(sub_steps)}")
    h = positive("physics: dt", dt, "sample time in seconds") / sub_steps
    return DerivativePoints(derivative, lambda p, field, x, u: one(field, x, h), measure, h, sub_steps)


def held(points: DerivativePoints) -> Derivative:
    """x_t = step(params, x_{t-1}, u_t) with u_t held."""

    def step(params: Any, x: State, u: Float[jax.Array, " u"]) -> State:
        def field(state: State) -> State:
            return points.derivative(params, state, u)

        return repeated(lambda state: points.advance(params, field, state, u), x, points.sub_steps)

    return step
