"""What the first screen of a discovery answers, from `discovery.json`: four questions, a few sentences each."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from pgrssnn_jax.reports import discovery_facts as facts
from pgrssnn_jax.reports.content import number, percent
from pgrssnn_jax.reports.discovery_facts import Discovery

_SHOWN_QUANTITIES = 4


def answers(discovery: Discovery) -> dict[str, list[str]]:
    """The sentences of each answer, by its question."""
    return {
        "What is missing?": list(_missing(discovery)),
        "How sure is it?": list(_certainty(discovery)),
        "What stays open, and where?": list(_open(discovery)),
        "What to measure next?": list(_next(discovery)),
    }


def _missing(discovery: Discovery) -> Iterator[str]:
    effects = discovery.get("effects") or ()
    for effect in effects:
        numbers = facts.quantities(effect)
        told = [f"{one.name} = {one.words}" for one in numbers[:_SHOWN_QUANTITIES]]
        told += [f"{len(numbers) - len(told)} more numbers below"] if len(numbers) > len(told) else []
        yield f"{effect.get('title') or effect['name']}{': ' if told else ''}{', '.join(told)}"
    if discovery.get("formula"):
        yield f"Without a name: {discovery['formula']}"
    if not effects:
        yield f"{facts.heading(discovery)}."
        departed = [f"{row['parameter']} {row['change']:+.0%}" for row in discovery.get("departures") or ()]
        if departed:
            yield f"Parameters outside their prior: {', '.join(departed)}."


def _certainty(discovery: Discovery) -> Iterator[str]:
    for effect in discovery.get("effects") or ():
        p, runner = effect.get("p_value"), effect.get("runner_up") or {}
        by_chance = "" if p is None else f", p = {facts.chance(p)}"
        second = f"; the runner-up {runner['name']} would close {percent(runner.get('gain'))}" if runner else ""
        yield f"{effect['name']} closes {percent(effect.get('gain_test'))} of the gap on test data{by_chance}{second}."
    gap, (metric, unit) = discovery.get("gap") or {}, facts.gap_metric(discovery)
    low, high = map(facts.real, gap.get("improvement_interval") or (None, None))
    if math.isfinite(low + high):
        yield f"With 95 % confidence the test {metric} falls by {number(low)} to {number(high, unit)}."
    threshold = (discovery.get("null") or {}).get("threshold")
    if threshold is not None and not discovery.get("effects"):
        yield f"An effect would have to take away {percent(threshold)} of the error energy: chance reaches as much."


def _open(discovery: Discovery) -> Iterator[str]:
    gap, (metric, unit) = discovery.get("gap") or {}, facts.gap_metric(discovery)
    after, floor = facts.real((gap.get("after") or {}).get("test")), facts.real(gap.get("floor"))
    share, where = gap.get("open_fraction"), (discovery.get("remaining") or {}).get("rule")
    if share is not None:
        yield f"{percent(max(share, 0.0))} of the gap between recalibrated physics and noise."
    if math.isfinite(after):
        noise = f"; the noise is about {number(floor, unit)}" if math.isfinite(floor) else ""
        yield f"Test {metric} {number(after, unit)} with all that was found{noise}."
    if where:
        yield f"Most of it: {where}."
    if share is None and not math.isfinite(after) and not where:
        yield "No test record says so."


def _next(discovery: Discovery) -> Iterator[str]:
    """Experiments that tell effects apart, effects that these data cannot test, parameters that they leave open."""
    experiments: dict[str, list[str]] = {}
    for row in discovery.get("alternatives") or ():
        experiments.setdefault(str(row.get("experiment") or "another record"), []).append(str(row["name"]))
    for experiment, names in experiments.items():
        yield f"To tell {', '.join(names)} apart from what was found: {experiment}."
    reasons: dict[str, list[str]] = {}
    for row in discovery.get("untestable") or ():
        reasons.setdefault(str(row.get("reason") or "not in these data"), []).append(str(row["name"]))
    for reason, names in reasons.items():
        yield f"Another record to test {', '.join(names)}. In this one {reason}."
    unsure = dict.fromkeys(name for row in discovery.get("undetermined") or () for name in row["changes"])
    if unsure:
        yield f"Richer inputs, to determine {', '.join(unsure)}."
    where: Mapping[str, Any] = discovery.get("remaining") or {}
    if discovery["verdict"] in ("unknown_effect", "unexplained") and where.get("rule"):
        yield f"More samples where the errors are: {', '.join(where.get('region') or ())}."
    if not (experiments or reasons or unsure):
        yield "These data test every effect of the catalogue and tell them apart."
