"""Scaling of a model's states, from one training record and the physics.

A state that is `like` an output shares that output's scaling; the rate of something that is measured is scaled by the
size of its differences; any other state by a simulation of the physics over the training inputs, but for those that
networks do not see.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.models.model import Model
from pgrssnn_jax.physics.base import Physics, measured_rate
from pgrssnn_jax.physics.simulate import simulated_states
from pgrssnn_jax.records.record import Record
from pgrssnn_jax.records.scaling import Scaling, identity, real_samples, signal_scaling, usable_affine


def model_scaling(model: Model, train: Record, *, rates_like_outputs: bool = False) -> Scaling:
    """Scaling of this model's signals from one training record; a black box's states are left as they are."""
    if model.spec.guided:
        return fit_scaling(train, model.physics, rates_like_outputs=rates_like_outputs)
    u, y = signal_scaling(train)
    return Scaling(u, identity(model.n_x), y)


def fit_scaling(train: Record, physics: Physics, *, rates_like_outputs: bool = False) -> Scaling:
    """Scaling of all signals from one training record `[seq, time, channel]`.

    rates_like_outputs: a `rate_of` an output takes that output's scaling, offset included, as in the published code.
    """
    u, y = signal_scaling(train)
    outputs = [signal.name for signal in physics.outputs]
    offset, scale = np.zeros(len(physics.states)), np.ones(len(physics.states))
    rates = [measured_rate(physics, state) for state in physics.states]
    inputs = [signal.name for signal in physics.inputs]
    known = (s.inner or s.like or rate or s.memory_of in inputs for s, rate in zip(physics.states, rates, strict=True))
    if not all(known):
        simulated = _simulated_states(train, physics)
        offset, scale = simulated.mean(0), simulated.std(0)
    for i, (state, rate) in enumerate(zip(physics.states, rates, strict=True)):
        if state.memory_of in inputs:
            j = inputs.index(state.memory_of)
            offset[i], scale[i] = u.offset[j], u.scale[j]
        same = state.like or (rate if rates_like_outputs else None)
        if same is not None:
            j = outputs.index(same)
            offset[i], scale[i] = y.offset[j], y.scale[j]
        elif rate is not None:
            j = outputs.index(rate)
            offset[i], scale[i] = 0.0, _rate_scale(np.where(train.mask, train.y, np.nan)[..., j], physics.dt)
    return Scaling(u, usable_affine(offset, scale), y)


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
    start = jnp.zeros((len(train.u), len(physics.states)))
    x = np.asarray(simulated_states(physics.step, physics.params, start, jnp.asarray(train.u)), np.float64)
    return np.nan_to_num(x[real_samples(train)], posinf=0.0, neginf=0.0)
