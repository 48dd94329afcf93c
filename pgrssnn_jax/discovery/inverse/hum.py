"""A hum: torque errors that repeat in time, whatever the arm does.

    |E_k| ≥ ½ |U_k|   in the bin k of the strongest line of the errors (`spectrum.py`), where U has a line too

E, U: spectra of a joint's torque error and of its measured torque. A controller answers a hum, so that the torque has
its line; of one that belongs to the motion, the model leaves little. Where the motion itself repeats, its errors do as
well, and nothing is said.
"""

from collections.abc import Iterable

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.discovery.inverse.evidence import Torques, fastest_of, samples_of
from pgrssnn_jax.discovery.inverse.motion import Motion
from pgrssnn_jax.discovery.inverse.reading import Reading
from pgrssnn_jax.discovery.spectrum import Line, has_line, lines_of, power_at
from pgrssnn_jax.records.record import Record

_WIDER = (1.0, 2.0, 4.0)  # times the chosen cut-off: where it is looked for
_SHARE = 0.25  # of the power of the torque at the line
_REPEATS = 0.9  # autocorrelation of speeds, at a lag behind that at which it is half of that


def hum_of(model: Torques, reading: Reading, record: Record, theta: Float[np.ndarray, " p"]) -> Line | None:
    """A line that the chosen cut-off hides stands out at a wider one, whose noise is spread over all frequencies."""
    motions = [reading._replace(cutoff=reading.cutoff * octave).of(record) for octave in _WIDER]
    errors = [model.errors(theta, samples_of(motion, fastest_of(motion))) for motion in motions]
    return hum((motion, error.T.reshape(motion.torque.shape)) for motion, error in zip(motions, errors, strict=True))


def hum(errors: Iterable[tuple[Motion, Float[np.ndarray, "seq time n"]]]) -> Line | None:
    """The line with the largest share of the errors of its joint (`output`), motor Nm. errors: those of the final
    model, each with the motion that they were computed from."""
    found = []
    for motion, error in errors:
        if not _repeats(motion.v):
            found += [line for line in lines_of(error) if _own(line, error, motion.torque)]
    return max(found, key=lambda line: line.share, default=None)


def _own(line: Line, error: Float[np.ndarray, "seq time n"], torque: Float[np.ndarray, "seq time n"]) -> bool:
    """Does the line belong to the errors rather than to the torques that the motion takes?"""
    own, whole = (power_at(signal[..., line.output], line) for signal in (error, torque))
    return own >= _SHARE * whole or not has_line(torque, line)


def _repeats(v: Float[np.ndarray, "seq time n"]) -> bool:
    """Do all joints do again what they did? By the autocorrelation of their speeds, each in its own size."""
    time = v.shape[1]
    scaled = v / np.maximum(np.sqrt((v**2).mean((0, 1))), np.finfo(float).tiny)
    power = np.abs(scipy.fft.rfft(scaled, 2 * time, axis=1)) ** 2
    lagged = scipy.fft.irfft(power.sum((0, 2)), 2 * time)[: time // 2] / np.arange(time, time - time // 2, -1)
    correlation = lagged / lagged[0]
    apart = np.flatnonzero(correlation < 0.5 * _REPEATS)
    return len(apart) > 0 and bool((correlation[apart[0] :] > _REPEATS).any())
