"""What discovery by torques says: the keys of `discovery.json`, with the evidence and a table per joint beside them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pgrssnn_jax.discovery.finding import interval
from pgrssnn_jax.discovery.inverse.compare import Compared
from pgrssnn_jax.discovery.inverse.discover import Found, rival_structures
from pgrssnn_jax.discovery.inverse.judge import departed
from pgrssnn_jax.discovery.inverse.select import own_places
from pgrssnn_jax.discovery.inverse.serialise_effects import closed_on_test, findings
from pgrssnn_jax.discovery.inverse.unnamed import Unnamed
from pgrssnn_jax.discovery.serialise_numbers import about_data
from pgrssnn_jax.discovery.setup import Setup
from pgrssnn_jax.discovery.verdict import Verdict
from pgrssnn_jax.effects.base import effects_of, own_of
from pgrssnn_jax.effects.stored import physics_to_json, plain

_REGIMES = ("all", "moving", "at_rest")
_TIMING = {0.0: "position read before the torque", 0.5: "position read half a sample later", 1.0: "position read after"}


def torques_json(found: Found, setup: Setup, *, command: str) -> dict[str, Any]:
    problem = found.problem
    effects, gap = findings(found, command), _gap(found)
    return {
        "schema": 1,
        "system": problem.physics.name,
        "data": about_data(setup, problem.physics.output_timing),
        "verdict": str(found.verdict),
        "sentence": _sentence(found, gap, effects),
        "evidence": {
            "kind": "inverse_dynamics",
            "cutoff_hz": found.train.motion.cutoff,
            "acceleration_noise": found.train.motion.noise.tolist(),
            "torque_read": _TIMING[found.shift],
        },
        "joints": _joints(found.test),
        "free_run": [
            {"horizon_s": one.horizon, **{stage: _number(error) for stage, error in one.errors.items()}}
            for one in found.free_run
        ],
        "effects": effects,
        "alternatives": _alternatives(found),
        "untestable": _untestable(found, setup),
        "formula": _follow(found.nameless) if found.nameless else None,
        "spectrum": _spectrum(found),
        "follows": _follows(found),
        "disagreement": [],
        "remaining": _remaining(found),
        "recalibration": _own(found, "recalibrated"),
        "parameters": _own(found, "after"),
        "departures": _departures(found),
        "undetermined": [],
        "gap": gap,
        "optimism": None,
        "ranking": _ranking(found),
        "network": None,
        "null": {"threshold": None, "draws": None},
        "seconds": dict(found.seconds),
        "inputs": [{"name": s.name, "unit": s.unit} for s in problem.physics.outputs],
        "outputs": [{"name": s.name, "unit": s.unit} for s in problem.physics.inputs],
        "states": [{"name": s.name, "unit": s.unit} for s in problem.physics.states],
        "physics": physics_to_json(setup.physics)["physics"],
        "numbers": _numbers(found),
        "initial_state": None,
    }


def torques_arrays(found: Found, setup: Setup) -> dict[str, np.ndarray]:
    """Torques measured and asked for, motor Nm, of both records."""
    arrays: dict[str, Any] = {}
    for part, one in (("train", found.train), ("test", found.test)):
        arrays[f"time_{part}"] = np.arange(one.motion.torque.shape[1]) * setup.physics.dt
        arrays |= {f"u_{part}": one.motion.reading, f"y_{part}": one.motion.torque}
        arrays[f"mask_{part}"] = np.ones(one.motion.torque.shape, bool)
        arrays |= {f"y_{name}_{part}": stage.torque for name, stage in one.models.items()}
    return arrays


def _gap(found: Found) -> dict[str, Any]:
    models = {"train": found.train.models, "test": found.test.models}
    stages = ("before", "recalibrated", "after")
    closed = closed_on_test(found, found.test.models["recalibrated"].error)
    missing = found.verdict not in (Verdict.NO_DISCREPANCY, Verdict.MISCALIBRATED)
    return {
        "metric": "torque NRMSE",
        "unit": "",
        **{stage: {part: models[part][stage].error for part in models} for stage in stages},
        "test_interval": {stage: list(models["test"][stage].interval) for stage in stages},
        "improvement_interval": list(found.test.improvement),
        "likelihood_gain": {"value": found.gain.value, "std_error": found.gain.error},
        "pooled": {stage: _pooled(found.test, stage) for stage in stages},
        "moving": {stage: found.test.models[stage].moving for stage in stages},
        "n_init": 0,
        "floor": found.floor,
        "closed_fraction": closed if missing else 0.0,
        "open_fraction": 1.0 - closed if missing else 0.0,
    }


def _pooled(test: Compared, stage: str) -> float:
    """RMS of all torques over their standard deviation, all joints in one."""
    error = test.motion.torque - test.models[stage].torque
    return float(np.sqrt((error**2).mean()) / np.sqrt((test.spread**2).mean()))


def _joints(test: Compared) -> list[dict[str, Any]]:
    """NRMSE of the torque of each joint, by regime and stage."""
    return [
        {
            "joint": joint + 1,
            "std": float(test.spread[joint]),
            **{
                regime: {stage: _number(one.nrmse[k, joint]) for stage, one in test.models.items()}
                for k, regime in enumerate(_REGIMES)
            },
        }
        for joint in range(test.motion.torque.shape[-1])
    ]


def _follows(found: Found) -> dict[str, Any] | None:
    if found.nameless is None:
        return None
    joints, share = found.nameless
    return {"joints": [joint + 1 for joint in joints], "share": share}


def _spectrum(found: Found) -> dict[str, Any] | None:
    if found.line is None:
        return None
    torque, period = found.problem.physics.inputs[found.line.output], found.line.period * found.problem.physics.dt
    numbers = {"period_s": period, "amplitude": found.line.amplitude, "unit": torque.unit, "share": found.line.share}
    return {**numbers, "output": torque.name}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _own(found: Found, stage: str) -> dict[str, Any]:
    """Numbers of the physics before and after; those of effects stand with them."""
    problem, theta, std = found.problem, found.theta[stage], found.std[stage]
    said = {}
    for i in own_places(problem):
        numbers = {"std": float(std[i]), "interval": interval(theta[i], std[i], found.freedom)}
        at = {"value": float(theta[i]), "at_bound": bool(theta[i] in (problem.low[i], problem.high[i]))}
        moved = {"before": float(problem.theta[i]), "after": float(theta[i])}
        unit = {"unit": problem.slots[i].meaning.unit}
        said[problem.slots[i].label] = {**(at if stage == "after" else moved), **numbers, **unit}
    return said


def _departures(found: Found) -> list[dict[str, Any]]:
    """Known numbers that left their prior; friction's are named as effects too."""
    problem, theta = found.problem, found.chosen.final.fit.theta
    said = []
    for i in departed(problem, found.chosen.final.fit):
        scale = float(np.abs(problem.theta[i]))
        half = 1.96 / np.sqrt(problem.precision[i])
        row = _own(found, "after")[problem.slots[i].label]
        said.append(
            {
                "parameter": problem.slots[i].label,
                "before": float(problem.theta[i]),
                "after": float(theta[i]),
                "change": float((theta[i] - problem.theta[i]) / scale),
                "prior": [float(problem.theta[i] - half), float(problem.theta[i] + half)],
                **{key: row[key] for key in ("interval", "unit", "at_bound")},
            }
        )
    return said


