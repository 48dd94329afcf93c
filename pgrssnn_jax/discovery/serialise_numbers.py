"""The numbers of a discovery as `discovery.json` says them: of the physics before and after, and of every effect."""

from typing import Any

import numpy as np

from pgrssnn_jax.discovery.discover import Discovery
from pgrssnn_jax.discovery.finding import at_bound, interval
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.effects.base import add, effects_of, own_of
from pgrssnn_jax.effects.stored import plain


def about_data(setup: Setup, timing: str) -> dict[str, Any]:
    """Where the records come from, and how many samples were measured."""
    info, counts = setup.estimation.info, [int(one.mask.any(-1).sum()) for one in (setup.estimation, setup.test)]
    return {
        "source": info.source,
        "origin": info.origin,
        "n_train": counts[0],
        "n_test": counts[1],
        "dt": setup.physics.dt,
        "timing": timing,
    }


def parameters(found: Discovery) -> dict[str, Any]:
    final = found.selection.final
    std, theta = final.deviation, final.estimate.theta
    free = [i for name in (None, *found.selection.final.estimate.active) for i in found.problem.of(name)]
    slots, low, high = found.problem.slots, found.problem.low, found.problem.high
    return {
        slots[i].label: {
            "value": float(theta[i]),
            "std": float(std[i]),
            "interval": interval(theta[i], std[i], final.freedom),
            "unit": slots[i].meaning.unit,
            "at_bound": bool(at_bound(theta[i], (float(low[i]), float(high[i])), slots[i].meaning.neutral)),
        }
        for i in free
    }


def recalibration(found: Discovery) -> dict[str, Any]:
    problem, recalibrated = found.problem, found.selection.recalibrated
    after, std = recalibrated.estimate.theta, recalibrated.deviation
    return {
        problem.slots[i].label: {
            "before": float(problem.theta[i]),
            "after": float(after[i]),
            "std": float(std[i]),
            "interval": interval(after[i], std[i], recalibrated.freedom),
            "unit": problem.slots[i].meaning.unit,
        }
        for i in problem.of(None)
    }


def departures(found: Discovery) -> list[dict[str, Any]]:
    """Numbers of the physics that left their prior."""
    final, slots = parameters(found), found.problem.slots
    scales = found.problem.scales(np.array([one.place for one in found.departures], int))
    return [
        {
            "parameter": slots[one.place].label,
            "before": one.before,
            "after": one.after,
            "change": float((one.after - one.before) / scale),
            "prior": list(one.prior),
            **{key: final[slots[one.place].label][key] for key in ("interval", "unit", "at_bound")},
        }
        for one, scale in zip(found.departures, scales, strict=True)
    ]


def numbers(found: Discovery) -> dict[str, Any]:
    """Parameters of the physics and of every effect, for `physics.effects=FILE`; infinite limits as null."""
    theta = found.selection.final.estimate.theta
    params, known = found.problem.params(theta), found.problem.known(theta)
    active, there = found.selection.final.estimate.active, effects_of(known)
    order = [*there, *(effect.name for effect in found.problem.effects if effect.name in active)]
    own = {name: own_of(known)[name] for name in own_of(found.problem.physics.params)}
    effects = {name: effects_of(params)[name] for name in order}
    return {"parameters": plain(own), "effects": plain(effects), "order": order}


def initial_state(found: Discovery) -> dict[str, float]:
    """Of the physics, and of what the effects found remember."""
    problem, final = found.problem, found.selection.final.estimate
    states = add(problem.physics, *map(problem.effect, final.active)).states
    begun = dict(zip((state.name for state in problem.full.states), final.x0[0], strict=True))
    return {state.name: float(begun[state.name]) for state in states}
