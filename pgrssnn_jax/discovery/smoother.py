"""Where a simulation is wrong: the correction that each state equation would need, by a smoother.

    δx_t = A_t δx_{t-1} + e_i dt d_t          e_t = C_t δx_t + v_t
    d_t  = d_{t-1} + w_{t-1}                  A, C: derivatives of the model along its own free run

d_t is the correction of equation i in its unit per second, δx the error of the simulated state, e the output error, v
white noise of the size of the floor. The variance of w is the one under which the errors are most likely; so equations
can be compared by that likelihood, and hidden states are no obstacle. One equation is corrected at a time. Source:
Rauch, Tung, Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA Journal 3, 1965.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.acceleration.compiler import quick_jit
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.discovery.responses import Path

_RATES = 10.0 ** np.arange(-6.0, 0.1, 1.0)  # of w: in state scales per sample, as a part of the error's size
_WIDE = 1e3  # prior deviation of δx_0 and d_0, in the same units


class Correction(NamedTuple):
    """mean and std `[x, seq, time]` of d in the states' unit per second; likelihood `[x]`: log-likelihood of the
    errors, above that of a model in which the correction is as small as can be."""

    mean: Float[np.ndarray, "x seq time"]
    std: Float[np.ndarray, "x seq time"]
    likelihood: Float[np.ndarray, " x"]


def smoothed_correction(
    problem: Problem, signals: Signals, path: Path, error: Float[np.ndarray, "seq time y"], noise: float
) -> Correction:
    """error: weighted errors of the free run `path`; noise: their standard deviation."""
    physics, n = problem.physics, len(problem.physics.states)
    a, c = path.a[..., :n, :n], path.c[..., :n] * signals.weight[..., None]
    spread = path.x[..., :n].std((0, 1))
    size = np.where(spread > 0.0, spread, 1.0)  # states in units of their spread
    mean, std, likelihood = _smooth(
        jnp.asarray(a * size / size[:, None]),
        jnp.asarray(c * size),
        jnp.asarray(error),
        jnp.asarray(signals.weight > 0),
        noise,
        physics.output_timing,
    )
    scale = (size / physics.dt)[:, None, None]
    return Correction(np.asarray(mean) * scale, np.asarray(std) * scale, np.asarray(likelihood))


@quick_jit(static_argnums=5)
def _smooth(
    a: jax.Array, c: jax.Array, error: jax.Array, measured: jax.Array, noise: jax.Array | float, output_timing: str
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Mean and deviation `[x, seq, time]` of d (per sample, scaled) at the likeliest rate; the gain in likelihood."""
    n = a.shape[-1]
    rates = jnp.asarray(_RATES) * jnp.maximum(jnp.std(error), noise)

    def one(equation: jax.Array, rate: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        run = jax.vmap(lambda a, c, e, m: _one_sequence(a, c, e, m, noise, equation, rate, output_timing))
        mean, std, likelihood = run(a, c, error, measured)
        return mean, std, likelihood.sum()

    over_rates = jax.vmap(one, (None, 0))
    mean, std, likelihood = jax.lax.map(lambda e: over_rates(e, rates), jnp.eye(n))
    best = jnp.argmax(likelihood, 1)

    def take(a: jax.Array) -> jax.Array:
        return jnp.take_along_axis(a, best[:, None, None, None], 1)[:, 0]

    return take(mean), take(std), likelihood.max(1) - likelihood[:, 0].max()


def _one_sequence(
    a: jax.Array,
    c: jax.Array,
    error: jax.Array,
    measured: jax.Array,
    noise: jax.Array | float,
    equation: jax.Array,
    rate: jax.Array,
    output_timing: str,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    n = a.shape[-1]

    def transition(a_t: jax.Array) -> jax.Array:
        return jnp.zeros((n + 1, n + 1)).at[:n, :n].set(a_t).at[:n, n].set(equation).at[n, n].set(1.0)

    drift = jnp.zeros((n + 1, n + 1)).at[n, n].set(rate**2)

    def predict(z: jax.Array, p: jax.Array, f: jax.Array) -> tuple[jax.Array, jax.Array]:
        return f @ z, f @ p @ f.T + drift

    def update(z: jax.Array, p: jax.Array, c_t: jax.Array, e: jax.Array, m: jax.Array) -> tuple[jax.Array, ...]:
        h = jnp.where(m[:, None], jnp.concatenate([c_t, jnp.zeros((len(c_t), 1))], 1), 0.0)
        r = jnp.where(m, noise**2, 1.0)
        innovation = jnp.where(m, e - h @ z, 0.0)
        s = h @ p @ h.T + jnp.diag(r)
        gain = jnp.linalg.solve(s, h @ p).T
        fitted = -0.5 * (innovation @ jnp.linalg.solve(s, innovation) + jnp.linalg.slogdet(s)[1])
        return z + gain @ innovation, p - gain @ h @ p, fitted

    def forward(carry: tuple[jax.Array, jax.Array], inputs: tuple[jax.Array, ...]) -> tuple[Any, Any]:
        z, p = carry
        a_t, c_t, e, m = inputs
        f = transition(a_t)
        if output_timing == "after_step":
            z_old, p_old = z, p
            z_new, p_new = predict(z, p, f)
            z, p, fitted = update(z_new, p_new, c_t, e, m)
        else:
            z_old, p_old, fitted = update(z, p, c_t, e, m)
            z_new, p_new = predict(z_old, p_old, f)
            z, p = z_new, p_new
        return (z, p), (z_old, p_old, z_new, p_new, f, fitted)

    start = (jnp.zeros(n + 1), jnp.diag(jnp.full(n + 1, _WIDE * noise**2)))
    (z, p), (z_old, p_old, z_new, p_new, f, fitted) = jax.lax.scan(forward, start, (a, c, error, measured))

    def backward(carry: tuple[jax.Array, jax.Array], inputs: tuple[jax.Array, ...]) -> tuple[Any, Any]:
        """From the smoothed z_t to the smoothed z_{t-1}; what comes out is the d that acted between the two."""
        z, p = carry
        z_old, p_old, z_new, p_new, f = inputs
        gain = jnp.linalg.solve(p_new + 1e-14 * jnp.eye(n + 1), f @ p_old).T
        z, p = z_old + gain @ (z - z_new), p_old + gain @ (p - p_new) @ gain.T
        return (z, p), (z[n], jnp.sqrt(jnp.maximum(p[n, n], 0.0)))

    _, (mean, std) = jax.lax.scan(backward, (z, p), (z_old, p_old, z_new, p_new, f), reverse=True)
    return mean, std, fitted.sum()