def _alternatives(found: Found) -> list[dict[str, Any]]:
    """Other structures that predict as well."""
    experiment = "a pose in which gravity pulls another joint, measured against a level"
    return [
        {"name": " and ".join(one.numbers()), "instead_of": "gravity_direction and home_offset", "gain": None,
         "experiment": experiment, "numbers": plain(one.numbers())}
        for one in rival_structures(found.chosen)
    ]  # fmt: skip


def _untestable(found: Found, setup: Setup) -> list[dict[str, Any]]:
    there = {effect.name for effect in found.problem.effects}
    reason = "it is no torque: only a simulation shows it (discovery.evidence=free_run)"
    return [{"name": e.name, "reason": reason} for e in setup.candidates if e.name not in there]


def _remaining(found: Found) -> dict[str, Any]:
    """Which joint and regime hold the errors that are left."""
    rms = found.test.models["after"].nrmse
    joint = int(np.argmax(rms[0]))
    still = np.nan_to_num(rms[2]).mean() > np.nan_to_num(rms[1]).mean()
    moving, resting = (float(np.nanmean(rms[k])) for k in (1, 2))
    rule = (
        f"{resting:.2f} std of the torque at rest, {moving:.2f} while a joint moves (mean over joints); "
        f"most at joint {joint + 1}"
    )
    return {"rule": rule, "region": {}, "joint": joint + 1, "regime": "at_rest" if still else "moving"}


