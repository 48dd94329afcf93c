"""What discovery says: `discovery.json` and the arrays of its pictures, from what was found out."""

import math
from typing import Any

import numpy as np

from pgrssnn_jax.discovery.finding import (
    at_bound,
    closed_on_test,
    deviations,
    finding,
    floor,
    jackknife,
    when,
    within_record,
)
from pgrssnn_jax.discovery.locate import box, clear, signal_map
from pgrssnn_jax.discovery.look import Candidate, Stage
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.setup import Setup, Start
from pgrssnn_jax.discovery.untestable import untestable
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.discovery.workflow import Discovery
from pgrssnn_jax.effects.base import add, effects_of, own_of
from pgrssnn_jax.effects.stored import physics_to_json, plain


def discovery_json(found: Discovery, setup: Setup, *, command: str) -> dict[str, Any]:
    """The content of `discovery.json`; `numbers` and `physics` are what `physics.effects=FILE` reads."""
    problem, estimation = found.problem, setup.estimation
    effects = [finding(found, name, command) for name in _by_gain(found)]
    verdict = found.judged.verdict
    return {
        "schema": 1,
        "system": problem.physics.name,
        "data": {
            "source": estimation.info.source,
            "origin": estimation.info.origin,
            "n_train": int(estimation.mask.any(-1).sum()),
            "n_test": int(setup.test.mask.any(-1).sum()),
            "dt": problem.physics.dt,
        },
        "verdict": str(verdict),
        "sentence": _sentence(found, effects),
        "effects": effects,
        "alternatives": _alternatives(found),
        "untestable": untestable(found),
        "formula": _formula(found),
        "spectrum": _spectrum(found, setup),
        "follows": found.beyond.follows._asdict() if found.beyond.follows else None,
        "disagreement": disagreement(found),
        "recalibration": _recalibration(found),
        "parameters": _parameters(found),
        "gap": _gap(found),
        "ranking": _ranking(found),
        "network": None,
        "null": {"threshold": _threshold(found.found.first, setup), "draws": len(found.found.first.null)},
        "seconds": found.seconds,
        "inputs": [{"name": s.name, "unit": s.unit} for s in problem.physics.inputs],
        "outputs": [{"name": s.name, "unit": s.unit} for s in problem.physics.outputs],
        "states": [{"name": s.name, "unit": s.unit} for s in problem.physics.states],
        "physics": physics_to_json(setup.physics)["physics"],
        "numbers": _numbers(found),
        "initial_state": _initial_state(found) if setup.start is Start.SHARED else None,
    }


def _by_gain(found: Discovery) -> list[str]:
    """Names of the effects, the one without which most would be left unexplained first."""
    return sorted(found.found.final.estimate.active, key=lambda name: -found.found.stages[name].rms())


def _parameters(found: Discovery) -> dict[str, Any]:
    std, theta = deviations(found), found.found.final.estimate.theta
    free = [i for name in (None, *found.found.final.estimate.active) for i in found.problem.of(name)]
    slots, low, high = found.problem.slots, found.problem.low, found.problem.high
    return {
        slots[i].label: {
            "value": float(theta[i]),
            "std": float(std[i]),
            "unit": slots[i].meaning.unit,
            "at_bound": bool(at_bound(theta[i], (float(low[i]), float(high[i])), slots[i].meaning.neutral)),
        }
        for i in free
    }


def _recalibration(found: Discovery) -> dict[str, Any]:
    problem, folds = found.problem, found.found.recalibrated.folds
    std = jackknife(folds)
    after = found.found.recalibrated.estimate.theta
    return {
        problem.slots[i].label: {
            "before": float(problem.theta[i]),
            "after": float(after[i]),
            "std": float(std[i]),
            "unit": problem.slots[i].meaning.unit,
        }
        for i in problem.of(None)
    }


def _gap(found: Discovery) -> dict[str, Any]:
    test, train = found.test, found.train
    pairs = {name: {"train": getattr(train, name).error, "test": getattr(test, name).error} for name in test._fields}
    return {
        "metric": found.merit.name,
        "unit": found.merit.unit,
        **pairs,
        "test_interval": {name: list(getattr(test, name).interval) for name in test._fields},
        "n_init": found.merit.n_init,
        "floor": floor(found),
        "closed_fraction": closed_on_test(found, test.recalibrated.error, test.after.error),
    }


