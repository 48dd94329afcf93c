"""The page of a discovery run: the verdict, a card for each finding, what could not be told, pictures and numbers."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pgrssnn_jax.reports import content
from pgrssnn_jax.reports import discovery_summary as summary
from pgrssnn_jax.reports.content import MISSING, Content, Number, in_unit, mean_std, number, rounded
from pgrssnn_jax.reports.discovery_figures import DISCOVERY_CAPTIONS
from pgrssnn_jax.reports.discovery_summary import Discovery, chance, percent, real, share
from pgrssnn_jax.reports.markup import Markup, banner, card, document, numbered_figure, reproduce, tag, unit_of
from pgrssnn_jax.reports.tabular import Row, Table

SHOWN_ROWS = 15


def discovery_html(
    discovery: Discovery, figures: Mapping[str, Path], *, config_text: str, environment: Mapping[str, Any]
) -> str:
    """The HTML of the page. figures: title → PNG file, in the order of the page; raises `ValueError` if one is none."""
    metrics, data = summary.as_metrics(discovery), discovery["data"]
    n_train, n_test = (MISSING if data.get(name) is None else str(data[name]) for name in ("n_train", "n_test"))
    facts = [f"system: {discovery['system']}", content.source(metrics), content.outputs(metrics)]
    facts.append(f"{n_train} samples to find it, {n_test} to prove it")
    facts += [f"one sample every {data['dt']:g} s"] if data.get("dt") is not None else []
    pictures = [
        numbered_figure(k, path, title, DISCOVERY_CAPTIONS.get(title, ""))
        for k, (title, path) in enumerate(figures.items(), 1)
    ]
    links = {f"figure-{k}": f"Figure {k}. {title}" for k, title in enumerate(figures, 1)}
    return document(
        kind="Discovery report",
        title=content.heading(metrics),
        heading=summary.heading(discovery),
        lead=str(discovery.get("sentence") or ""),
        facts=facts,
        banners=[banner("SIMULATED DATA", "Nothing here was measured.")] if content.simulated(metrics) else [],
        cards=_cards(discovery),
        links={"found": "Missing effects", **links, "numbers": "Numbers", "reproduce": "Reproduce"},
        sections=[
            *_found(discovery),
            *([tag("h2", "Figures"), *pictures] if pictures else []),
            *_numbers(discovery),
            reproduce(config_text, environment),
        ],
        footer="Made by pgrssnn_jax from discovery.json and discovery.npz of this run folder.",
    )


def _cards(discovery: Discovery) -> list[Markup]:
    (metric, unit), gap = summary.gap_metric(discovery), discovery.get("gap") or {}
    rows = {row.stage: row for row in summary.gap_rows(discovery)}
    floor = f"; floor {rounded(rows['floor'].test)}" if "floor" in rows else ""
    cards = []
    for stage in summary.STAGES:
        row = rows[stage]
        span = f"; {rounded(row.low)} to {rounded(row.high)}" if math.isfinite(row.low + row.high) else ""
        note = row.words + span + (floor if stage == "after" else "")
        cards.append(card(f"test {metric}, {stage}", (number(row.test), unit_of(unit)), note))
    cards.append(card("gap closed", share(gap.get("closed_fraction")), "by the missing effects, on test data"))
    if network := discovery.get("network"):
        note = f"of the prediction; {percent(network.get('share_before'))} with the nominal physics"
        cards.append(card("left to the network", share(network.get("share_after")), note))
    return [*cards, card("time", *content.spent(discovery["seconds"]))] if discovery.get("seconds") else cards


def _found(discovery: Discovery) -> list[Markup]:
    """Cards, then what else could explain the data, what could not be tested, and the missing part in symbols."""
    effects, wave = discovery.get("effects") or (), discovery.get("spectrum")
    parts = [tag("h2", "Missing effects", id="found")]
    parts += [tag("p", summary.STAND_INS, look="note")] if summary.stand_ins(discovery) else []
    parts += map(_finding, effects)
    parts += [] if effects else [tag("p", "No effect was added to the physics.", look="note")]
    if discovery.get("formula"):
        parts += [tag("h3", "What is missing, in symbols"), tag("pre", str(discovery["formula"]))]
    if wave:
        size = number(real(wave.get("amplitude"))), f" {wave.get('unit') or ''}".rstrip()
        period = content.seconds(real(wave.get("period_s")))
        parts.append(tag("p", "The residual repeats with a period of ", period, " and an amplitude of ", *size, "."))
    others: list[Row] = [
        ("", [str(row["name"]), share(row.get("gain")), str(row.get("experiment") or MISSING)])
        for row in discovery.get("alternatives") or ()
    ]
    silent: list[Row] = [
        ("", [str(row["name"]), str(row.get("reason") or MISSING)]) for row in discovery.get("untestable") or ()
    ]
    header = ("effect", "error energy taken away", "experiment that would tell")
    parts.append(_table("Alternatives that these data cannot tell apart", header, others, "prose"))
    return [*parts, _table("Effects that these data cannot test", ("effect", "why"), silent, "prose")]


def _finding(effect: Mapping[str, Any]) -> Markup:
    def value(q: summary.Quantity) -> Content:
        return (number(q.value), ", at its bound") if q.at_bound else mean_std(q.value, q.std)

    rows = [("", [q.name, value(q), q.unit or MISSING]) for q in summary.quantities(effect)]
    facts = [(tag("dt", name), tag("dd", text)) for name, text in summary.effect_facts(effect).items()]
    return tag(
        "article",
        tag("h3", str(effect.get("title") or effect["name"])),
        tag("p", str(effect["name"]), look="note"),
        tag("p", str(effect.get("equation") or ""), look="equation"),
        _table("", ("number", "value ± std", "unit"), rows),
        tag("dl", *facts),
        tag("pre", str(effect["command"])) if effect.get("command") else "",
        look="finding",
    )


def _table(title: str, header: Sequence[str], rows: Sequence[Row], look: str = "named") -> Markup:
    """Nothing where there are no rows."""
    return tag("div", Table(header, rows, title, most=SHOWN_ROWS).html(), look=look) if rows else Markup()


def _numbers(discovery: Discovery) -> list[Markup]:
    tried: list[Row] = []
    for row in discovery.get("ranking") or ():
        name = str(row["name"]) + ("" if row.get("cross_validated", True) else " (fitted only)")
        cells = [name, share(row.get("gain")), chance(row.get("p_value")), "yes" if row.get("chosen") else "no"]
        tried.append(("headline" if row.get("chosen") else "", cells))
    network = discovery.get("network") or {}
    of = str(network.get("metric") or "RMSE")
    supplied: list[Row] = [
        ("", [words, share(network.get(f"share_{stage}")), number(real(network.get(f"{of.lower()}_{stage}")))])
        for stage, words in summary.STAGES.items()
        if f"share_{stage}" in network
    ]
    where: list[Row] = []
    for row in sorted(discovery.get("disagreement") or (), key=lambda row: -(row.get("share_of_error") or 0.0)):
        shares = share(row.get("share_of_error")), share(row.get("share_of_samples"))
        place = str(row.get("rule") or _region(row.get("region") or {}))
        where.append(("", [str(row["equation"]), *shares, place, summary.intervals(row) or MISSING]))
    where_header = ("equation", "share of the error", "share of the samples", "where", "when")
    tried_title = "Candidate effects, error energy taken away in cross-validation"
    network_header = ("physics", "share of the prediction", f"test {of}{in_unit(network.get('unit'))}")
    return [
        tag("h2", "Numbers", id="numbers"),
        tag("div", summary.gap_table(discovery).html(), look="named"),
        _table("Where physics and measurement disagree", where_header, where),
        _table(tried_title, ("effect", "error energy", "p", "chosen"), tried),
        *(tag("div", table.html(), look="named") for table in summary.shift_table(discovery)),
        _table("What the network of the PG-RSSNN has to supply", network_header, supplied),
    ]


def _region(region: Mapping[str, Sequence[Number | None]]) -> str:
    """Bounds in words; an open one is left out."""
    bounds = ((name, *map(real, span)) for name, span in region.items())
    texts = [
        (f"{low:g} ≤ " if math.isfinite(low) else "") + name + (f" ≤ {high:g}" if math.isfinite(high) else "")
        for name, low, high in bounds
    ]
    return ", ".join(texts) or MISSING
