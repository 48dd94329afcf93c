"""From a physics, its records and the settings to a discovery: all bad input is found here, before any work."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from pgrssnn_jax.acceleration.room import make_room
from pgrssnn_jax.discovery.linear import DRAWS
from pgrssnn_jax.discovery.settings import DiscoverySettings
from pgrssnn_jax.discovery.steps import with_short_steps
from pgrssnn_jax.discovery.stretches import check_stretches
from pgrssnn_jax.effects.base import Effect, own_of
from pgrssnn_jax.effects.systems import catalogue, system_of
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.check import of_library
from pgrssnn_jax.records.matching import matched
from pgrssnn_jax.records.record import Record, join, take
from pgrssnn_jax.records.splits import by_dataset, estimation_parts
from pgrssnn_jax.training.plan import check_range, check_size
from pgrssnn_jax.training.settings import TrainingSettings

# Samples: in the search for effects, then for their numbers. A search in 60 misses the disturbance torque of the
# published simulated arm, in 300 the fit of its S ends in another minimum; in 100 both effects come first, as in 150.
_ARM_STRETCHES = (150, 60, 300)
_LEAST_NOISE = 1e-5  # of an output's standard deviation; a 16-bit converter rounds to about 2e-5
_LEAST_BLOCKS = 4  # per fold
_SHORTEST_BLOCK = 8  # samples: of shorter ones the neighbours say what is in them


class Start(Enum):
    """What is known of the start of the test record; a shared one is that of what effects remember too."""

    UNKNOWN = "fitted to its first samples"
    SHARED = "that of the estimation record"
    AT_REST = "zero"


STARTS = {"unknown": Start.UNKNOWN, "shared": Start.SHARED, "rest": Start.AT_REST}


class Setup(NamedTuple):
    """nominal: the physics before any fit; physics: the same with the settings that discovery chooses; effects: the
    catalogue; train and validation: the estimation record's parts, one realisation; estimation: both together;
    start: of the test record; training: settings of the networks that the proof trains."""

    nominal: Physics
    physics: Physics
    effects: tuple[Effect, ...]
    train: Record
    validation: Record
    estimation: Record
    test: Record
    start: Start
    settings: DiscoverySettings
    training: TrainingSettings

    @property
    def first_effects(self) -> tuple[Effect, ...]:
        """Those that are looked for before any elaborate one."""
        return tuple(effect for effect in self.effects if not effect.elaborate)

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """All but those that the user leaves out."""
        return tuple(effect for effect in self.effects if effect.name not in self.settings.without)

    @property
    def own_effects(self) -> tuple[Effect, ...]:
        """Those of the user."""
        return self.effects[len(catalogue(self.physics)) :]


def set_up(
    physics: Physics,
    train: Record,
    test: Record,
    settings: DiscoverySettings,
    training: TrainingSettings,
    *,
    effects: Sequence[Effect] = (),
    validation: Record | None = None,
    realisation: int = 0,
    notify: Callable[[str], None],
) -> Setup:
    """effects: added to the catalogue; realisation: which dataset of the records. Raises `ValueError` with one sentence
    for everything that could turn out to be bad input later."""
    make_room()
    nominal, physics = physics, physics.variant(**_chosen(physics, settings.replace))
    if physics.remark:
        notify(physics.remark)
    catalogue(physics, settings.without, effects)  # raises for names that it does not have
    signals = physics.inputs, physics.outputs, physics.dt
    if validation is not None:
        validation = matched(validation, *signals, where="data: validation")
    parts = estimation_parts(matched(train, *signals, where="data: train"), validation)
    records = [*parts, by_dataset(matched(test, *signals, where="data: test"))]
    count = len(parts[0].u)
    if not isinstance(realisation, int) or not 0 <= realisation < count:
        raise ValueError(f"realisation: expected 0 to {count - 1}, found {realisation!r}")
    if count > 1:
        notify(f"discovery looks at realisation {realisation} of {count}")
    one, aside, tested = (take(record, min(realisation, len(record.u) - 1)) for record in records)
    estimation = join(one, aside)
    if "sub_steps" in physics.settings and "sub_steps" not in settings.replace and not of_library(physics):
        physics = with_short_steps(physics, estimation, notify)
    stretches, fixed = _stretches(settings.stretches, physics, estimation), _fixed(settings.fixed, physics)
    block = _block(settings, estimation) if not stretches else settings.block
    settings = replace(settings, stretches=stretches, fixed=fixed, block=block)
    start = STARTS[tested.info.start]
    _check(physics, estimation, tested, settings, start)
    if system_of(physics) != "arm":  # whose positions are differentiated
        estimation, tested = (_with_least_noise(record, seed) for seed, record in enumerate((estimation, tested)))
    return Setup(
        nominal, physics, catalogue(physics, (), effects), one, aside, estimation, tested, start, settings, training
    )


def _with_least_noise(record: Record, seed: int) -> Record:
    """The record with a little white noise. In simulated data without noise the errors of an integrator (1e-6) and of
    single precision (6e-8) would be findings; in others it changes nothing."""
    measured = np.where(record.mask, np.asarray(record.y, np.float64), np.nan)
    noise = np.random.default_rng(seed).standard_normal(measured.shape) * np.nanstd(measured, (0, 1))
    return record._replace(y=record.y + _LEAST_NOISE * noise)


def _chosen(physics: Physics, wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of the physics that change."""
    present = physics.settings
    found = {name: _replaced(wanted[name], value) for name, value in present.items() if name in wanted}
    return {name: value for name, value in found.items() if value is not present[name] and value != present[name]}


