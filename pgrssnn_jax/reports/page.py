"""The page of a run: one HTML file with everything inside, written under a temporary name and then renamed.

Images are embedded, nothing is loaded from outside (the page forbids it to itself), and all text is escaped. Every
figure of merit stands in a `<data>` element whose `value` is the unrounded number.
"""

import json
import math
import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pgrssnn_jax.reports import content, markup, tables
from pgrssnn_jax.reports.content import MISSING, Metrics, rounded
from pgrssnn_jax.reports.figures import CAPTIONS
from pgrssnn_jax.reports.frame import cards, document, index, shown_figure
from pgrssnn_jax.reports.markup import number

SHOWN_MEMBERS = 20


def write_page(
    path: str | Path,
    *,
    metrics: Metrics,
    history: pd.DataFrame,
    figures: Mapping[str, str | Path],
    config_text: str,
    environment: Mapping[str, Any],
    animation: str = "",
) -> None:
    """Writes the report of one run to `path`.

    figures: title → PNG file, in the order of the page; animation: what `stick_animation` returned, taken over as it
    is, to stand below the figure "Arm", or below all figures where there is none. Raises `ValueError` if a figure is
    not a PNG file; then, as after any other failure, a page that stood at `path` is still there.
    """
    sections = [
        _header(metrics),
        _banners(metrics),
        _cards(metrics),
        _index(figures),
        _figures(figures, animation),
        _numbers(metrics, history),
        reproduce(config_text, environment),
    ]
    footer = "Made by pgrssnn_jax from metrics.json, history.csv and predictions.npz of this run folder."
    _write(Path(path), document(content.heading(metrics), sections, footer))


