"""From the composed configuration to a discovery: all bad input is found here, before a byte is written."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from pgrssnn_jax.cli.plan import check_range, conventions, load_physics, load_splits
from pgrssnn_jax.discovery.linear import DRAWS
from pgrssnn_jax.discovery.look import Rules
from pgrssnn_jax.discovery.stretches import check_stretches
from pgrssnn_jax.effects.systems import catalogue, system_of
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.records.record import Record, Splits, join, take
from pgrssnn_jax.training.settings import call_with

_ARM_STRETCHES = (60, 300)  # samples: while nothing is known, and beside the first effect
_LEAST_BLOCKS = 4  # per fold
_SHORTEST_BLOCK = 8  # samples: of shorter ones the neighbours say what is in them


@dataclass(frozen=True)
class DiscoverySettings:
    """What `conf/discovery/standard.yaml` says, checked.

    replace: settings of the physics that discovery chooses itself, where the physics has them (a mapping replaces the
    values that it names); fixed: parameters that are taken as given, NAME or PHYSICS.NAME; tolerance: relative standard
    deviation of the others, null: nothing is known of them (as it is where stretches are fitted); stretches: lengths in
    samples, while nothing is known, beside one effect and so on, empty: whole records; without: effects that the
    catalogue is to do without; starts: of the recalibration; folds, block: of the cross-validation; n_init: first
    samples of the test record from which its start is fitted where it is not known; network_epochs: of the PG-RSSNN
    that is trained on the old and the new physics, 0 for none.
    """

    replace: Mapping[str, Any]
    fixed: list
    tolerance: float | None
    stretches: Any
    without: list
    starts: int
    folds: int
    block: int
    n_init: int
    steps: int
    p_value: float
    share: float
    most: int
    draws: int
    seed: int
    network_epochs: int

    def __post_init__(self) -> None:
        checks = {"starts": 1, "folds": 2, "block": 2, "n_init": 1, "steps": 1, "most": 1, "draws": 99, "seed": 0}
        for name, least in {**checks, "network_epochs": 0}.items():
            if (value := getattr(self, name)) < least:
                raise ValueError(f"discovery.{name}: expected at least {least}, found {value}")
        for name, value in (("p_value", self.p_value), ("share", self.share)):
            if not 0.0 < value < 1.0:
                raise ValueError(f"discovery.{name}: expected a number between 0 and 1, found {value:g}")
        if self.tolerance is not None and not self.tolerance > 0.0:
            raise ValueError(f"discovery.tolerance: expected null or a number above 0, found {self.tolerance:g}")

    @property
    def rules(self) -> Rules:
        return Rules(p_value=self.p_value, share=self.share, most=self.most, draws=self.draws)


class Start(Enum):
    """What is known of the start of the test record; a shared one is that of what effects remember too."""

    UNKNOWN = "fitted to its first samples"
    SHARED = "that of the estimation record"
    AT_REST = "zero"


class Setup(NamedTuple):
    """group: the settings of the physics that was used; estimation: everything that is not test; start: of
    the test record."""

    config: dict[str, Any]
    group: dict[str, Any]
    physics: Physics
    estimation: Record
    test: Record
    start: Start
    settings: DiscoverySettings


def set_up(config: Mapping[str, Any], notify: Callable[[str], None]) -> Setup:
    """config: the resolved configuration as plain data. Raises `ValueError` with one sentence."""
    settings = call_with(DiscoverySettings, config["discovery"], "discovery")
    group = {name: _replaced(settings.replace.get(name, value), value) for name, value in config["physics"].items()}
    if config["resume"] is not None:
        raise ValueError(f"resume: expected null, a discovery is started again, found {config['resume']!r}")
    if group.get("effects") is not None:
        raise ValueError(f"physics.effects: expected null, what is missing is to be found, found {group['effects']!r}")
    group["effects"] = None
    physics = load_physics(group)
    if physics.remark:
        notify(physics.remark)
    catalogue(physics, settings.without)
    whole = {name: None if name == "window" else value for name, value in config["data"].items()}
    splits = load_splits(whole, physics, notify)
    if len(splits.train.u) > 1:
        notify(
            f"discovery looks at the first of {len(splits.train.u)} realisations (data.realisations=1 loads no more)"
        )
    one = Splits(*(take(record, 0) for record in splits))
    estimation = join(one.train, one.validation)
    shared = conventions(config["data"]).shared_initial_state
    stretches, fixed = _stretches(settings.stretches, physics, estimation), _fixed(settings.fixed, physics)
    block = _block(settings, estimation) if not stretches else settings.block
    settings = replace(settings, stretches=stretches, fixed=fixed, block=block)
    start = Start.SHARED if shared else Start.AT_REST if config["initial_state"] == "zero" else Start.UNKNOWN
    _check(physics, estimation, one.test, settings, start)
    return Setup(dict(config), group, physics, estimation, one.test, start, settings)


def _replaced(chosen: Any, value: Any) -> Any:
    return chosen.get(value, value) if isinstance(chosen, Mapping) else chosen


def _fixed(names: Sequence[str], physics: Physics) -> list[str]:
    """Those of this physics, by their bare names."""
    found = []
    for name in names:
        of, _, bare = str(name).rpartition(".")
        if of in ("", physics.name):
            if bare not in physics.params:
                known = f"{list(physics.params)} of physics {physics.name!r}"
                raise ValueError(f"discovery.fixed: expected some of {known}, found {bare!r}")
            found.append(bare)
    return found


def _stretches(wanted: list | str, physics: Physics, estimation: Record) -> list[int]:
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
        for kind, channels in (("u", physics.inputs), ("y", physics.outputs)):
            values, mask = np.asarray(getattr(record, kind)), np.asarray(record.mask)
            for k, signal in enumerate(channels):
                counted = values[..., k][mask[..., k]] if kind == "y" else values[..., k]
                check_range(f"data: {name}", signal, counted)
                if name == "train" and not (counted.size and counted.max() > counted.min()):
                    found = f"{counted.flat[0]:g} {signal.unit}".rstrip() if counted.size else "no measured sample"
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
