"""The effects that discovery by torques names, as `discovery.json` says them."""

from typing import Any

import numpy as np

from pgrssnn_jax.discovery.finding import at_bound, described, interval
from pgrssnn_jax.discovery.inverse.discover import Found
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.effects.arm_torques import torque_effects
from pgrssnn_jax.effects.stored import plain

_EVERYWHERE: dict[str, Any] = {"region": "everywhere", "active_fraction": 1.0, "sequence": 1, "intervals_s": []}


def findings(found: Found, command: str) -> list[dict[str, Any]]:
    """Effects by what they predict, then friction that is another one than the physics says."""
    gains = found.chosen.gains
    named = sorted(found.active, key=lambda name: -gains[name].value)
    return [_finding(found, name, command) for name in named] + [
        _friction(found, name, command) for name in found.friction
    ]


def _finding(found: Found, name: str, command: str) -> dict[str, Any]:
    problem = found.problem
    effect, places = problem.effect(name), found.active[name]
    numbers = problem.params(found.theta["after"]).effects[name]
    std = problem.params(found.std["after"]).effects[name]
    without = found.without.get(name)
    said: dict[str, Any] = {
        **described(effect),
        "parameters": {
            key: {
                "value": plain(np.asarray(numbers[key])),
                "std": plain(np.asarray(std[key])),
                "interval": plain(interval(numbers[key], std[key], found.freedom)),
                "unit": meaning.unit,
                "symbol": meaning.symbol,
                "at_bound": at_bound(numbers[key], meaning.bounds, meaning.neutral).tolist(),
            }
            for key, meaning in effect.parameters.items()
        },
        **_EVERYWHERE,
        "p_value": found.p_values.get(name),
        "gain_train": None,
        "gain_test": None if without is None else closed_on_test(found, without),
        "runner_up": None,
        "command": command,
    }
    if effect.channels == "joint":
        said["joints"] = [_joint(problem, int(place)) for place in places if _is_joints(problem, int(place))]
    return said


def _friction(found: Found, name: str, command: str) -> dict[str, Any]:
    """A change of friction that the physics knows: it stands in the numbers of the physics, and is said under the name
    of the effect with its law."""
    problem, places, n = found.problem, found.friction[name], len(found.chosen.kappa)
    known = next(e for e in torque_effects(n, np.ones(n)) if e.name == name)
    key, meaning = next(iter(known.parameters.items()))
    before, after = found.theta["before"], found.theta["after"]
    change, std = np.zeros(n), np.zeros(n)
    joints = [_joint(problem, int(place)) for place in places]
    for joint, place in zip(joints, places, strict=True):
        change[joint - 1], std[joint - 1] = after[place] - before[place], found.std["after"][place]
    numbers = {
        "value": change.tolist(),
        "std": std.tolist(),
        "interval": interval(change, std, found.freedom),
        "unit": meaning.unit,
        "symbol": f"Δ{meaning.symbol}",
        "at_bound": [False] * n,
        "before": [float(before[place]) for place in places],
        "after": [float(after[place]) for place in places],
    }
    return {
        **described(known),
        "title": known.title.replace("More ", "Other "),
        "cause": "friction that is known to the physics is another one than it says",
        "parameters": {key: numbers},
        **_EVERYWHERE,
        "p_value": None,
        "gain_train": None,
        "gain_test": None,
        "runner_up": None,
        "command": command,
        "joints": joints,
    }


def _is_joints(problem: Problem, place: int) -> bool:
    return problem.slots[place].label.endswith("]")


def _joint(problem: Problem, place: int) -> int:
    """From 1, by the index in the label of the number."""
    return int(problem.slots[place].label.rpartition("[")[2].rstrip("]"))


def closed_on_test(found: Found, error: float) -> float:
    """Part of the recalibrated gap on the test record between an error and that of the final model."""
    gap = found.test.models["recalibrated"].error - found.floor
    return (error - found.test.models["after"].error) / gap if gap > 0 else 0.0
