"""How long the blocks are that members leave out while settings are chosen.

    memory = max(τ_physics, 2 τ_errors)        samples

A shorter block says little about a free run: measurements on both sides of it hold the model in place, for as long as
the system remembers its state and the errors remember themselves. τ_physics: samples until a change of x_0 has decayed
to 1/e of its largest effect on the outputs, without end where nothing pulls a state back (the position of an axis).
τ_errors: Σ_{k>0} ρ_k of the errors of the physics alone, so that 2 τ samples are about one independent sample.
Sources: Burman, Chow, Nolan, A cross-validatory method for dependent data, Biometrika 1994; Sokal, Monte Carlo methods
in statistical mechanics, 1997, for the window of the sum.
"""

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.simulate import first_output_state, free_run
from pgrssnn_jax.records.record import Record

_CHANGE = 0.1  # of a state's deviation along the run: small beside what is nonlinear, large beside rounding
_WINDOW = 5  # correlation times over which correlations are summed


def memory(physics: Physics, train: Record) -> int:
    """Samples, at most those of a sequence. train `[seq, time, channel]` in the units of the physics."""
    u, y = np.asarray(train.u, np.float32), np.asarray(train.y, np.float32)
    x0 = np.asarray(first_output_state(physics, y[:, 0], u[:, 0]))
    predicted, x = (np.asarray(a) for a in free_run(physics, u, x0))
    time = u.shape[1]
    if not (np.isfinite(predicted).all() and np.isfinite(x).all()):
        return time
    errors = np.where(train.mask, y - predicted, 0.0)
    longest = 2.0 * max(correlation_time(errors[i, :, k]) for i in range(len(errors)) for k in range(errors.shape[2]))
    for state, size in enumerate(_CHANGE * x.std((0, 1))):
        moved = x0.copy()
        moved[:, state] += size
        longest = max(longest, _memory(np.asarray(free_run(physics, u, moved)[0]) - predicted))
    return min(time, int(np.ceil(longest)))


def _memory(effect: Float[np.ndarray, "seq time y"]) -> float:
    """Samples until the effect of a change has decayed to 1/e of its largest for good."""
    size = np.linalg.norm(np.nan_to_num(effect, nan=np.inf), axis=-1).max(0)
    if not size.max() > 0:
        return 0.0
    return float(1 + np.flatnonzero(size > size.max() / np.e)[-1])


def correlation_time(error: Float[np.ndarray, " time"]) -> float:
    """Σ_{k>0} ρ_k in samples, summed over the first k that are at least `_WINDOW` times the sum; 0 for white noise."""
    time, centred = len(error), error - error.mean()
    products = np.fft.irfft(np.abs(np.fft.rfft(centred, 2 * time)) ** 2)[:time]
    if not products[0] > 0:
        return 0.0
    sums = np.cumsum(products[1:] / products[0])
    enough = np.flatnonzero(np.arange(1, time) >= _WINDOW * np.maximum(2 * sums, 1.0))
    return float(max(sums[enough[0]] if len(enough) else sums.max(initial=0.0), 0.0))
