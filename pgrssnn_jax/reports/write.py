"""The pictures and the page of a run, from what its folder holds; so they can be made again at any time."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from matplotlib.figure import Figure

from pgrssnn_jax.reports.discovery_figures import discovery_figures
from pgrssnn_jax.reports.members import members_figure, training_figure
from pgrssnn_jax.reports.network import network_figure
from pgrssnn_jax.reports.pages import discovery_html, run_html
from pgrssnn_jax.reports.prediction import prediction_figure
from pgrssnn_jax.reports.stick import stick_animation, stick_figure
from pgrssnn_jax.training.run_folder import RunFolder

_DOTS_PER_INCH = 130


def write_report(run: RunFolder) -> None:
    """Writes `figures/*.png` and `report.html` from metrics, history, predictions, configuration and environment.

    Where the predictions hold the poses of an arm, it is drawn too, at rest and in motion.
    """
    metrics, predictions = run.read_json("metrics.json"), run.read_arrays("predictions.npz")
    history = pd.read_csv(run.path / "history.csv")
    moves = {"skeleton_measured", "skeleton_predicted"} <= predictions.keys()
    drawn = {"Prediction": prediction_figure(predictions, metrics)}
    if metrics.get("network") and "network" in predictions:
        drawn["Network"] = network_figure(predictions, metrics)
    drawn |= {"Arm": stick_figure(predictions, metrics)} if moves else {}
    drawn |= {"Training": training_figure(history, metrics), "Members": members_figure(metrics)}
    animation = stick_animation(predictions, metrics) if moves else ""
    page = run_html(metrics, save_figures(run, drawn), animation=animation, **_how_made(run))
    run.write_text("report.html", page)


def write_discovery_report(run: RunFolder) -> None:
    """Writes `figures/*.png` and `report.html` from discovery.json, discovery.npz, configuration and environment."""
    discovery = run.read_json("discovery.json")
    files = save_figures(run, discovery_figures(discovery, run.read_arrays("discovery.npz")))
    run.write_text("report.html", discovery_html(discovery, files, **_how_made(run)))


def _how_made(run: RunFolder) -> dict[str, Any]:
    """What a page needs to say how its run is repeated."""
    config_text = (run.path / "config.yaml").read_text(encoding="utf-8")
    return {"config_text": config_text, "environment": run.read_json("environment.json")}


def save_figures(run: RunFolder, figures: Mapping[str, Figure]) -> dict[str, Path]:
    """Writes the figures of a run; title → PNG file."""
    files = {title: run.figures / f"{title.lower()}.png" for title in figures}
    for title, figure in figures.items():
        name = f"{run.figures.name}/{files[title].name}"
        run.write(name, partial(figure.savefig, dpi=_DOTS_PER_INCH, format="png"))
    return files


def yaml_text(config: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True)
