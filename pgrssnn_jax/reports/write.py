"""The pictures and the page of a run, from what its folder holds; so they can be made again at any time."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pgrssnn_jax.reports.animation import stick_animation
from pgrssnn_jax.reports.members import members_figure, training_figure
from pgrssnn_jax.reports.page import run_html
from pgrssnn_jax.reports.prediction import prediction_figure
from pgrssnn_jax.reports.stick import stick_figure
from pgrssnn_jax.training.run_folder import RunFolder

_DOTS_PER_INCH = 130


def write_report(run: RunFolder) -> None:
    """Writes `figures/*.png` and `report.html` from metrics, history, predictions, configuration and environment.

    Where the predictions hold the poses of an arm, it is drawn too, at rest and in motion.
    """
    metrics, predictions = read_json(run, "metrics.json"), read_arrays(run, "predictions.npz")
    history = pd.read_csv(run.path / "history.csv")
    moves = {"skeleton_measured", "skeleton_predicted"} <= predictions.keys()
    drawn = {"Prediction": prediction_figure(predictions, metrics)}
    drawn |= {"Arm": stick_figure(predictions, metrics)} if moves else {}
    drawn |= {"Training": training_figure(history, metrics), "Members": members_figure(metrics)}
    animation = stick_animation(predictions, metrics) if moves else ""
    page = run_html(metrics, history, save_figures(run, drawn), animation=animation, **how_made(run))
    run.write_text("report.html", page)


def read_json(run: RunFolder, name: str) -> dict[str, Any]:
    return json.loads((run.path / name).read_text(encoding="utf-8"))


def read_arrays(run: RunFolder, name: str) -> dict[str, np.ndarray]:
    with np.load(run.path / name) as stored:
        return {key: stored[key] for key in stored.files}


def how_made(run: RunFolder) -> dict[str, Any]:
    """What a page needs to say how its run is repeated."""
    config_text = (run.path / "config.yaml").read_text(encoding="utf-8")
    return {"config_text": config_text, "environment": read_json(run, "environment.json")}


def save_figures(run: RunFolder, figures: Mapping[str, Figure]) -> dict[str, Path]:
    """Writes the figures of a run; title → PNG file."""
    run.figures.mkdir(parents=True, exist_ok=True)
    files = {title: run.figures / f"{title.lower()}.png" for title in figures}
    for title, figure in figures.items():
        figure.savefig(files[title], dpi=_DOTS_PER_INCH)
    return files
