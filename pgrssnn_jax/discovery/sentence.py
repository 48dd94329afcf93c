"""A discovery in one sentence."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pgrssnn_jax.discovery.discover import Discovery
from pgrssnn_jax.discovery.noise import longest_memory
from pgrssnn_jax.discovery.verdict import EXPLAINED, Verdict


def sentence(
    found: Discovery,
    gap: Mapping[str, Any],
    effects: Sequence[Mapping[str, Any]],
    alternatives: Sequence[Mapping[str, Any]],
    departures: Sequence[Mapping[str, Any]],
    remaining: str,
) -> str:
    """gap, effects, alternatives, departures: as in `discovery.json`; remaining: where the errors are that are left."""
    said = _verdict(found, gap, effects, alternatives)
    if found.judgement.verdict not in (Verdict.NO_DISCREPANCY, Verdict.MISCALIBRATED):
        said += f" Remaining errors: {'everywhere alike' if remaining.startswith('everywhere') else remaining}."
    ends = [f"{effect['name']}.{key}" for effect in effects for key, one in effect["parameters"].items() if _ends(one)]
    said += f" At a bound: {', '.join(ends)}." if ends else ""
    moved = [f"{one['parameter']} {one['change']:+.0%} ({one['after']:.3g} {one['unit']})" for one in departures]
    return f"{said} Outside the prior of the physics: {', '.join(moved)}." if moved else said


def _ends(parameter: Mapping[str, Any]) -> bool:
    """Does any number of a parameter lie at a bound?"""
    return bool(np.any(parameter["at_bound"]))


def _verdict(
    found: Discovery,
    gap: Mapping[str, Any],
    effects: Sequence[Mapping[str, Any]],
    alternatives: Sequence[Mapping[str, Any]],
) -> str:
    unit = f" {gap['unit']}" if gap["unit"] else ""
    before, fitted, after = (gap[name]["test"] for name in ("before", "recalibrated", "after"))
    verdict = found.judgement.verdict
    errors, timing = f"test {gap['metric']} {before:.3g}{unit} nominal, {fitted:.3g}{unit} recalibrated", ""
    if found.convention is not None and not effects:
        errors += f", {after:.3g}{unit} with that reading"
        timing = "Outputs are read before the inputs act, one sample earlier. Beside that, "
    if verdict in (Verdict.NO_DISCREPANCY, Verdict.MISCALIBRATED):
        refuted = ", but the test record refutes the new ones" if found.test.improvement[1] < 0.0 else ""
        nothing = verdict is Verdict.NO_DISCREPANCY
        answer = "nothing is missing" if nothing else f"only parameters were wrong{refuted}"
        answer = timing + answer if timing else answer.capitalize()
        return f"{answer}: {errors}, noise about {gap['floor']:.3g}{unit}."
    titles = " and ".join(map(_title, effects))
    helped = f", {after:.3g}{unit} with {titles}, which helps but does not explain it" if effects else ""
    if found.refuted:
        helped += f"; refuted by the test record, and left out: {', '.join(found.refuted)}"
    if verdict is Verdict.UNKNOWN_EFFECT:
        return f"Something is missing that no effect of the catalogue explains: {_nameless(found)}; {errors}{helped}."
    if verdict is Verdict.UNEXPLAINED:
        return f"{_unexplained(found, gap)}; {errors}{helped}."
    closed, share = f"{errors}, {after:.3g}{unit} with it", 100 * min(gap["closed_fraction"], 1.0)
    if verdict is Verdict.NOT_CONFIRMED and not effects:
        one = f"a correction without a name ({', '.join(found.refuted)})"
        return f"Found on the estimation record, not confirmed by the test record: {one}; {errors}."
    if verdict is Verdict.NOT_CONFIRMED:
        worse = "" if found.test.relative < 1.0 else ", no better than the mean of the test record"
        return f"Found on the estimation record, not confirmed by the test record: {titles}; {closed}{worse}."
    left = f"{share:.0f} % of the gap above the noise closed, {100 - share:.0f} % open"
    missing = "Missing" if share >= 100 * EXPLAINED else "Missing, but most of the gap stays open"
    if verdict is Verdict.AMBIGUOUS:
        others = ", ".join(sorted({_called(other) for other in alternatives}))
        return f"{missing}: {titles}, or, which these data cannot tell apart, {others}; {closed} ({left})."
    return f"{missing}: {titles}; {closed} ({left})."


def _called(other: Mapping[str, Any]) -> str:
    """An alternative; of an effect at another channel, the channel."""
    return f"{other['name']} ({', '.join(other['acts_at'])})" if other["name"] == other["instead_of"] else other["name"]


def _title(effect: Mapping[str, Any]) -> str:
    """With its channels, where it could have more."""
    at, title = effect["acts_at"], effect["title"][0].lower() + effect["title"][1:]
    return f"{title} ({', '.join(at)})" if 0 < len(at) < len(effect["channel_names"]) else title


def _unexplained(found: Discovery, gap: Mapping[str, Any]) -> str:
    selection = found.selection
    ratio = selection.last.rms() / selection.floor if selection.floor > 0 else math.inf
    error = selection.final.estimate.error
    memory, of = longest_memory(error), "most of " if selection.final.estimate.active else ""
    if not found.clear.estimation:
        there = gap["after"]["test"] / gap["floor"] if gap["floor"] > 0 else math.inf
        return (
            f"Errors stand {there:.1f} times above the white noise on the test record, and {ratio:.1f} times on the "
            "estimation record: something acts there that the estimation record hardly shows, or parameters matter "
            "that it does not determine"
        )
    other = "an effect that no curve here describes, " if found.refuted else ""
    return (
        f"Errors stand {ratio:.1f} times above the white noise and nothing accounts for {of}them: {other}noise with a "
        f"memory of {memory:.0f} samples, or an unmeasured disturbance"
    )


def _nameless(found: Discovery) -> str:
    """What is known of something without a name."""
    if found.formula is not None:
        return found.formula.text
    if (line := found.nameless.line) is not None:
        physics = found.problem.physics
        return f"a periodic disturbance of {physics.outputs[line.output].name} every {line.period * physics.dt:.3g} s"
    share = found.nameless.follows.share if found.nameless.follows else 0.0
    return (
        f"the errors follow the signals ({100 * share:.0f} % of their energy), but no curve of one signal in one "
        "equation says how: a memory or a hard stop may"
    )