def _ranking(found: Discovery) -> list[dict[str, Any]]:
    """The first look at the whole catalogue: gain in parts of the error energy, in blocks left out where candidates
    were cross-validated, else in the fit."""
    stage, active = found.found.first, found.found.final.estimate.active
    return [
        {
            "name": c.name,
            "gain": _energy_gain(stage, c),
            "cross_validated": c.validated is not None,
            "p_value": stage.p_value(c),
            "chosen": c.name in active,
        }
        for c in stage.candidates
    ]


def _energy_gain(stage: Stage, candidate: Candidate) -> float:
    return candidate.gain if candidate.validated is None else 1.0 - candidate.cost / stage.base.cost


def _threshold(stage: Stage, setup: Setup) -> float:
    return float(np.quantile(stage.null, 1.0 - setup.settings.p_value)) if len(stage.null) else math.nan


def _alternatives(found: Discovery) -> list[dict[str, Any]]:
    said = []
    for name, others in found.judged.alternatives.items():
        for other in others:
            stage = found.found.stages[name]
            said.append(
                {
                    "name": other.name,
                    "instead_of": name,
                    "gain": _energy_gain(stage, other),
                    "experiment": _experiment(found.problem, name, other.name),
                }
            )
    return said


_EXPERIMENTS = {
    "input": "inputs over a wider range, with steps at several levels, so that what reaches the system can be told",
    "dynamics": "a record in which the states rest at several levels while the input is constant",
    "measurement": "a reading of the sensor against a reference at several levels, with the system at rest",
}


def _experiment(problem: Problem, one: str, other: str) -> str:
    """What would tell two effects apart, by where they act."""
    places = sorted({problem.effect(one).acts_on, problem.effect(other).acts_on}, key=list(_EXPERIMENTS).index)
    return "; or ".join(_EXPERIMENTS[place] for place in places)


def _formula(found: Discovery) -> str | None:
    if found.formula is None:
        return None
    return (
        f"{found.formula.text} (in free run it closes {100 * found.formula.closed:.0f} % of what the fitted curve does)"
    )


def _spectrum(found: Discovery, setup: Setup) -> dict[str, Any] | None:
    line = found.beyond.line
    if line is None:
        return None
    unit = setup.estimation.info.outputs[line.output].unit
    return {"period_s": line.period_s, "amplitude": line.amplitude, "unit": unit, "share": line.share}


def disagreement(found: Discovery) -> list[dict[str, Any]]:
    """One entry per state equation whose correction stands out, the likeliest first."""
    physics, correction = found.problem.physics, found.correction
    within = within_record(found.located)
    values = np.concatenate([found.x[..., : len(physics.states)], found.located.u], -1)[within]
    said = []
    for i in np.argsort(-correction.likelihood):
        acting = within & np.stack([clear(m, s) for m, s in zip(correction.mean[i], correction.std[i], strict=True)])
        if not acting.any() or not np.isfinite(correction.likelihood[i]) or correction.likelihood[i] <= 0:
            continue
        energy = np.where(acting, correction.mean[i] ** 2, 0.0)[within]
        where = box(energy, values, (*physics.states, *physics.inputs))
        said.append(
            {
                "equation": physics.states[i].name,
                "region": {name: [_finite(edge) for edge in edges] for name, edges in where.region.items()},
                "rule": where.rule,
                "share_of_error": where.share_of_error,
                "share_of_samples": where.share_of_samples,
                **when(acting, physics.dt),
                "log_likelihood": float(correction.likelihood[i]),
            }
        )
    return said


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _numbers(found: Discovery) -> dict[str, Any]:
    """Parameters of the physics and of every effect, for `physics.effects=FILE`; infinite limits as null."""
    theta = found.found.final.estimate.theta
    params, known = found.problem.params(theta), found.problem.known(theta)
    effects = {name: effects_of(params)[name] for name in (*effects_of(known), *found.found.final.estimate.active)}
    own = {name: own_of(known)[name] for name in own_of(found.problem.physics.params)}
    return {"parameters": plain(own), "effects": plain(effects)}