def _replaced(chosen: Any, value: Any) -> Any:
    return chosen.get(value, value) if isinstance(chosen, Mapping) else chosen


def _fixed(names: Sequence[str], physics: Physics) -> list[str]:
    """Those of this physics, by their bare names."""
    found = []
    for name in names:
        of, _, bare = str(name).rpartition(".")
        if of in ("", physics.name):
            if bare not in own_of(physics.params):
                known = f"{list(own_of(physics.params))} of physics {physics.name!r}"
                raise ValueError(f"discovery.fixed: expected some of {known}, found {bare!r}")
            found.append(bare)
    return found


def _stretches(wanted: list[int] | str, physics: Physics, estimation: Record) -> list[int]:
    """auto: an arm's free run over a whole record has no usable gradient, other systems' has."""
    if wanted == "auto":
        return [min(n, estimation.u.shape[1]) for n in _ARM_STRETCHES] if system_of(physics) == "arm" else []
    if not isinstance(wanted, list) or not all(type(n) is int and n >= 2 for n in wanted):
        raise ValueError(f"discovery.stretches: expected auto or a list of lengths in samples, found {wanted!r}")
    return wanted


def _block(settings: DiscoverySettings, estimation: Record) -> int:
    """Samples of a block: in short records fewer than asked for, so that every fold has some."""
    sequences, samples = estimation.u.shape[:2]
    blocks = _LEAST_BLOCKS * settings.folds
    least = min(settings.block, _SHORTEST_BLOCK)
    longest = min(samples, sequences * samples // blocks)
    if longest < least:
        wanted = max(least, -(-least * blocks // sequences))
        raise ValueError(
            f"data: train: expected at least {wanted} samples, {_LEAST_BLOCKS} blocks of {least} for each of "
            f"discovery.folds={settings.folds}, found {samples}"
        )
    return min(settings.block, longest)


def _check(physics: Physics, estimation: Record, test: Record, settings: DiscoverySettings, start: Start) -> None:
    for name, record in (("train", estimation), ("test", test)):
        still = []
        for kind, channels in (("u", physics.inputs), ("y", physics.outputs)):
            values, mask = np.asarray(getattr(record, kind)), np.asarray(record.mask)
            for k, signal in enumerate(channels):
                counted = values[..., k][mask[..., k]] if kind == "y" else values[..., k]
                check_range(f"data: {name}", signal, counted)
                if not counted.size and name == "test" and mask.any():
                    continue  # other outputs were measured there
                if not counted.size:
                    expected = "at least one measured sample"
                    raise ValueError(f"data: {name}: {signal.name}: expected {expected}, found no measured sample")
                check_size(f"data: {name}", counted)
                if counted.max() == counted.min():
                    still.append((kind, signal, counted.flat[0]))
        # Of several inputs one may stand still, a valve say: the others tell what the physics lacks.
        moved = len(physics.inputs) > sum(kind == "u" for kind, _, _ in still)
        for kind, signal, value in still if name == "train" else ():
            if kind == "y" or not moved:
                found = f"{value:g} {signal.unit}".rstrip()
                raise ValueError(f"data: train: {signal.name}: expected a signal that varies, found only {found}")
    for length in settings.stretches:
        check_stretches(estimation, length)
    draws = min(settings.draws, DRAWS) if settings.stretches else settings.draws
    if settings.p_value * (1 + draws) < 1.0:
        raise ValueError(
            f"discovery.p_value: expected at least 1 / {1 + draws}, the least that {draws} draws of the null can tell, "
            f"found {settings.p_value:g}"
        )
    time = test.u.shape[1]
    if start is Start.UNKNOWN and time <= settings.n_init:
        raise ValueError(
            f"discovery.n_init: expected fewer than the {time} samples of the test record, found {settings.n_init}"
        )