def _write(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _header(metrics: Metrics) -> str:
    outputs = ", ".join(f"{o['name']} ({o.get('unit') or MISSING})" for o in metrics["outputs"])
    head, summary, unit = content.headline(metrics), metrics["summary"], content.unit(metrics)
    lead = f"{summary['finished']} of {summary['planned']} planned members finished"
    if math.isfinite(head.mean):
        lead += f"; test {content.merit(metrics)} {content.plus_minus(head.mean, head.std, unit)} over members"
        lead += f", {rounded(head.ensemble, unit)} for their ensemble"
        lead += f"; NRMSE {rounded(head.nrmse)} over members." if len(metrics["outputs"]) > 1 else "."
    else:
        lead += "; there is no figure of merit."
    facts = [content.source(metrics), f"outputs: {outputs}", f"one sample every {metrics['dt']:g} s"]
    facts.append(f"first {metrics['n_init']} samples not counted" if metrics["n_init"] else "every sample counts")
    return (
        f'<header><p class="eyebrow">Run report</p><h1>{escape(content.heading(metrics))}</h1>'
        f'<p class="lead">{escape(lead)}</p><p class="facts">{escape(" · ".join(facts))}</p></header>\n'
    )


def _banners(metrics: Metrics) -> str:
    banners = ""
    if content.simulated(metrics):
        text = "No measurement stands behind these figures."
        banners += f'<div class="banner" role="alert"><strong>SIMULATED DATA.</strong> {text}</div>\n'
    if content.incomplete(metrics):
        by_reason: dict[str, list[str]] = {}
        for row in content.member_rows(metrics):
            if row.failed:
                by_reason.setdefault(row.reason or "failed", []).append(f"{row.seed}/{row.dataset}")
        items = "".join(f"<li>{escape(why)} (seed/dataset {', '.join(who)})</li>" for why, who in by_reason.items())
        loud = f"<strong>{escape(content.incomplete(metrics).upper())}.</strong> Means are over finished members only."
        banners += f'<div class="banner" role="alert">{loud}<ul>{items}</ul></div>\n'
    return banners


def _cards(metrics: Metrics) -> str:
    head, summary, seconds = content.headline(metrics), metrics["summary"], metrics["seconds"]
    unit = f' <span class="unit">{escape(content.unit(metrics))}</span>' if content.unit(metrics) else ""
    spread = content.plus_minus(head.mean, head.std).partition(" ± ")[2]
    mean = number(head.mean) + (f' <span class="unit">± {number(head.std, spread)}</span>' if spread else "")
    phases = ", ".join(f"{name} {content.duration(value)}" for name, value in seconds.items() if name != "total")
    failed = f"{summary['failed']} failed"
    several = f"mean of {len(metrics['outputs'])} outputs; " if len(metrics["outputs"]) > 1 else ""
    items = [
        ("RMSE, mean ± std", mean + unit, f"median {rounded(head.median, content.unit(metrics))}"),
        ("RMSE, best", number(head.best) + unit, _best_seed(metrics)),
        ("RMSE, ensemble", number(head.ensemble) + unit, "error of the mean prediction"),
        ("NRMSE, mean", number(head.nrmse), f"{several}RMSE / std of the measured output"),
        ("members finished", f"{number(summary['finished'])} / {number(summary['planned'])}", failed),
        ("time", number(seconds.get("total"), content.duration(seconds.get("total"))), phases),
    ]
    return cards(items)


def _best_seed(metrics: Metrics) -> str:
    finished, _ = content.ranked(content.member_rows(metrics))
    return f"seed {finished[0].seed}, dataset {finished[0].dataset}" if finished else MISSING


def _index(figures: Mapping[str, str | Path]) -> str:
    links = {f"figure-{k}": f"Figure {k}. {title}" for k, title in enumerate(figures, 1)}
    return index(links | {"numbers": "Numbers", "members": "Members, one by one", "reproduce": "Reproduce"})


def _figures(figures: Mapping[str, str | Path], animation: str) -> str:
    blocks = "<h2>Figures</h2>\n" if figures or animation else ""
    moving = shown_figure("", "moving", animation, "The arm in motion", CAPTIONS["Animation"]) if animation else ""
    for k, (title, path) in enumerate(figures.items(), 1):
        caption = next((text for name, text in CAPTIONS.items() if title.startswith(name)), "")
        blocks += shown_figure(f"figure-{k}", "", markup.image(Path(path), title), f"Figure {k}. {title}", caption)
        if title.startswith("Arm"):
            blocks, moving = blocks + moving, ""
    return blocks + moving


def _numbers(metrics: Metrics, history: pd.DataFrame) -> str:
    several = len(metrics["outputs"]) > 1
    note = "Figures of one member are means over the outputs. " if several else ""
    by_output = (
        f"<h3>Output by output: {escape(tables.OUTPUT_TITLE)}</h3>\n{markup.output_table(metrics)}" if several else ""
    )
    return (
        f'<h2 id="numbers">Numbers</h2>\n<h3>All members: {escape(tables.summary_title(metrics))}</h3>\n'
        f"{markup.summary_table(metrics)}"
        f'<p class="note">{note}n_init: first samples of every sequence that do not count; the row of this run is bold.'
        f" Members: {escape(content.counts(metrics))}. {escape(_training(history))}</p>\n"
        f"{by_output}"
        f'<h3 id="members">One by one: {escape(tables.member_title(metrics))}</h3>\n'
        f"{markup.member_table(metrics, SHOWN_MEMBERS)}"
    )


def _training(history: pd.DataFrame) -> str:
    """How long was trained and how low the validation loss came."""
    if history.empty:
        return "No training epoch was recorded."
    longest = f"Trained for {history['epoch'].to_numpy().max()} epochs at most"
    loss = history["validation_loss"].to_numpy().astype(float)
    if not np.isfinite(loss).any():
        return f"{longest}, never validated."
    lowest = int(np.argmin(np.where(np.isfinite(loss), loss, np.inf)))
    epoch, seed, dataset = (history[name].to_numpy()[lowest] for name in ("epoch", "seed", "dataset"))
    return (
        f"{longest}; lowest validation loss {rounded(float(loss[lowest]))} (mean squared scaled error)"
        f" at epoch {epoch} of seed {seed}, dataset {dataset}."
    )


def reproduce(config_text: str, environment: Mapping[str, Any]) -> str:
    """The commands that repeat the run, the configuration and the environment it had."""
    commit, command = environment.get("commit"), environment.get("command")
    steps = [*([f"git checkout {str(commit).removesuffix('+changes')}"] if commit else []), str(command or "")]
    return (
        '<h2 id="reproduce">Reproduce</h2>\n'
        f"<pre>{escape(chr(10).join(steps).strip())}</pre>\n"
        f"{markup.folded('Configuration: config.yaml', config_text)}"
        f"{markup.folded('Environment: environment.json', json.dumps(environment, indent=2, default=str))}"
    )
