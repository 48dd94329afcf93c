"""The pages of a training run and of a discovery: one self-contained HTML file each."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgrssnn_jax.reports import content, discovery_tables, tables
from pgrssnn_jax.reports import discovery_facts as facts
from pgrssnn_jax.reports.answers import answers
from pgrssnn_jax.reports.content import Metrics
from pgrssnn_jax.reports.discovery_facts import Discovery
from pgrssnn_jax.reports.rendering import rendered

_OUTSIDE = 0.01  # of the samples; the largest value of a record is often a little outside that of another
_KEPT = ("+experiment", "experiment", "physics", "data")  # of a command of training, for one of discovery


def run_html(
    metrics: Metrics,
    figures: Mapping[str, Path],
    *,
    config_text: str,
    environment: Mapping[str, Any],
    animation: str = "",
) -> str:
    """The page of a training run.

    figures: title → PNG file, in the order of the page; animation: what `stick_animation` returned, to stand below the
    figure "Arm". Raises `ValueError` if a figure is not a PNG file.
    """
    finished, failed = content.ranked(content.member_rows(metrics))
    failures: dict[str, list[str]] = {}
    for row in failed:
        failures.setdefault(row.reason or "failed", []).append(f"{row.seed}/{row.dataset}")
    several, recipe, interval = len(metrics["outputs"]) > 1, metrics.get("recipe") or {}, metrics.get("interval")
    head, share = content.headline(metrics), content.over_outputs((metrics.get("network") or {}).get("share"))
    made = {"summary": tables.summary_table(metrics), "members": tables.member_table(metrics)}
    made |= {"outputs": tables.output_table(metrics)} if several else {}
    made |= {"choice": tables.choice_table(recipe, content.heading(metrics))} if recipe.get("tried") else {}
    links = _figure_links(figures) | {"numbers": "Numbers", "members": "Members, one by one"}
    links |= {"choice": "How the settings were chosen"} if "choice" in made else {}
    return rendered(
        "run.html.j2",
        kind="Run report",
        heading=content.heading(metrics),
        facts=[
            content.source(metrics),
            content.outputs(metrics),
            f"one sample every {metrics['dt']:g} s",
            f"first {metrics['n_init']} samples not counted" if metrics["n_init"] else "every sample counts",
        ],
        simulated=content.simulated(metrics),
        incomplete=content.incomplete(metrics),
        failures=failures,
        away={name: share for name, share in (metrics.get("outside") or {}).items() if share >= _OUTSIDE},
        share=share,
        examine=discovery_command(environment) if share > head.nrmse else "",
        metrics=metrics,
        merit=content.merit(metrics),
        unit=content.unit(metrics),
        head=head,
        best=finished[0] if finished else None,
        several=several,
        interval=interval
        and {
            "level": f"{100 * interval['level']:g}",
            **{name: content.over_outputs(interval[name]) for name in ("coverage", "width")},
        },
        phases=content.phases(metrics["seconds"]),
        figures=figures,
        animation=animation,
        tables=made,
        links=links | {"reproduce": "Reproduce"},
        config_text=config_text,
        environment=environment,
    )


def discovery_command(environment: Mapping[str, Any]) -> str:
    """The command that examines the physics and the data of a training run."""
    words = shlex.split(str(environment.get("command") or ""))
    if "train.py" not in words:
        return "pg.discover(physics, train, test)"
    kept = [
        word for word in words if word.partition("=")[0].partition(".")[0] in _KEPT and "physics.effects" not in word
    ]
    return shlex.join(["python", "discover.py", *kept])


def discovery_html(
    discovery: Discovery, figures: Mapping[str, Path], *, config_text: str, environment: Mapping[str, Any]
) -> str:
    """The page of a discovery. figures: title → PNG file, in the order of the page; raises `ValueError` if one is
    none."""
    metrics, data = facts.as_metrics(discovery), discovery["data"]
    n_train, n_test = (content.MISSING if data.get(name) is None else data[name] for name in ("n_train", "n_test"))
    metric, unit = facts.gap_metric(discovery)
    effects, seconds = discovery.get("effects") or (), discovery.get("seconds")
    return rendered(
        "discovery.html.j2",
        kind="Discovery report",
        title=content.heading(metrics),
        heading=facts.heading(discovery),
        lead=discovery.get("sentence") or "",
        facts=[
            f"system: {discovery['system']}",
            content.source(metrics),
            content.outputs(metrics),
            f"{n_train} samples to find it, {n_test} to prove it",
            *([f"one sample every {data['dt']:g} s"] if data.get("dt") is not None else []),
        ],
        simulated=content.simulated(metrics),
        answers=answers(discovery),
        gap_rows=facts.gap_rows(discovery),
        metric=metric,
        unit=unit,
        phases=content.phases(seconds or {}),
        stand_ins=facts.STAND_INS if facts.stand_ins(discovery) else "",
        discovery=discovery,
        tables={
            "findings": [discovery_tables.finding_table(effect) for effect in effects],
            "open": discovery_tables.open_tables(discovery),
            "numbers": discovery_tables.number_tables(discovery),
        },
        figures=figures,
        links={"found": "Missing effects", **_figure_links(figures), "numbers": "Numbers", "reproduce": "Reproduce"},
        config_text=config_text,
        environment=environment,
    )


def _figure_links(figures: Mapping[str, Path]) -> dict[str, str]:
    return {f"figure-{k}": f"Figure {k}. {title}" for k, title in enumerate(figures, 1)}
