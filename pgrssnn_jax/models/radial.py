"""Gaussian radial basis functions, and how little a set of samples says about a point.

    φ_i(z) = exp(-‖z - c_i‖² / (2 σ_i²))          w(z) = 1 / (1 + Σ_k exp(-‖z - z_k‖² / (2 σ²)))

φ: features of a network whose centres c_i and widths σ_i are trained; they vanish far from the centres, and what is
built on them leaves the physics alone there. w: near 1 where no sample z_k lies, near 0 where many do.

Source of w: Liu, Tóth, Schoukens, *Physics-Guided State-Space Model Augmentation Using Weighted Regularized Neural
Networks* (W-PGNN), SYSID 2024, IFAC-PapersOnLine 58(15), 295-300: the state of a fed-back network is fitted by
simulation error plus λ Σ_j w(z_j) (|f - f_phy|² + |g - g_phy|²), so that the physics rules where data is scarce.
Known of it here: that cost, the form of w with Gaussian functions, and that surrogate points z_j are used. Our reading:
networks of radial features, added to the physics; one width of w for all points; the surrogate points below.
"""

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Bool, Float

_RANGE = 2.0  # standard deviations: centres start where most of the scaled signals are
_FAR = 3.0  # standard deviations: surrogate points fill a box that reaches beyond them
_POINTS = 256
_SAMPLES = 512  # at most; of a longer record every n-th sample stands for n


def gaussians(
    z: Float[jax.Array, "*batch n"], centres: Float[jax.Array, "k n"], width: Float[jax.Array, "#k"]
) -> Float[jax.Array, "*batch k"]:
    """φ(z). The square is multiplied out: one product instead of an array of all differences."""
    rows = z.reshape(-1, z.shape[-1])
    distance = jnp.sum(rows**2, -1)[:, None] - 2.0 * rows @ centres.T + jnp.sum(centres**2, -1)[None]
    return jnp.exp(-0.5 * distance / (width**2)[None]).reshape(*z.shape[:-1], -1)


class Radial(nnx.Module):
    """φ with its own centres and widths; a width is the exponential of a weight, and so positive.

    Centres start uniform in ±2, the range of scaled signals; widths at √n, because distances grow so with the number n
    of signals and neighbours are to overlap.
    """

    def __init__(self, n_in: int, hidden: int, *, rngs: nnx.Rngs) -> None:
        centres = jax.random.uniform(rngs.params(), (hidden, n_in), jnp.float32, -_RANGE, _RANGE)
        self.centres = nnx.Param(centres)
        self.log_width = nnx.Param(jnp.full(hidden, 0.5 * np.log(n_in), jnp.float32))

    def __call__(self, z: Float[jax.Array, "*batch n_in"]) -> Float[jax.Array, "*batch hidden"]:
        return gaussians(z, self.centres[...], jnp.exp(self.log_width[...]))


def surrogate_points(n: int) -> Float[np.ndarray, "point n"]:
    """The same points for everybody, uniform in the box of ±3 standard deviations of n scaled signals."""
    return np.random.default_rng(0).uniform(-_FAR, _FAR, (_POINTS, n)).astype(np.float32)


def scarcity(
    points: Float[jax.Array, "point n"], samples: Float[jax.Array, "k n"], valid: Bool[jax.Array, " k"]
) -> Float[jax.Array, " point"]:
    """w of every point, from 0 to 1; σ = √n / 2, half the distance that n scaled signals have from their mean.

    Samples that are not `valid`, padding, do not count.
    """
    every = -(-len(samples) // _SAMPLES)
    near = gaussians(points, samples[::every], jnp.full(1, 0.5 * samples.shape[-1] ** 0.5, samples.dtype))
    return 1.0 / (1.0 + every * jnp.sum(jnp.where(valid[None, ::every], near, 0.0), -1))
