"""One finding: an effect with its numbers, where and when it acts, what it closes, and what would do nearly as well."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from pgrssnn_jax.discovery.candidates import Model
from pgrssnn_jax.discovery.discover import Discovery
from pgrssnn_jax.discovery.locate import box, intervals
from pgrssnn_jax.discovery.problem import Problem, Signals
from pgrssnn_jax.effects.base import Effect
from pgrssnn_jax.effects.places import LEVEL, VELOCITY, levels, velocities
from pgrssnn_jax.physics.base import Physics

_INTERVALS = 50  # written, at most
_MEANT = 2.0  # standard deviations by which a joint's number must differ from neutral to be named


def finding(found: Discovery, name: str, command: str) -> dict[str, Any]:
    problem, selection = found.problem, found.selection
    effect, screening, final = problem.effect(name), selection.screenings[name], selection.final
    numbers = problem.params(final.estimate.theta).effects[name]
    std = problem.params(final.deviation).effects[name]
    own = next((c for c in screening.candidates if c.name == name), None)
    runner = next((c for c in screening.candidates if c.name != name and c.model), None)
    acting = _acting(found, effect, numbers)
    gap = selection.first.rms() - selection.floor

    def closed(better: float) -> float:
        return (screening.rms() - better) / gap if gap > 0 else 0.0

    said: dict[str, Any] = {
        **described(effect),
        "channel_names": channel_names(problem.physics, effect),
        "acts_at": acts_at(problem, name, final.estimate.theta),
        "parameters": fitted(problem, final, name),
        "region": _region(found, acting),
        "active_fraction": float(acting.sum() / within_record(found.signals).sum()),
        **when(acting, problem.physics.dt),
        "p_value": screening.p_value(own) if own else None,
        "gain_train": closed(selection.last.rms()),
        "gain_test": found.proved.closed(found.test.without[name], found.test.after.error),
        "runner_up": {"name": runner.name, "gain": closed(screening.rms(runner.model))} if runner else None,
        "command": command,
    }
    if effect.channels == "joint":
        said["joints"] = _joints(effect, numbers, std)
    return said


def fitted(problem: Problem, model: Model, name: str) -> dict[str, Any]:
    """The numbers of an effect in a model."""
    effect = problem.effect(name)
    numbers, std = (problem.params(one).effects[name] for one in (model.estimate.theta, model.deviation))
    return {
        key: {
            "value": np.asarray(numbers[key]).tolist(),
            "std": np.asarray(std[key]).tolist(),
            "interval": interval(numbers[key], std[key], model.freedom),
            "unit": meaning.unit,
            "symbol": meaning.symbol,
            "at_bound": at_bound(numbers[key], meaning.bounds, meaning.neutral).tolist(),
        }
        for key, meaning in effect.parameters.items()
    }


def described(effect: Effect) -> dict[str, Any]:
    """An effect in words."""
    return {
        "name": effect.name,
        "title": effect.title or effect.name.replace("_", " ").capitalize(),
        "equation": effect.equation,
        "cause": effect.cause,
        "acts_on": effect.acts_on,
        "channels": effect.channels,
    }


def at_bound(value: Any, bounds: tuple[float, float], neutral: float | None) -> np.ndarray:
    """Is a number where its fit was not let go further? Where it changes nothing it may well be."""
    ends = [end for end in bounds if np.isfinite(end) and end != neutral]
    near = [np.isclose(value, end, rtol=1e-9, atol=0.0) for end in ends]
    return np.asarray(np.any([np.zeros_like(value, bool), *near], axis=0))


def interval(value: Any, std: Any, freedom: float) -> list[Any]:
    """95 % interval, lowest and highest, of an estimate with so many degrees of freedom (Student's t)."""
    half = scipy.stats.t.ppf(0.975, freedom) * np.asarray(std)
    return [(np.asarray(value) - half).tolist(), (np.asarray(value) + half).tolist()]


def channel_names(physics: Physics, effect: Effect) -> list[str]:
    """Signals that an effect has one number for each of; empty where it has not."""
    states = {VELOCITY: velocities(physics), LEVEL: levels(physics)}.get(effect.channels, [])
    signals = {"input": physics.inputs, "output": physics.outputs}.get(effect.channels, ())
    names = [signal.name for signal in signals] or [physics.states[place.state].name for place in states]
    return names if any(shape == (len(names),) for shape in effect.shapes.values()) else []


def acts_at(problem: Problem, name: str, theta: Float[np.ndarray, " p"]) -> list[str]:
    """Those of the channels at which any number that is fitted is not neutral."""
    effect = problem.effect(name)
    moved = {
        slot.element[0]
        for i, slot in enumerate(problem.slots)
        if slot.effect == name and slot.element and effect.parameters[slot.path[-1]].trainable
        if theta[i] != problem.theta[i]
    }
    return [one for k, one in enumerate(channel_names(problem.physics, effect)) if k in moved]


def _joints(effect: Effect, numbers: Mapping[str, Any], std: Mapping[str, Any]) -> list[int]:
    """Joints, from 1, whose numbers stand out of their uncertainty."""
    neutral = effect.neutral()
    meant: set[int] = set()
    for key in effect.shapes:
        value, spread = np.ravel(numbers[key]), np.ravel(std[key])
        away = np.abs(value - np.ravel(neutral[key]))
        meant |= {int(j) + 1 for j in np.flatnonzero((away > _MEANT * spread) & (away > 0))}
    return sorted(meant)


def _acting(found: Discovery, effect: Effect, numbers: Mapping[str, Any]) -> np.ndarray:
    """When the effect acts, `[seq, time]`, in the free run of the final model."""
    x, u = found.train.after.x, found.signals.u
    within = within_record(found.signals)
    if effect.active is None:
        return within
    return within & np.stack([np.asarray(effect.active(numbers, *pair)) for pair in zip(x, u, strict=True)])


def when(acting: np.ndarray, dt: float) -> dict[str, Any]:
    """Intervals of the first sequence, from 1, in which anything acts."""
    first = int(np.argmax(acting.any(1)))
    return {"sequence": first + 1, "intervals_s": [list(pair) for pair in intervals(acting[first], dt)][:_INTERVALS]}


def within_record(signals: Signals) -> np.ndarray:
    """Samples `[seq, time]` up to the last measured one: what follows fills a shorter sequence up."""
    measured = np.any(signals.weight > 0, -1)
    still_to_come = np.cumsum(measured[:, ::-1], 1)[:, ::-1]
    return still_to_come > 0


def _region(found: Discovery, acting: np.ndarray) -> str:
    within = within_record(found.signals)
    if acting[within].all():
        return "everywhere"
    if not acting.any():
        return "nowhere in the estimation record"
    physics = found.problem.physics
    values = np.concatenate([found.train.after.x[..., : len(physics.states)], found.signals.u], -1)
    return box(acting[within] * 1.0, values[within], (*physics.states, *physics.inputs)).rule.split(":")[0]
