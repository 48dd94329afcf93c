"""The page of a discovery run: the verdict, a card for each finding, what could not be told, pictures and numbers.

Like the page of a training run it is one file that loads nothing, all text is escaped, and every figure stands in a
`<data>` element whose `value` is the unrounded number.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from pgrssnn_jax.reports import content, markup
from pgrssnn_jax.reports import discovery_summary as summary
from pgrssnn_jax.reports.content import MISSING, Number, rounded
from pgrssnn_jax.reports.discovery_figures import DISCOVERY_CAPTIONS
from pgrssnn_jax.reports.discovery_summary import Discovery, percent, real
from pgrssnn_jax.reports.frame import cards, document, index, shown_figure
from pgrssnn_jax.reports.markup import number, value
from pgrssnn_jax.reports.page import reproduce

SHOWN_ROWS = 15

DISCOVERY_STYLESHEET = """
.finding { background: var(--card); border: 1px solid var(--line); border-left: 5px solid var(--blue);
  border-radius: 10px; padding: 1rem 1.2rem; margin: 1rem 0; }
.finding h3 { margin: 0; font-size: 1.15rem; }
.finding .equation { font: 1.05rem/1.5 ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace;
  color: var(--blue); margin: 0.6rem 0 0.9rem; }
.finding dl { display: grid; grid-template-columns: max-content minmax(0, 1fr); gap: 0.25rem 1.2rem; margin: 0.9rem 0; }
.finding dt { color: var(--quiet); }
.finding dd { margin: 0; }
.finding pre { margin: 0; }
.named th:first-child, .named td:first-child { text-align: left; }
.prose td, .prose th { text-align: left; }
.prose td:last-child { white-space: normal; }
"""


def discovery_page(
    discovery: Discovery, figures: Mapping[str, Path], *, config_text: str, environment: Mapping[str, Any]
) -> str:
    """The HTML of the page. figures: title → PNG file, in the order of the page; raises `ValueError` if one is none."""
    titles = [f"Figure {k}. {title}" for k, title in enumerate(figures, 1)]
    links = {"found": "What was found", **{f"figure-{k}": title for k, title in enumerate(titles, 1)}}
    links |= {"numbers": "Numbers", "reproduce": "Reproduce"}
    pictures = "".join(
        shown_figure(
            f"figure-{k}", "", markup.image(path, title), f"Figure {k}. {title}", DISCOVERY_CAPTIONS.get(title, "")
        )
        for k, (title, path) in enumerate(figures.items(), 1)
    )
    sections = [
        _header(discovery),
        _cards(discovery),
        index(links),
        _found(discovery),
        f"<h2>Figures</h2>\n{pictures}" if pictures else "",
        _numbers(discovery),
        reproduce(config_text, environment),
    ]
    title = content.heading(summary.as_metrics(discovery))
    footer = "Made by pgrssnn_jax from discovery.json and discovery.npz of this run folder."
    return document(title, sections, footer, DISCOVERY_STYLESHEET)


def _header(discovery: Discovery) -> str:
    metrics, data = summary.as_metrics(discovery), discovery["data"]
    outputs = ", ".join(f"{o['name']} ({o.get('unit') or MISSING})" for o in metrics["outputs"])
    facts = [f"system: {discovery['system']}", content.source(metrics), f"outputs: {outputs}"]
    counts = [MISSING if data.get(name) is None else str(data[name]) for name in ("n_train", "n_test")]
    facts.append(f"{counts[0]} samples to find it, {counts[1]} to prove it")
    facts += [f"one sample every {data['dt']:g} s"] if data.get("dt") is not None else []
    loud = '<div class="banner" role="alert"><strong>SIMULATED DATA.</strong> Nothing here was measured.</div>\n'
    return (
        f'<header><p class="eyebrow">Discovery report</p><h1>{escape(summary.heading(discovery))}</h1>'
        f'<p class="lead">{escape(str(discovery.get("sentence") or ""))}</p>'
        f'<p class="facts">{escape(" · ".join(facts))}</p></header>\n{loud if content.simulated(metrics) else ""}'
    )


def _share(value: Any) -> str:
    return MISSING if value is None else number(value, percent(value))


def _cards(discovery: Discovery) -> str:
    (metric, unit), gap = summary.gap_metric(discovery), discovery.get("gap") or {}
    unit = f' <span class="unit">{escape(unit)}</span>' if unit else ""
    rows = {row.stage: row for row in summary.gap_rows(discovery)}
    floor = f"; floor {rounded(rows['floor'].test)}" if "floor" in rows else ""
    items = []
    for stage in summary.STAGES:
        row = rows[stage]
        span = f"; {rounded(row.low)} to {rounded(row.high)}" if math.isfinite(row.low + row.high) else ""
        note = row.words + span + (floor if stage == "after" else "")
        items.append((f"test {metric}, {stage}", number(row.test) + unit, note))
    items.append(("gap closed", _share(gap.get("closed_fraction")), "by what was found, on test data"))
    network = discovery.get("network")
    if network:
        note = f"of the prediction; {percent(network.get('share_before'))} with the nominal physics"
        items.append(("left to the network", _share(network.get("share_after")), note))
    seconds = discovery.get("seconds") or {}
    if seconds:
        phases = ", ".join(f"{name} {content.duration(value)}" for name, value in seconds.items() if name != "total")
        items.append(("time", number(seconds.get("total"), content.duration(seconds.get("total"))), phases))
    return cards(items)


def _found(discovery: Discovery) -> str:
    """Cards, then what else could explain the data, what could not be tested, and the missing part in symbols."""
    text = '<h2 id="found">What was found</h2>\n'
    if summary.stand_ins(discovery):
        text += f'<p class="note">{summary.STAND_INS}</p>\n'
    text += "".join(_finding(effect) for effect in discovery.get("effects") or ())
    text += "" if discovery.get("effects") else '<p class="note">No effect was added to the physics.</p>\n'
    if discovery.get("formula"):
        text += f"<h3>What is missing, in symbols</h3>\n<pre>{escape(str(discovery['formula']))}</pre>\n"
    wave = discovery.get("spectrum")
    if wave:
        period = number(real(wave.get("period_s")), content.duration(wave.get("period_s")))
        size = f"{number(real(wave.get('amplitude')))} {escape(str(wave.get('unit') or ''))}".rstrip()
        text += f"<p>The residual repeats with a period of {period} and an amplitude of {size}.</p>\n"

    others = [
        [escape(str(row["name"])), _share(row.get("gain")), escape(str(row.get("experiment") or MISSING))]
        for row in discovery.get("alternatives") or ()
    ]
    silent = [
        [escape(str(row["name"])), escape(str(row.get("reason") or MISSING))]
        for row in discovery.get("untestable") or ()
    ]
    header = ("effect", "error energy taken away", "experiment that would tell")
    text += _section("Alternatives that these data cannot tell apart", header, others, look="prose")
    return text + _section("Effects that these data cannot test", ("effect", "why"), silent, look="prose")


def _finding(effect: Mapping[str, Any]) -> str:
    header = ("number", "value ± std", "unit")
    rows = [
        markup.row(header, [escape(q.name), _value(q), escape(q.unit or MISSING)]) for q in summary.quantities(effect)
    ]
    runner = effect.get("runner_up") or {}
    exact = {
        "gap closed": f"{_share(effect.get('gain_test'))} on test, {_share(effect.get('gain_train'))} on training data",
        "by chance": f"p = {_chance(effect.get('p_value'))}",
        "runner-up": f"{escape(str(runner.get('name')))}, would close {_share(runner.get('gain'))}",
    }
    facts = {name: exact.get(name, escape(text)) for name, text in summary.effect_facts(effect).items()}
    items = "".join(f"<dt>{name}</dt><dd>{text}</dd>" for name, text in facts.items())
    command = f"<pre>{escape(str(effect['command']))}</pre>" if effect.get("command") else ""
    return (
        f'<article class="finding"><h3>{escape(str(effect.get("title") or effect["name"]))}</h3>'
        f'<p class="note">{escape(str(effect["name"]))}</p>'
        f'<p class="equation">{escape(str(effect.get("equation") or ""))}</p>'
        f"{_table(header, rows)}<dl>{items}</dl>{command}</article>\n"
    )


def _value(q: summary.Quantity) -> str:
    return f"{value(q.value, math.nan)}, at its bound" if q.at_bound else value(q.value, q.std)


def _table(header: Sequence[str], rows: Sequence[str], look: str = "named") -> str:
    """A table whose first column is names; a long one shows its first rows, and all of them folded away."""
    shown = markup.table(header, rows[:SHOWN_ROWS]) if rows else ""
    if len(rows) > SHOWN_ROWS:
        shown += f"<details><summary>All {len(rows)} rows</summary>{markup.table(header, rows)}</details>"
    return f'<div class="{look}">{shown}</div>\n'


def _section(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]], *, bold: Sequence[bool] = (), look: str = "named"
) -> str:
    """A table under its heading; nothing where there are no rows."""
    loud = ["headline" if b else "" for b in bold] or [""] * len(rows)
    body = [markup.row(header, cells, each) for cells, each in zip(rows, loud, strict=True)]
    return f"<h3>{escape(title)}</h3>\n{_table(header, body, look)}" if rows else ""


def _numbers(discovery: Discovery) -> str:
    (metric, unit), ranking = summary.gap_metric(discovery), discovery.get("ranking") or ()
    gap = [
        [escape(f"{row.stage}: {row.words}"), *map(number, (row.train, row.test, row.low, row.high))]
        for row in summary.gap_rows(discovery)
    ]
    tried = [
        [
            escape(str(row["name"]) + ("" if row.get("cross_validated", True) else " (fitted only)")),
            _share(row.get("gain")),
            _chance(row.get("p_value")),
            "yes" if row.get("chosen") else "no",
        ]
        for row in ranking
    ]
    moved = [
        [
            escape(row.name),
            number(row.before),
            value(row.recalibrated, row.recalibrated_std),
            value(row.final, row.final_std),
            escape(row.unit or MISSING),
            MISSING if math.isnan(row.size) else _share(row.size),
        ]
        for row in summary.shifts(discovery)
    ]
    network = discovery.get("network") or {}
    of = str(network.get("metric") or "RMSE")
    supplied = [
        [words, _share(network.get(f"share_{stage}")), number(real(network.get(f"{of.lower()}_{stage}")))]
        for stage, words in summary.STAGES.items()
        if f"share_{stage}" in network
    ]
    where = [
        [
            escape(str(row["equation"])),
            _share(row.get("share_of_error")),
            _share(row.get("share_of_samples")),
            escape(str(row.get("rule") or _region(row.get("region") or {}))),
            escape(summary.intervals(row) or MISSING),
        ]
        for row in sorted(discovery.get("disagreement") or (), key=lambda row: -(row.get("share_of_error") or 0.0))
    ]
    bounds = summary.at_bounds(discovery)
    shift_header = ("number", "before", "refitted ± std", "final ± std", "unit", "largest shift")
    network_header = ("physics", "share of the prediction", f"test {of}{_in(network.get('unit'))}")
    where_header = ("equation", "share of the error", "share of the samples", "where", "when")
    return (
        '<h2 id="numbers">Numbers</h2>\n'
        + _section(f"The gap: {metric}{_in(unit)}", ("physics", "train", "test", "test, from", "test, to"), gap)
        + _section("Where physics and measurement disagree", where_header, where)
        + _section(
            "Candidate effects, error energy taken away in cross-validation",
            ("effect", "error energy", "p", "chosen"),
            tried,
            bold=[bool(row.get("chosen")) for row in ranking],
        )
        + _section("The numbers of the physics, largest shift first", shift_header, moved)
        + (f'<p class="note">{escape(bounds)}</p>\n' if bounds else "")
        + _section("What the network of the PG-RSSNN has to supply", network_header, supplied)
    )


def _in(unit: Any) -> str:
    return f" in {unit}" if unit else ""


def _chance(p: Number | None) -> str:
    return MISSING if p is None else number(p, f"{p:.2g}")


def _region(region: Mapping[str, Sequence[Number | None]]) -> str:
    """Bounds in words; an open one is left out."""
    bounds = ((name, *map(real, span)) for name, span in region.items())
    texts = [
        (f"{low:g} ≤ " if math.isfinite(low) else "") + name + (f" ≤ {high:g}" if math.isfinite(high) else "")
        for name, low, high in bounds
    ]
    return ", ".join(texts) or MISSING
