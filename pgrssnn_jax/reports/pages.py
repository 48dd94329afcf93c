"""The pages of a training run and of a discovery: one self-contained HTML file each."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pgrssnn_jax.reports import discovery_facts, discovery_tables, tables
from pgrssnn_jax.reports.answers import answers
from pgrssnn_jax.reports.content import Metrics
from pgrssnn_jax.reports.discovery_facts import Discovery
from pgrssnn_jax.reports.rendering import rendered

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
    given = {"metrics": metrics, "figures": figures, "config_text": config_text, "environment": environment}
    return rendered("run.html.j2", tables=tables, animation=animation, discovery_command=discovery_command, **given)


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
    given = {"discovery": discovery, "figures": figures, "config_text": config_text, "environment": environment}
    known = {"facts": discovery_facts, "tables": discovery_tables, "answers": answers(discovery)}
    return rendered("discovery.html.j2", metrics=discovery_facts.as_metrics(discovery), **known, **given)
