"""Affine scaling between physical units and the networks' units, fitted on training data alone.

    physical = offset + scale · scaled

u and y: mean and standard deviation of the training record; states: `models/scaling.py`. A constant channel keeps
scale 1.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.records.record import Array, Record, valid_mask


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


def usable_affine(offset: Any, scale: Any) -> Affine:
    offset, scale = np.ma.filled(offset, 0.0), np.ma.filled(scale, 1.0)
    usable = np.isfinite(scale) & (scale > 1e-12 * np.maximum(1.0, np.abs(offset)))
    return Affine(np.where(np.isfinite(offset), offset, 0.0), np.where(usable, scale, 1.0))


def identity(*shape: int) -> Affine:
    return Affine(np.zeros(shape), np.ones(shape))


def signal_scaling(train: Record) -> tuple[Affine, Affine]:
    """Scalings of u and y from one training record `[seq, time, channel]`; masked samples do not count."""
    u = np.asarray(train.u, np.float64)[real_samples(train)]
    y = np.ma.array(np.asarray(train.y, np.float64), mask=~np.asarray(train.mask)).reshape(-1, train.y.shape[-1])
    return usable_affine(u.mean(0), u.std(0)), usable_affine(y.mean(0), y.std(0))


def real_samples(train: Record) -> np.ndarray:
    """Which samples `[seq, time]` are no padding."""
    valid = valid_mask(train)
    return np.ones(train.u.shape[:2], bool) if valid is None else np.asarray(valid)


class Units(NamedTuple):
    """From the units that a model works in to the measured ones, per dataset or member: measured = offset + scale ·
    worked in. The identity, unless records were standardised."""

    u: Affine
    y: Affine


def measured_units(train: Record) -> Units:
    """The identity for every dataset of a record `[dataset, seq, time, channel]`."""
    return Units(*(identity(len(signal), signal.shape[-1]) for signal in (train.u, train.y)))


def standard_units(train: Record) -> Units:
    """The published code's standardised units of every dataset of a record `[dataset, seq, time, channel]`: mean 0
    over the record, and mean variance 1 within its sequences.

    In the published figures the matrices of the linear model act on these signals. (With windows of 64 samples the
    deviation within a window is 4 % below that of the record; only the former gives the published 1.68.)
    """
    units, everywhere = measured_units(train), np.ones(train.u.shape, bool)
    for scaling, signal, mask in ((units.u, train.u, everywhere), (units.y, train.y, train.mask)):
        for i in range(len(train.u)):
            values = np.ma.array(np.asarray(signal[i], np.float64), mask=~np.asarray(mask[i]))
            within = usable_affine(values.mean((0, 1)), np.ma.sqrt(values.var(1).mean(0)))
            scaling.offset[i], scaling.scale[i] = within
    return units


def in_units(whole: Record, units: Units) -> Record:
    """The record `[dataset, seq, time, channel]` in the units that the model works in."""

    def scaled(affine: Affine, signal: Array) -> np.ndarray:
        offset, scale = (np.asarray(a)[:, None, None, :] for a in affine)
        return (np.asarray(signal) - offset) / scale

    return whole._replace(u=scaled(units.u, whole.u), y=scaled(units.y, whole.y))
