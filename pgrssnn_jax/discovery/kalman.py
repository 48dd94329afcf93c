"""Kalman filters of linear models that change in time, many at once, in numpy.

    x_t = A_t x_{t-1} + g_t w_t        e_t = C_t x_t + v_t        (or C_t x_{t-1}, as outputs are timed)
    ε_t = e_t - C_t x̂_t                x̂ ← x̂ + K_t ε_t            cov ε_t = C_t P_t C_tᵀ + R

w: white, of a size of its own in every filter; v: white, of variances R; x_0 = 0. Outputs are read one after the other,
because their noise is independent, and nothing is read where nothing was measured. Source: Anderson, Moore, Optimal
Filtering, 1979, chapters 3 and 5.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


class Models(NamedTuple):
    """Models with the same outputs. after: are outputs read after the step?"""

    a: Float[np.ndarray, "model seq time x x"]
    g: Float[np.ndarray, "model seq time x"]
    c: Float[np.ndarray, "seq time y x"]
    measured: Bool[np.ndarray, "seq time y"]
    after: bool

    def first(self, samples: int) -> "Models":
        """Of so many samples: the first sequences or, of a longer one, its first samples."""
        time = min(self.a.shape[2], samples)
        count = max(1, samples // time)
        a, g = (one[:, :count, :time] for one in (self.a, self.g))
        return Models(a, g, self.c[:count, :time], self.measured[:count, :time], self.after)


class Filters(NamedTuple):
    """model: of each filter; size: standard deviation of w; gains: K, 0 where nothing was measured; variance of the
    innovations, 1 there."""

    model: Int[np.ndarray, " filter"]
    size: Float[np.ndarray, " filter"]
    gains: Float[np.ndarray, "filter seq time y x"]
    variance: Float[np.ndarray, "filter seq time y"]

    def some(self, which: np.ndarray) -> "Filters":
        return Filters(*(one[which] for one in self))


def unmeasured_variance(models: Models) -> Float[np.ndarray, "model seq time y"]:
    """C P Cᵀ for w of size 1 when nothing is measured."""
    a, g, c = models.a, models.g, models.c
    p, found = np.zeros((*a.shape[:2], *a.shape[3:])), np.zeros((len(a), *c.shape[:3]))
    for t in range(a.shape[2]):
        old = p
        p = _propagated(p, a[:, :, t], g[:, :, t])
        found[:, :, t] = np.einsum("syi,msij,syj->msy", c[:, t], p if models.after else old, c[:, t])
    return found


def filters(
    models: Models,
    model: Int[np.ndarray, " filter"],
    size: Float[np.ndarray, " filter"],
    white: Float[np.ndarray, " y"],
) -> Filters:
    """white: diagonal of R."""
    (n_seq, time, n_y, n), count = models.c.shape, len(model)
    gains, variance = np.zeros((count, n_seq, time, n_y, n)), np.ones((count, n_seq, time, n_y))
    g, p = size[:, None, None, None] * models.g[model], np.zeros((count, n_seq, n, n))
    for t in range(time):
        a = models.a[model, :, t]
        p = _propagated(p, a, g[:, :, t]) if models.after else p
        for j in range(n_y):
            c, there = models.c[:, t, j], models.measured[:, t, j]
            moved = np.where(there[:, None], (p @ c[..., None])[..., 0], 0.0)
            spread = (moved * c).sum(-1) + white[j]
            gain = moved / spread[..., None]
            gains[:, :, t, j], variance[:, :, t, j] = gain, np.where(there, spread, 1.0)
            p = p - moved[..., None] * gain[..., None, :]
        p = p if models.after else _propagated(p, a, g[:, :, t])
    return Filters(model, size, gains, variance)


def _propagated(p: np.ndarray, a: np.ndarray, g: np.ndarray) -> np.ndarray:
    """A P Aᵀ + g gᵀ"""
    return a @ p @ a.swapaxes(-1, -2) + g[..., None] * g[..., None, :]


def innovations(
    models: Models, known: Filters, values: Float[np.ndarray, "seq time y k"]
) -> Float[np.ndarray, "filter seq time y k"]:
    """W e of independent columns of errors, by every filter."""
    (n_seq, time, n_y, n), count = models.c.shape, values.shape[-1]
    x, found = np.zeros((len(known.model), n_seq, n, count)), np.zeros((len(known.model), *values.shape))
    for t in range(time):
        a = models.a[known.model, :, t]
        x = a @ x if models.after else x
        for j in range(n_y):
            there, expected = models.measured[:, t, j, None], (models.c[:, t, j, None] @ x)[:, :, 0]
            found[:, :, t, j] = now = np.where(there, values[:, t, j] - expected, 0.0)
            x = x + known.gains[:, :, t, j, :, None] * now[:, :, None]
        x = x if models.after else a @ x
    return found


def answers(
    models: Models, one: Filters, columns: Float[np.ndarray, "seq time y k"]
) -> Float[np.ndarray, "seq time y k"]:
    """W⁻ᵀ v: by how much an innovation changes the product of columns and errors."""
    a, gains = models.a[one.model[0]], one.gains[0]
    x, found = np.zeros((len(a), a.shape[-1], columns.shape[-1])), np.zeros(columns.shape)
    for t in reversed(range(a.shape[1])):
        back = a[:, t].swapaxes(1, 2)
        x = x if models.after else back @ x
        for j in reversed(range(columns.shape[2])):
            now = columns[:, t, j]
            found[:, t, j] = now + (gains[:, t, j, None] @ x)[:, 0]
            x = x + models.c[:, t, j, :, None] * now[:, None]
        x = back @ x if models.after else x
    return found