def _initial_state(found: Discovery) -> dict[str, float]:
    """Of the physics, and of what the effects found remember."""
    problem, final = found.problem, found.found.final.estimate
    states = add(problem.physics, *map(problem.effect, final.active)).states
    begun = dict(zip((state.name for state in problem.full.states), final.x0[0], strict=True))
    return {state.name: float(begun[state.name]) for state in states}


def _sentence(found: Discovery, effects: list[dict[str, Any]]) -> str:
    gap = _gap(found)
    unit = f" {gap['unit']}" if gap["unit"] else ""
    before, fitted, after = (gap[name]["test"] for name in ("before", "recalibrated", "after"))
    verdict = found.judged.verdict
    titles = " and ".join(effect["title"][0].lower() + effect["title"][1:] for effect in effects)
    errors = f"test {gap['metric']} {before:.3g}{unit} nominal, {fitted:.3g}{unit} recalibrated"
    if verdict is Verdict.NO_DISCREPANCY:
        return f"Nothing is missing: {errors}, noise about {gap['floor']:.3g}{unit}."
    if verdict is Verdict.MISCALIBRATED:
        return f"Only parameters were wrong: {errors}, noise about {gap['floor']:.3g}{unit}."
    if verdict is Verdict.UNKNOWN_EFFECT:
        return f"Something is missing that no effect of the catalogue explains: {_what(found)}; {errors}."
    closed = f"{errors}, {after:.3g}{unit} with it"
    if verdict is Verdict.AMBIGUOUS:
        others = ", ".join(sorted({a["name"] for a in _alternatives(found)}))
        return f"Missing: {titles}, or, which these data cannot tell apart, {others}; {closed}."
    return f"Missing: {titles}; {closed} ({100 * gap['closed_fraction']:.0f} % of the gap above the noise)."


def _what(found: Discovery) -> str:
    """What is known of something without a name."""
    if found.formula is not None:
        return found.formula.text
    if found.beyond.line is not None:
        return "a periodic disturbance"
    share = found.beyond.follows.share if found.beyond.follows else 0.0
    return (
        f"the errors follow the signals ({100 * share:.0f} % of their energy), but no curve of one signal in one "
        "equation says how: a memory or a hard stop may"
    )


def discovery_arrays(found: Discovery, setup: Setup) -> dict[str, Any]:
    """The arrays of `discovery.npz`: simulations of both records, the correction signal, and its map."""
    physics = found.problem.physics
    arrays: dict[str, Any] = {}
    for part, record, proofs in (("train", found.estimation, found.train), ("test", setup.test, found.test)):
        arrays[f"time_{part}"] = np.arange(record.u.shape[1]) * physics.dt
        arrays |= {f"u_{part}": record.u, f"y_{part}": record.y, f"mask_{part}": record.mask}
        arrays |= {f"y_{name}_{part}": getattr(proofs, name).y for name in proofs._fields}
    arrays["x_after_train"] = found.train.after.x[..., : len(physics.states)]
    arrays["correction"], arrays["correction_std"] = found.correction.mean, found.correction.std
    arrays["null_law"] = found.found.first.null
    return arrays | _map_arrays(found)


def _map_arrays(found: Discovery) -> dict[str, np.ndarray]:
    """The correction of the likeliest equation over the signal of its rule and one other."""
    physics = found.problem.physics
    named = disagreement(found)
    names = [s.name for s in (*physics.states, *physics.inputs)]
    equation = named[0]["equation"] if named else physics.states[0].name
    a = next(iter(named[0]["region"]), equation) if named else equation
    b = next((s.name for s in physics.inputs if s.name != a), names[0])
    values = np.concatenate([found.x[..., : len(physics.states)], found.located.u], -1)
    i = [s.name for s in physics.states].index(equation)
    pair = (values[..., names.index(a)], values[..., names.index(b)])
    drawn = signal_map(found.correction.mean[i], *pair, (a, b), within_record(found.located))
    return {
        "map_x_edges": drawn.a_edges, "map_u_edges": drawn.b_edges, "map_mean": drawn.mean,
        "map_std_error": drawn.std_error, "map_count": drawn.samples, "map_equation": np.array(equation),
        "map_a": np.array(a), "map_b": np.array(b),
    }  # fmt: skip
