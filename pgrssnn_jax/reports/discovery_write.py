"""The pictures and the page of a discovery run, from what its folder holds; so they can be made again at any time."""

import json

import numpy as np

from pgrssnn_jax.reports.discovery_figures import discovery_figures
from pgrssnn_jax.reports.discovery_page import discovery_page
from pgrssnn_jax.training.run_folder import RunFolder

_DOTS_PER_INCH = 130


def write_discovery_report(run: RunFolder) -> None:
    """Writes `figures/*.png` and `report.html` from discovery.json, discovery.npz, configuration and environment."""
    discovery = json.loads((run.path / "discovery.json").read_text(encoding="utf-8"))
    with np.load(run.path / "discovery.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    run.figures.mkdir(parents=True, exist_ok=True)
    drawn = discovery_figures(discovery, arrays)
    files = {title: run.figures / f"{title.lower()}.png" for title in drawn}
    for title, figure in drawn.items():
        figure.savefig(files[title], dpi=_DOTS_PER_INCH)
    page = discovery_page(
        discovery,
        files,
        config_text=(run.path / "config.yaml").read_text(encoding="utf-8"),
        environment=json.loads((run.path / "environment.json").read_text(encoding="utf-8")),
    )
    run.write_text("report.html", page)
