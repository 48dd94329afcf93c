"""What the right model would leave: noise of torques and positions, and what the filter of the positions takes away.

    floor² = σ_u² + (σ_a M)² + mean (û(F q) - û(F F q))²

σ: from the spectra; M: the inertia that accelerations move; F: the filter (`motion.py`), û: the torques of the final
model. What F takes from a motion once is judged by what it takes from the filtered one. That is less where
accelerations jump, because the frequencies above the cut-off are hidden by the noise.
"""

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.inverse.compare import Compared
from pgrssnn_jax.discovery.inverse.evidence import Samples, Torques, fastest_of, samples_of
from pgrssnn_jax.discovery.inverse.motion import Motion, few, spectrum_of
from pgrssnn_jax.discovery.inverse.reading import Reading
from pgrssnn_jax.records.record import Record

_SAMPLES = 2000  # of each joint


def floor_of(
    model: Torques,
    reading: Reading,
    record: Record,
    train: Compared,
    samples: Samples,
    theta: Float[np.ndarray, " p"],
) -> float:
    """In the metric, mean over joints. samples: of the estimation record; theta: of the final model. Dry friction that
    changes its sign fills the spectrum of a torque as noise does, and less that of the errors."""
    motion = train.motion
    signals = np.asarray(record.u, np.float64), motion.torque - train.models["after"].torque
    floor = np.minimum(*(spectrum_of(one, reading.dt, record.info.bandwidth)[1] for one in signals))
    of_torque = floor * min(0.5 / reading.dt, record.info.bandwidth or np.inf)  # torques are not filtered here
    still = samples._replace(a=np.zeros_like(samples.a))
    inertial = ((model.errors(theta, samples) - model.errors(theta, still)) ** 2).mean(1)
    squares = of_torque + motion.noise**2 * inertial + filtered_away(model, reading, record, motion, theta)
    return float(np.mean(np.sqrt(squares) / train.spread))


def filtered_away(
    model: Torques, reading: Reading, record: Record, motion: Motion, theta: Float[np.ndarray, " p"]
) -> Float[np.ndarray, " n"]:
    """Mean square of the torque that the filter of the positions takes away while a joint moves, Nm²; zero where
    nothing is filtered, and in sequences that are too short to lose their ends again."""
    edge = reading.edge
    if motion.cutoff is None or motion.v.shape[1] < 4 * edge:
        return np.zeros(motion.v.shape[2])
    once = record._replace(u=motion.torque, y=motion.reading, mask=np.ones(motion.reading.shape, bool))
    again = reading._replace(shift=1.0, at_rest=False).of(once)  # a filtered position belongs to the torque of its row
    reading_once, v, a, torque = (one[:, edge : one.shape[1] - edge] for one in motion[:4])
    inside = motion._replace(reading=reading_once, v=v, a=a, torque=torque)
    fastest = fastest_of(motion)
    first, second = (samples_of(few(one, _SAMPLES), fastest) for one in (inside, again))
    lost = model.errors(theta, first) - model.errors(theta, second)
    among = first.moving & second.moving & (first.v * second.v > 0.0)
    return (lost**2 * among).sum(1) / np.maximum(among.sum(1), 1)
