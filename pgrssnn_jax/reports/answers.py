"""What the first screen of a discovery answers, from `discovery.json`: four questions, a few sentences each."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from pgrssnn_jax.reports import discovery_facts as facts
from pgrssnn_jax.reports.content import duration, number, percent
from pgrssnn_jax.reports.discovery_facts import Discovery

_FEW = 3  # effects of which a first screen can tell more


def answers(discovery: Discovery) -> dict[str, list[str]]:
    """The sentences of each answer, by its question."""
    questions = {
        "What is missing?": _missing,
        "How sure is it?": _certainty,
        "What stays open, and where?": _open,
        "What to measure next?": _next,
    }
    return {question: list(told(discovery)) or ["These data do not say."] for question, told in questions.items()}


def _missing(discovery: Discovery) -> Iterator[str]:
    effects = discovery.get("effects") or ()
    if facts.stand_ins(discovery):
        yield f"{facts.heading(discovery)}. What helps:"
    for effect in effects:
        numbers = facts.quantities(effect)
        told = [f"{one.name} = {one.words}" for one in numbers[: 4 if len(effects) <= _FEW else 2]]
        told += [f"{len(numbers) - len(told)} more below"] if len(numbers) > len(told) else []
        yield f"{effect.get('title') or effect['name']}{': ' if told else ''}{', '.join(told)}"
    if discovery.get("formula"):
        yield f"Without a name: {discovery['formula']}"
    line = discovery.get("spectrum")
    if line:
        size, period = number(line["amplitude"], line.get("unit") or ""), duration(line["period_s"])
        of = f" of {line['output']}" if line.get("output") else ""
        yield f"The residual{of} repeats with a period of {period} and an amplitude of {size}."
    follows = discovery.get("follows")
    if follows and discovery["verdict"] == "unknown_effect" and not (discovery.get("formula") or line):
        yield f"The remaining errors follow the signals: {percent(follows['share'])} of their energy."
    if not effects:
        if not (discovery.get("formula") or line):
            yield f"{facts.heading(discovery)}."
        departed = [f"{row['parameter']} {row['change']:+.0%}" for row in discovery.get("departures") or ()]
        if departed:
            yield f"Parameters outside their prior: {', '.join(departed)}."


def _certainty(discovery: Discovery) -> Iterator[str]:
    effects = discovery.get("effects") or ()
    by_chance: dict[str, list[str]] = {}
    for effect in effects:
        if effect.get("p_value") is not None:
            by_chance.setdefault(facts.chance(effect["p_value"]), []).append(str(effect["name"]))
    for p, names in by_chance.items():
        yield f"p = {p}, the probability of such a gain when nothing is missing: {', '.join(names)}."
    gains = [(facts.real(effect.get("gain_test")), str(effect["name"])) for effect in effects]
    known = sorted((one for one in gains if math.isfinite(one[0])), reverse=True)
    closed = [f"{percent(gain)} by {name}" for gain, name in known]
    if closed:
        yield f"Share of the gap closed on test data: {', '.join(closed)}."
    for effect in effects if len(effects) <= _FEW else ():
        if runner := effect.get("runner_up"):
            gain = percent(runner.get("gain"))
            yield f"In place of {effect['name']}, {runner['name']} would close {gain} on the estimation record."
    gap, (metric, unit) = discovery.get("gap") or {}, facts.gap_metric(discovery)
    low, high = map(facts.real, gap.get("improvement_interval") or (None, None))
    if effects and math.isfinite(low + high):
        yield f"The test {metric} falls by {number(low)} to {number(high, unit)} (95 %) with the effects."
    gain = gap.get("likelihood_gain") or {}
    value, error = map(facts.real, (gain.get("value"), gain.get("std_error")))
    if effects and math.isfinite(value + error):
        yield f"The log-likelihood of the test record rises by {number(value)} ± {number(error)} with the effects."
    threshold = (discovery.get("null") or {}).get("threshold")
    if threshold is not None and not effects:
        least = percent(threshold)
        yield f"An effect counts only if it removes more than {least} of the error energy, which chance can reach."


def _open(discovery: Discovery) -> Iterator[str]:
    gap, (metric, unit) = discovery.get("gap") or {}, facts.gap_metric(discovery)
    after, floor = facts.real((gap.get("after") or {}).get("test")), facts.real(gap.get("floor"))
    share, where = gap.get("open_fraction"), (discovery.get("remaining") or {}).get("rule")
    effects = discovery.get("effects")
    if share is not None and discovery["verdict"] not in ("no_discrepancy", "miscalibrated"):
        yield f"{percent(max(share, 0.0))} of the gap between recalibrated physics and noise."
    if math.isfinite(after):
        noise = f"; the noise is about {number(floor, unit)}" if math.isfinite(floor) else ""
        model = "with the discovered effects" if effects else "recalibrated"
        yield f"Test {metric} {number(after, unit)} {model}{noise}."
    if where and not where.startswith("everywhere") and not after <= floor:
        yield f"Most of it: {where}."


def _next(discovery: Discovery) -> Iterator[str]:
    """Experiments that tell effects apart, effects that these data cannot test, parameters that they leave open."""
    experiments: dict[tuple[str, str], list[str]] = {}
    for row in discovery.get("alternatives") or ():
        key = str(row.get("instead_of") or "the discovered effects"), str(row.get("experiment") or "another record")
        experiments.setdefault(key, []).append(facts.called(row))
    for (found, experiment), names in experiments.items():
        yield f"To distinguish {', '.join(names)} from {found}: {experiment}."
    reasons: dict[str, list[str]] = {}
    for row in discovery.get("untestable") or ():
        reasons.setdefault(str(row.get("reason") or "no reason given"), []).append(str(row["name"]))
    for reason, names in reasons.items():
        yield f"Not tested by these data: {', '.join(names)}. {reason[0].upper()}{reason[1:]}."
    unsure = dict.fromkeys(name for row in discovery.get("undetermined") or () for name in row["changes"])
    if unsure:
        yield f"Richer inputs, to determine {', '.join(unsure)}."
    region: Mapping[str, Any] = (discovery.get("remaining") or {}).get("region") or {}
    line = discovery.get("spectrum")
    if line:
        yield f"Whatever turns, switches or hums with a period of {duration(line['period_s'])}, as one more input."
    unexplained = not line and discovery["verdict"] in ("unknown_effect", "unexplained") and region
    if unexplained:
        yield f"More samples where the errors are: {', '.join(region)}."
    if not (experiments or reasons or unsure or line or unexplained):
        yield "These data test every effect of the catalogue and tell them apart."
