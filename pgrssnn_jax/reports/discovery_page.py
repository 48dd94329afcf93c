"""The page of a discovery run: the verdict, a card for each finding, what could not be told, pictures and numbers."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports import discovery_facts as facts
from pgrssnn_jax.reports import discovery_tables as tables
from pgrssnn_jax.reports.content import MISSING, rounded
from pgrssnn_jax.reports.discovery_facts import Discovery, percent
from pgrssnn_jax.reports.discovery_figures import DISCOVERY_CAPTIONS
from pgrssnn_jax.reports.markup import Markup, banner, card, document, numbered_figure, reproduce, tag

SHOWN_ROWS = 15


def discovery_html(
    discovery: Discovery, figures: Mapping[str, Path], *, config_text: str, environment: Mapping[str, Any]
) -> str:
    """The HTML of the page. figures: title → PNG file, in the order of the page; raises `ValueError` if one is none."""
    metrics, data = facts.as_metrics(discovery), discovery["data"]
    n_train, n_test = (MISSING if data.get(name) is None else str(data[name]) for name in ("n_train", "n_test"))
    lines = [f"system: {discovery['system']}", content.source(metrics), content.outputs(metrics)]
    lines.append(f"{n_train} samples to find it, {n_test} to prove it")
    lines += [f"one sample every {data['dt']:g} s"] if data.get("dt") is not None else []
    pictures = [
        numbered_figure(k, path, title, DISCOVERY_CAPTIONS.get(title, ""))
        for k, (title, path) in enumerate(figures.items(), 1)
    ]
    links = {f"figure-{k}": f"Figure {k}. {title}" for k, title in enumerate(figures, 1)}
    return document(
        kind="Discovery report",
        title=content.heading(metrics),
        heading=facts.heading(discovery),
        lead=str(discovery.get("sentence") or ""),
        facts=lines,
        banners=[banner("SIMULATED DATA", "Nothing here was measured.")] if content.simulated(metrics) else [],
        cards=_cards(discovery),
        links={"found": "Missing effects", **links, "numbers": "Numbers", "reproduce": "Reproduce"},
        sections=[
            *_found(discovery),
            *([tag("h2", "Figures"), *pictures] if pictures else []),
            tag("h2", "Numbers", id="numbers"),
            *(tag("div", table.html(), look="named") for table in tables.number_tables(discovery)),
            reproduce(config_text, environment),
        ],
        footer="Made by pgrssnn_jax from discovery.json and discovery.npz of this run folder.",
    )


def _cards(discovery: Discovery) -> list[Markup]:
    (metric, unit), gap = facts.gap_metric(discovery), discovery.get("gap") or {}
    rows = {row.stage: row for row in facts.gap_rows(discovery)}
    floor = f"; floor {rounded(rows['floor'].test)}" if "floor" in rows else ""
    cards = []
    for stage in facts.STAGES:
        row = rows[stage]
        span = f"; {rounded(row.low)} to {rounded(row.high)}" if math.isfinite(row.low + row.high) else ""
        note = row.words + span + (floor if stage == "after" else "")
        cards.append(card(f"test {metric}, {stage}", rounded(row.test, unit), note))
    cards.append(card("gap closed", percent(gap.get("closed_fraction")), "by the missing effects, on test data"))
    if network := discovery.get("network"):
        note = f"of the prediction; {percent(network.get('share_before'))} with the nominal physics"
        cards.append(card("left to the network", percent(network.get("share_after")), note))
    return [*cards, card("time", *content.spent(discovery["seconds"]))] if discovery.get("seconds") else cards


def _found(discovery: Discovery) -> list[Markup]:
    """Cards, then what else could explain the data, what could not be tested, and the missing part in symbols."""
    effects, wave = discovery.get("effects") or (), discovery.get("spectrum")
    parts = [tag("h2", "Missing effects", id="found")]
    parts += [tag("p", facts.STAND_INS, look="note")] if facts.stand_ins(discovery) else []
    parts += [tag("article", tables.finding_table(effect).html(), look="finding prose") for effect in effects]
    parts += [] if effects else [tag("p", "No effect was added to the physics.", look="note")]
    if discovery.get("formula"):
        parts += [tag("h3", "What is missing, in symbols"), tag("pre", str(discovery["formula"]))]
    if wave:
        size = rounded(wave.get("amplitude"), wave.get("unit") or "")
        period = content.duration(wave.get("period_s"))
        parts.append(tag("p", f"The residual repeats with a period of {period} and an amplitude of {size}."))
    return [*parts, *(tag("div", table.html(), look="prose") for table in tables.open_tables(discovery))]
