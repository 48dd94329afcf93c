"""The pictures and the page of a discovery run, from what its folder holds; so they can be made again at any time."""

from pgrssnn_jax.reports.discovery_figures import discovery_figures
from pgrssnn_jax.reports.discovery_page import discovery_html
from pgrssnn_jax.reports.write import how_made, read_arrays, read_json, save_figures
from pgrssnn_jax.training.run_folder import RunFolder


def write_discovery_report(run: RunFolder) -> None:
    """Writes `figures/*.png` and `report.html` from discovery.json, discovery.npz, configuration and environment."""
    discovery = read_json(run, "discovery.json")
    files = save_figures(run, discovery_figures(discovery, read_arrays(run, "discovery.npz")))
    run.write_text("report.html", discovery_html(discovery, files, **how_made(run)))