def _ranking(found: Found) -> list[dict[str, Any]]:
    """Every effect beside the structure alone: part of the error energy that it would take away."""
    chosen = found.chosen
    size = chosen.final.fit.error.size / float(chosen.kappa.mean())
    rows = [
        {
            "name": name,
            "gain": float(-np.expm1(-2.0 * max(one.value, 0.0) / size)),
            "log_likelihood": one.value,
            "cross_validated": True,
            "p_value": found.p_values.get(name),
            "chosen": name in found.active,
        }
        for name, one in {**chosen.candidates, **chosen.gains}.items()
    ]
    return sorted(rows, key=lambda row: -row["gain"])


def _numbers(found: Found) -> dict[str, Any]:
    """For `physics.effects=FILE`."""
    problem, theta = found.problem, found.theta["after"]
    params, known = problem.params(theta), problem.known(theta)
    there = effects_of(known)
    order = [*there, *(effect.name for effect in problem.effects if effect.name in found.active)]
    own = {name: own_of(known)[name] for name in own_of(problem.physics.params)}
    return {
        "parameters": plain(own),
        "effects": plain({name: effects_of(params)[name] for name in order}),
        "order": order,
    }


def _sentence(found: Found, gap: Mapping[str, Any], effects: list[dict[str, Any]]) -> str:
    stages = ("before", "recalibrated", "after")
    before, fitted, after = (gap[name]["test"] for name in stages)
    errors = f"test torque NRMSE {before:.3g} nominal, {fitted:.3g} recalibrated"
    if found.verdict is Verdict.NO_DISCREPANCY:
        return f"Nothing is missing: {errors}, noise about {gap['floor']:.2g}."
    if found.verdict is Verdict.MISCALIBRATED:
        return f"Only parameters were wrong: {errors}, noise about {gap['floor']:.2g}."
    left = f"Remaining errors: {_remaining(found)['rule']}."
    if found.verdict is Verdict.UNEXPLAINED:
        return f"Errors stand above the noise of {gap['floor']:.2g} and nothing accounts for them; {errors}. {left}"
    titles = " and ".join(_titled(effect) for effect in effects)
    if nameless := _nameless(found):
        helped = f", {after:.3g} with {titles}, which helps but does not explain it" if effects else ""
        return f"Something is missing that no effect explains: {nameless}; {errors}{helped}. {left}"
    shown = f"{errors}, {after:.3g} with it"
    if found.verdict is Verdict.NOT_CONFIRMED:
        return f"Found on the estimation record, not confirmed by the test record: {titles}; {shown}. {left}"
    others = " (other structures predict as well)" if found.verdict is Verdict.AMBIGUOUS else ""
    before, fitted, after = (gap["moving"][name] for name in stages)
    moving = f"while joints move {before:.3g} nominal, {fitted:.3g} recalibrated, {after:.3g} with it"
    return f"Missing: {titles}{others}; {shown}; {moving}. {left}"


def _nameless(found: Found) -> str:
    """What is known of something without a name; empty where there is nothing."""
    said = [_follow(found.nameless)] if found.nameless else []
    if (line := found.line) is not None:
        rate = 1.0 / (line.period * found.problem.physics.dt)
        size = f"{line.amplitude:.2g} {found.problem.physics.inputs[line.output].unit} at {rate:.3g} Hz"
        said.append(f"a hum of joint {line.output + 1}, {size} ({100 * line.share:.0f} % of its errors)")
    return "; ".join(said)


def _follow(one: Unnamed) -> str:
    which = ", ".join(str(joint + 1) for joint in one.joints)
    joints = f"joint{'s' if len(one.joints) > 1 else ''} {which}"
    return f"torques of {joints} follow the positions and the joint's own speed ({100 * one.share:.0f} % of the errors)"


def _titled(effect: Mapping[str, Any]) -> str:
    title = effect["title"][0].lower() + effect["title"][1:]
    joints = effect.get("joints")
    return f"{title} (joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))})" if joints else title
