"""Affine scaling between physical units and the networks' units, fitted on training data alone.

    physical = offset + scale · scaled

u and y: mean and standard deviation of the training record. x: a state that is `like` an output shares that
output's scaling; the rate of something that is measured is scaled by the size of its differences; any other state by
a simulation of the physics over the training inputs. A constant channel keeps scale 1.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Physics, Step, measured_rate
from pgrssnn_jax.records.record import Array, Record, Splits, valid_mask


class Affine(NamedTuple):
    """physical = offset + scale · scaled; both `[..., channel]`."""

    offset: Float[Array, "*members c"]
    scale: Float[Array, "*members c"]

    def to_scaled(self, physical: Array) -> jax.Array:
        physical = jnp.asarray(physical)
        return (physical - _last_axis(self.offset, physical)) / _last_axis(self.scale, physical)

    def to_physical(self, scaled: jax.Array) -> jax.Array:
        return _last_axis(self.offset, scaled) + self.unscale_difference(scaled)

    def unscale_difference(self, scaled: jax.Array) -> jax.Array:
        """A difference of scaled values in physical units: scale · scaled."""
        return _last_axis(self.scale, scaled) * scaled


def _last_axis(values: Array, like: jax.Array) -> jax.Array:
    return jnp.asarray(values, like.dtype).reshape((1,) * (like.ndim - 1) + (-1,))


class Scaling(NamedTuple):
    u: Affine
    x: Affine
    y: Affine


def _affine(offset: Any, scale: Any) -> Affine:
    offset, scale = np.ma.filled(offset, 0.0), np.ma.filled(scale, 1.0)
    usable = np.isfinite(scale) & (scale > 1e-12 * np.maximum(1.0, np.abs(offset)))
    return Affine(np.where(np.isfinite(offset), offset, 0.0), np.where(usable, scale, 1.0))


def identity(channels: int) -> Affine:
    return Affine(np.zeros(channels), np.ones(channels))


def signal_scaling(train: Record) -> tuple[Affine, Affine]:
    """Scalings of u and y from one training record `[seq, time, channel]`; masked samples do not count."""
    u = np.asarray(train.u, np.float64)[_real(train)]
    y = np.ma.array(np.asarray(train.y, np.float64), mask=~np.asarray(train.mask)).reshape(-1, train.y.shape[-1])
    return (
        _affine(u.mean(0), u.std(0)),
        _affine(y.mean(0), y.std(0)),
    )


def fit_scaling(train: Record, physics: Physics | None, *, rates_like_outputs: bool = False) -> Scaling:
    """Scaling of all signals from one training record `[seq, time, channel]`.

    physics None (black box): states have no unit, their scaling is the identity and its width is not known
    here, so x is returned empty. rates_like_outputs: a `rate_of` an output takes that output's scaling, offset
    included, as in the published code.
    """
    u, y = signal_scaling(train)
    if physics is None:
        return Scaling(u, identity(0), y)
    outputs = [signal.name for signal in physics.outputs]
    offset, scale = np.zeros(len(physics.states)), np.ones(len(physics.states))
    rates = [measured_rate(physics, state) for state in physics.states]
    if not all(state.like or rate or state.memory_of for state, rate in zip(physics.states, rates, strict=True)):
        simulated = _simulated_states(train, physics)
        offset, scale = simulated.mean(0), simulated.std(0)
    for i, (state, rate) in enumerate(zip(physics.states, rates, strict=True)):
        if state.memory_of is not None:
            j = [signal.name for signal in physics.inputs].index(state.memory_of)
            offset[i], scale[i] = u.offset[j], u.scale[j]
        same = state.like or (rate if rates_like_outputs else None)
        if same is not None:
            j = outputs.index(same)
            offset[i], scale[i] = y.offset[j], y.scale[j]
        elif rate is not None:
            j = outputs.index(rate)
            offset[i], scale[i] = 0.0, _rate_scale(np.where(train.mask, train.y, np.nan)[..., j], physics.dt)
    return Scaling(u, _affine(offset, scale), y)


def _rate_scale(y: Float[np.ndarray, "seq time"], dt: float) -> float:
    """Size of dy/dt without what white measurement noise adds to differences; 1 where nothing can be said.

    E(y_{t+k} - y_t)² is about (k dt)² E(dy/dt)² + 2 σ² for small k, and the difference of k = 2 and k = 1 knows no σ.
    Where k = 3 does not agree with it, differences of one sample are taken as they are.
    """
    steps = [y[:, k:] - y[:, :-k] for k in (1, 2, 3)]
    one, two, three = (np.mean(d[np.isfinite(d)] ** 2) if np.isfinite(d).any() else np.nan for d in steps)
    motion, again = (two - one) / 3.0, (three - one) / 8.0
    # a fast signal's differences grow otherwise, and what is left of a signal that only trembles is an accident
    if not (motion > 0 and 0.5 * motion < again < 2.0 * motion):
        motion = one
    return float(np.sqrt(motion) / dt) if np.isfinite(motion) else 1.0


def _simulated_states(train: Record, physics: Physics) -> Float[np.ndarray, "samples x"]:
    """States of the physics alone from zero, over all training sequences; non-finite values become zero."""
    start = jnp.zeros(len(physics.states))
    x = np.asarray(_free_run(physics.step, physics.params, start, jnp.asarray(train.u)), np.float64)
    return np.nan_to_num(x[_real(train)], posinf=0.0, neginf=0.0)


def _real(train: Record) -> np.ndarray:
    """Which samples `[seq, time]` are no padding."""
    valid = valid_mask(train)
    return np.ones(train.u.shape[:2], bool) if valid is None else np.asarray(valid)


@partial(jax.jit, static_argnums=0)  # compiled once for all datasets of one physics
def _free_run(step: Step, params: Any, start: jax.Array, u: Float[jax.Array, "seq time u"]) -> jax.Array:
    params = jax.tree.map(lambda p: jnp.asarray(p, u.dtype), params)

    def simulate(u: jax.Array) -> jax.Array:
        def body(x: jax.Array, u_t: jax.Array) -> tuple[jax.Array, jax.Array]:
            x = step(params, x, u_t)
            return x, x

        return jax.lax.scan(body, start.astype(u.dtype), u)[1]

    return jax.vmap(simulate)(u)


class Units(NamedTuple):
    """From the units that a model works in to the measured ones, per dataset or member: measured = offset + scale ·
    worked in. The identity, unless records were standardised."""

    u: Affine
    y: Affine


def measured_units(splits: Splits) -> Units:
    """The identity for every dataset of `splits`."""

    def unit(signal: Array) -> Affine:
        shape = (len(signal), signal.shape[-1])
        return Affine(np.zeros(shape), np.ones(shape))

    return Units(unit(splits.train.u), unit(splits.train.y))


def standardise(splits: Splits) -> tuple[Splits, Units]:
    """All records of every dataset in the published code's standardised units: mean 0 over its training record, and
    mean variance 1 within its training sequences.

    splits: records `[dataset, seq, time, channel]`. Returns the scaled splits and the units that bring them back. In
    the published figures the matrices of the linear model act on these signals. (With windows of 64 samples the
    deviation within a window is 4 % below that of the record; only the former gives the published 1.68.)
    """
    units = measured_units(splits)
    train = splits.train
    for i in range(len(train.u)):
        everywhere = np.ones(train.u.shape, bool)
        for affine, signal, mask in ((units.u, train.u, everywhere), (units.y, train.y, train.mask)):
            values = np.ma.array(np.asarray(signal[i], np.float64), mask=~np.asarray(mask[i]))
            within = _affine(values.mean((0, 1)), np.ma.sqrt(values.var(1).mean(0)))
            affine.offset[i], affine.scale[i] = within

    def scaled(affine: Affine, signal: Array) -> np.ndarray:
        offset, scale = (np.asarray(a)[:, None, None, :] for a in affine)
        return (np.asarray(signal) - offset) / scale

    return Splits(*(r._replace(u=scaled(units.u, r.u), y=scaled(units.y, r.y)) for r in splits)), units
