"""A run folder checked against itself: its checkpoint is evaluated again on the test record that it holds.

    predictions: RMS(ŷ_again - ŷ_stored) / std(y)        figures: max |figure_again - figure_stored| / |figure_stored|

over members that have not failed. A folder holds the test record of its first dataset; where those of others differ,
the members of the first one are compared.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pgrssnn_jax.records.record import Record
from pgrssnn_jax.records.record import record as build_record
from pgrssnn_jax.results.saved import load
from pgrssnn_jax.training.run_folder import RunFolder

# The same machine gives the same bits. Another one sums in another order, and a free run lets float32 errors grow: of
# the simulated arm, the predictions by two such programs were 0.008 apart.
TOLERANCE = 0.02
_NEEDED = ("y", "u", "mask", "y_hat", "ensemble_mean")


class Verified(NamedTuple):
    """members: compared, of `planned`; predictions and figures: largest differences, relative, as above."""

    members: int
    planned: int
    predictions: float
    figures: float

    @property
    def equal(self) -> bool:
        return max(self.predictions, self.figures) <= TOLERANCE

    def __str__(self) -> str:
        counted = f"{self.members} of {self.planned} members evaluated again"
        far = f"predictions differ by {self.predictions:.1g} of std(y), figures of merit by {self.figures:.1g}"
        return f"{counted}: {far}; " + ("equal" if self.equal else f"not equal: expected at most {TOLERANCE:g}")


def verify(folder: str | Path) -> Verified:
    """Raises `ValueError` as `load`, and for a folder without predictions on a test record."""
    run, ensemble = RunFolder(Path(folder)), load(folder)
    arrays, rows = run.read_arrays("predictions.npz"), run.read_json("metrics.json").get("members") or []
    if missing := [name for name in _NEEDED if name not in arrays]:
        raise ValueError(f"{folder}: predictions.npz: expected the array {missing[0]!r}, found {sorted(arrays)}")
    shared = bool(np.isfinite(arrays["ensemble_mean"]).any())
    of_first = [i for i, row in enumerate(rows) if shared or row["dataset"] == rows[0]["dataset"]]
    kept = [i for i in of_first if rows[i].get("status") == "ok" and isinstance(rows[i].get("by_n_init"), dict)]
    if not kept or len(arrays["y_hat"]) != len(rows):
        raise ValueError(
            f"{folder}: metrics.json: members: expected figures of one that has not failed, and a prediction of each, "
            f"found {len(kept)} with figures of {len(rows)} with {len(arrays['y_hat'])} predictions"
        )
    test: Record = build_record(arrays["u"], arrays["y"], ensemble.info, arrays["mask"])
    again = ensemble.evaluate(test)
    spread = np.nanstd(np.where(arrays["mask"], arrays["y"], np.nan), axis=(0, 1))
    moved = np.sqrt(np.mean((again.arrays["y_hat"][kept].astype(np.float64) - arrays["y_hat"][kept]) ** 2, axis=(1, 2)))
    far = float((moved / np.where(spread > 0, spread, 1.0)).max())
    figures = max(_difference(again.metrics["members"][i]["by_n_init"], rows[i]["by_n_init"]) for i in kept)
    return Verified(len(kept), len(rows), far, figures)


def _difference(again: Any, stored: Any) -> float:
    """Largest relative difference of the numbers in two trees of the same form; infinite where the form differs."""
    if isinstance(stored, dict) and isinstance(again, dict) and stored.keys() == again.keys():
        return max((_difference(again[name], stored[name]) for name in stored), default=0.0)
    if isinstance(stored, list) and isinstance(again, list) and len(stored) == len(again):
        return max(map(_difference, again, stored), default=0.0)
    if not (isinstance(again, int | float) and isinstance(stored, int | float)):
        return 0.0 if stored == again else float("inf")
    if np.isnan(again) and np.isnan(stored):
        return 0.0
    return abs(again - stored) / max(abs(stored), float(np.finfo(np.float32).tiny))
