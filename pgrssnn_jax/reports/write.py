"""The pictures and the page of a run, from what its folder holds; so they can be made again at any time."""

import json

import numpy as np
import pandas as pd

from pgrssnn_jax.reports.figures import (
    members_figure,
    prediction_figure,
    stick_animation,
    stick_figure,
    training_figure,
)
from pgrssnn_jax.reports.page import write_page
from pgrssnn_jax.training.run_folder import RunFolder

_DOTS_PER_INCH = 130


def write_report(run: RunFolder) -> None:
    """Writes `figures/*.png` and `report.html` from metrics, history, predictions, configuration and environment.

    Where the predictions hold the poses of an arm, it is drawn too, at rest and in motion.
    """
    metrics = json.loads((run.path / "metrics.json").read_text(encoding="utf-8"))
    history = pd.read_csv(run.path / "history.csv")
    with np.load(run.path / "predictions.npz") as arrays:
        predictions = {name: arrays[name] for name in arrays.files}
    moves = {"skeleton_measured", "skeleton_predicted"} <= predictions.keys()
    drawn = {"Prediction": prediction_figure(predictions, metrics)}
    if moves:
        drawn["Arm"] = stick_figure(predictions, metrics)
    drawn |= {"Training": training_figure(history, metrics), "Members": members_figure(metrics)}
    run.figures.mkdir(parents=True, exist_ok=True)
    files = {title: run.figures / f"{title.lower()}.png" for title in drawn}
    for title, figure in drawn.items():
        figure.savefig(files[title], dpi=_DOTS_PER_INCH)
    write_page(
        run.path / "report.html",
        metrics=metrics,
        history=history,
        figures=files,
        config_text=(run.path / "config.yaml").read_text(encoding="utf-8"),
        environment=json.loads((run.path / "environment.json").read_text(encoding="utf-8")),
        animation=stick_animation(predictions, metrics) if moves else "",
    )
