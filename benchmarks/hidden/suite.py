"""Suites of hidden-effect cases, balanced over effects and noise levels.

    single   one effect                    double    two effects on different parts of the plant
    none     parameters wrong, no effect   removed   one effect whose names the catalogue is deprived of, or that has
                                              none: unknown

A plan is cheap and says everything; `build` makes its data.
"""

from collections.abc import Iterator, Sequence
from itertools import count as forever
from typing import NamedTuple

import numpy as np

from . import arm, chain, circuit, drive, duffing, hysteretic, lgssm, pendulum, reactor, servo, tanks, units
from .case import SYSTEMS, Case, Catalogue
from .noise import KINDS as NOISES

KINDS = ("single", "double", "none", "removed")
_MODULES = {
    "tanks": tanks,
    "lgssm": lgssm,
    "arm": arm,
    "pendulum": pendulum,
    "servo": servo,
    "duffing": duffing,
    "chain": chain,
    "hysteretic": hysteretic,
    "drive": drive,
    "circuit": circuit,
    "reactor": reactor,
}
_WITH_PROCESS_NOISE = ("lgssm", "servo", "duffing", "chain", "hysteretic", "drive", "circuit", "reactor")
_MOST = 1000  # cases of one suite: the seeds of two suites do not meet


class Plan(NamedTuple):
    system: str
    seed: int
    kind: str
    truth: tuple[str, ...]
    removed: tuple[str, ...]
    noise: float
    noise_kind: str = "white"
    in_other_units: bool = False


def build(plan: Plan) -> Case:
    more = {} if plan.system == "arm" else {"noise_kind": plan.noise_kind}
    case = _MODULES[plan.system].build(plan.seed, plan.truth, noise=plan.noise, removed=plan.removed, **more)
    return units.case_in(case, units.drawn(plan.system, plan.seed)) if plan.in_other_units else case


def catalogue(system: str) -> Catalogue:
    return _MODULES[system].CATALOGUE


def noises_of(system: str) -> tuple[str, ...]:
    if system == "arm":
        return ("white",)
    return tuple(one for one in NOISES if one != "process" or system in _WITH_PROCESS_NOISE)


def plans(
    system: str, count: int, seed: int, kinds: Sequence[str] = KINDS, noises: Sequence[str] = ("white",)
) -> list[Plan]:
    """`count` plans in all, the kinds in turn; the first case of each has the first noise, or another by the seed.

    Raises `ValueError` for an unknown system, kind or noise, or a bad count."""
    if system not in SYSTEMS:
        raise ValueError(f"hidden cases: system: expected one of {SYSTEMS}, found {system!r}")
    if not kinds or not set(kinds) <= set(KINDS):
        raise ValueError(f"hidden cases: kinds: expected some of {KINDS}, found {tuple(kinds)}")
    known_noises = noises_of(system)
    if not noises or not set(noises) <= set(NOISES):
        raise ValueError(f"hidden cases: noises: expected some of {NOISES}, found {tuple(noises)}")
    noises = [one for one in noises if one in known_noises]
    if not 0 <= count <= _MOST:
        raise ValueError(f"hidden cases: count: expected 0 to {_MOST}, found {count}")
    known = catalogue(system)
    root = np.random.default_rng([seed, SYSTEMS.index(system)])
    decks = {kind: _deck(kind, known, rng) for kind, rng in zip(KINDS, root.spawn(len(KINDS)), strict=True)}
    found = []
    for i in range(count):
        kind = kinds[i % len(kinds)]
        truth, noise = next(decks[kind])
        removed = known.removed_with(truth[0]) if kind == "removed" else ()
        noise_kind = noises[(i // len(kinds) + seed) % len(noises)] if noises else "white"
        found.append(Plan(system, seed * _MOST + i, kind, truth, removed, noise, noise_kind))
    return found


def _deck(kind: str, known: Catalogue, rng: np.random.Generator) -> Iterator[tuple[tuple[str, ...], float]]:
    """Every effect once before any comes again; each meets the noise levels in turn."""
    options: list[tuple[str, ...]] = {
        "single": [(name,) for name in known.named],
        "double": known.doubles(),
        "none": [()],
        "removed": [(name,) for name in known.acts_on if name not in known.recalibrated],
    }[kind]
    used = dict.fromkeys(known.acts_on, 0)
    levels = {option: int(rng.integers(len(known.noises))) for option in options}
    dealt = dict.fromkeys(options, 0)
    for _ in forever():
        fewest = [(sum(used[name] for name in option), dealt[option], rng.random()) for option in options]
        option = options[min(range(len(options)), key=fewest.__getitem__)]
        yield option, known.noises[(levels[option] + dealt[option]) % len(known.noises)]
        dealt[option] += 1
        for name in option:
            used[name] += 1
