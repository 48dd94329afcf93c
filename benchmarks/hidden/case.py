"""One hidden-effect case: what is in the data, what the tool may know, and the data.

y = reading of a simulated plant with the effects `truth` + e,   e: noise of standard deviation `noise` (`noise.py`)
floor = RMS(y_test - noise-free reading),   change = RMS(noise-free reading - that of the plant without effects)
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from pgrssnn_jax.records.record import Record, RecordInfo, record

# their order is part of the seeds
SYSTEMS = (
    *("tanks", "lgssm", "arm", "pendulum", "servo", "duffing", "chain"),
    *("hysteretic", "drive", "circuit", "reactor"),
)


class Case(NamedTuple):
    """truth: names of the effects in the data, () for none; accepted: per name of truth, the names that are right.
    removed: names that the catalogue must be deprived of, so that truth comes out as unknown. magnitudes: sizes of the
    effects, the plant's true parameters and its state at the start of both records. noise: standard deviation, in the
    unit of the output; noise_kind: one of `noise.KINDS`. physics: keyword arguments of the nominal base physics, which
    is wrong by its parameters too. change: what the effects do to the test output, before any refit (for the arm: RMSE
    of the true parameters without the effects under the recorded torque). units: what inputs and outputs
    of the simulator were multiplied by.
    """

    system: str
    seed: int
    truth: tuple[str, ...]
    accepted: tuple[tuple[str, ...], ...]
    removed: tuple[str, ...]
    magnitudes: dict[str, Any]
    noise: float
    physics: dict[str, Any]
    train: Record
    test: Record
    floor: float
    change: float
    noise_kind: str = "white"
    units: tuple[float, float] = (1.0, 1.0)


_HELD_BY = {  # of every system's family: a curve through points may be any straight line
    "sensor_offset": ("sensor_nonlinearity",),
    "sensor_gain": ("sensor_nonlinearity",),
}


class Catalogue(NamedTuple):
    """What can be hidden in a system.

    acts_on: per effect the part of the plant it acts on; two effects of a double act on different parts. identical:
    other names of the very same physics. family: other names that could represent the effect exactly or are its kin,
    and are removed with it. recalibrated: effects that a refit of the base parameters takes up wholly, so that removing
    their names leaves nothing unknown. clashes: pairs of which one hides the other, in the order of acts_on. noises:
    standard deviations, in the unit of the output. unnamed: effects for which the library has no name, so that they are
    hidden alone, and only to come out as unknown.
    """

    acts_on: dict[str, str]
    noises: tuple[float, ...]
    identical: dict[str, tuple[str, ...]] = {}  # noqa: RUF012 - never written to
    family: dict[str, tuple[str, ...]] = {}  # noqa: RUF012
    recalibrated: tuple[str, ...] = ()
    clashes: tuple[tuple[str, str], ...] = ()
    unnamed: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[str, ...]:
        return tuple(name for name in self.acts_on if name not in self.unnamed)

    def accepted(self, truth: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
        return tuple((name, *self.identical.get(name, ())) for name in truth)

    def removed_with(self, name: str) -> tuple[str, ...]:
        own = (*self.identical.get(name, ()), *self.family.get(name, ()), *_HELD_BY.get(name, ()))
        return tuple(sorted({name, *own}))

    def doubles(self) -> list[tuple[str, str]]:
        names = self.named
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
        return [(a, b) for a, b in pairs if self.acts_on[a] != self.acts_on[b] and (a, b) not in self.clashes]

    def check(self, truth: tuple[str, ...]) -> None:
        unknown = [name for name in truth if name not in self.acts_on]
        if unknown:
            raise ValueError(f"hidden case: truth: expected names among {sorted(self.acts_on)}, found {unknown}")


def streams(system: str, seed: int, names: str) -> dict[str, np.random.Generator]:
    """Independent random streams by name, so that another noise leaves inputs and magnitudes as they are."""
    split = names.split()
    root = np.random.default_rng([seed, SYSTEMS.index(system)])
    return dict(zip(split, root.spawn(len(split)), strict=True))


def measured(u: Float[np.ndarray, "*seq time u"], y: Float[np.ndarray, "*seq time y"], info: RecordInfo) -> Record:
    return record(np.ascontiguousarray(u), np.ascontiguousarray(y), info)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
