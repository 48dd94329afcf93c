"""How a record is read: at which cut-off positions are filtered, and to which moment a torque belongs.

    score = mean over joints of log mean e²,   e: torque errors of fast samples, left out of a fit with all effects

Torques are not filtered, so that this score compares all cut-offs. At a wrong moment every speed is off by the
acceleration times the delay, and its viscous friction is off in proportion to the acceleration. Extra motor inertia
then compensates for that friction. A torque is taken to be held over its sample unless another moment predicts left-out
blocks better (95 %): noisy positions do not tell half a sample, and a wrong one is read as friction.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.discovery.inverse.evidence import Errors, Samples, fastest_of, samples_of
from pgrssnn_jax.discovery.inverse.fit import Gain, gain
from pgrssnn_jax.discovery.inverse.motion import Motion, few, filters, motion_of
from pgrssnn_jax.discovery.inverse.select import Active, Search, with_everything
from pgrssnn_jax.discovery.inverse.structures import STRUCTURE, Tried
from pgrssnn_jax.records.record import Record

FAST = 0.2  # of a joint's highest speed
COARSE, _FINE = 500, 2000  # samples of each joint: enough to compare cut-offs, and structures; for the moment
_SHIFTS = (0.0, 0.5, 1.0)  # samples between a torque and the motion that belongs to it
_HELD = 0.5  # of a torque that acts from one position until the next is read, as a step of the physics takes it
# Standard errors, 95 %. Of eight records that were looked at no wrong moment gained more than 1.2 of them, and the
# right ones, where they are not that of a held torque, 2.8 to 9.
_CLEAR = 1.96
_OCTAVES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)  # of cut-offs above that of the spectrum
_IMITATE = ("torque_gain", "stribeck_friction", "wrist_coupling")


class Reading(NamedTuple):
    """How records are read: sample time, s; cut-off, Hz; samples between a torque and the motion that belongs to it;
    whether sequences begin at rest with all joints at zero; samples left out at the ends."""

    dt: float
    cutoff: float
    shift: float
    at_rest: bool
    edge: int

    def of(self, record: Record) -> Motion:
        return motion_of(record, self.dt, at_rest=self.at_rest, shift=self.shift, cutoff=self.cutoff, edge=self.edge)

    @property
    def words(self) -> str:
        return f"positions low-pass filtered at {self.cutoff:.2g} Hz" if self.cutoff < 1.0 / self.dt else "no filter"


def best_reading(search: Search, best: Tried, record: Record, motion: Motion, *, at_rest: bool) -> Reading:
    """The cut-off with the lowest score, from few samples; with it, from more samples, the shift of a torque that is
    held over its sample, or another one that clearly predicts better.

    Gains are left out of the effects, because they imitate a shift. Slow samples are left out of the fits: a few of
    them, in which the friction has the wrong sign, would decide on the shift."""
    fastest, dt = fastest_of(motion), motion.spacing
    theta, active = _begun(search, best)

    def tried(reading: Reading, count: int) -> tuple[Samples, Errors]:
        """Samples, of which the fast ones count, and their left-out errors."""
        samples = samples_of(few(reading.of(record), count), fastest)
        fast = np.abs(samples.v) > FAST * fastest[:, None]
        samples = samples._replace(moving=fast)
        return samples, search._replace(samples=samples).linear(theta, active).left_out

    def missed(reading: Reading) -> float:
        samples, left_out = tried(reading, COARSE)
        joints = zip(left_out, samples.moving, strict=True)
        return float(np.mean([np.log(np.mean(error[among] ** 2)) for error, among in joints]))

    unfiltered = 1.0 / dt
    first = motion.cutoff or unfiltered
    cutoffs = {cutoff if filters(cutoff, dt) else unfiltered for cutoff in (first * 2.0**k for k in _OCTAVES)}
    edge = record.u.shape[1] - motion.v.shape[1]
    edge = edge if at_rest else edge // 2
    readings = [Reading(dt, cutoff, shift, at_rest, edge) for cutoff in sorted(cutoffs) for shift in _SHIFTS]
    found = min(readings, key=missed)
    samples, left_out = tried(found._replace(shift=_HELD), _FINE)

    def better(shift: float) -> Gain:
        others, errors = tried(found._replace(shift=shift), _FINE)
        both = samples.moving & others.moving
        return gain(left_out, errors, samples._replace(moving=both), search.kappa)

    gains = {shift: better(shift) for shift in _SHIFTS if shift != _HELD}
    clear = {shift: one.value for shift, one in gains.items() if one.clear(_CLEAR)}
    return found._replace(shift=max(clear, key=clear.__getitem__, default=_HELD))


def _begun(search: Search, best: Tried) -> tuple[Float[np.ndarray, " p"], Active]:
    """All effects but those that imitate a shift, and angles near those of the best structure."""
    problem, begun = search.problem, with_everything(search, best, _IMITATE)
    theta, angles = begun.fit.theta.copy(), {e.name: problem.of(e.name) for e in problem.effects if e.name in STRUCTURE}
    for places in angles.values():
        theta[places] = best.fit.theta[places]
    return theta, {**begun.active, **angles}
