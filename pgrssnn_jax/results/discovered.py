"""The result of a discovery: what is missing, the physics with it, and how far the gap shrank."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from pgrssnn_jax.effects.arm_common import points_of
from pgrssnn_jax.effects.arm_corrected import beyond_urdf, corrected_tables
from pgrssnn_jax.physics.arms.urdf_writer import urdf_of
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.reports.discovery_figures import discovery_figures
from pgrssnn_jax.reports.discovery_tables import finding_table
from pgrssnn_jax.reports.write import write_discovery_report, yaml_text
from pgrssnn_jax.training.run_folder import RunFolder
from pgrssnn_jax.training.run_lock import locked


class FoundEffect(NamedTuple):
    """One missing effect. parameters: by the names that `pg.add` takes, each with value, std, interval (95 %), unit and
    symbol; region: where it acts, in words; joints: of an arm, from 1, empty elsewhere."""

    name: str
    title: str
    equation: str
    parameters: Mapping[str, Mapping[str, Any]]
    region: str
    p_value: float | None
    joints: tuple[int, ...]


class Discovered:
    """The answer of a discovery.

    verdict: one of `discovery/verdict.py`; sentence: the answer in one line; effects: the missing ones; physics: the
    nominal one with refitted parameters and the effects; gap: errors of the nominal, the recalibrated and the final
    physics on both records; details: all of `discovery.json`; arrays: of `discovery.npz`."""

    def __init__(
        self,
        details: Mapping[str, Any],
        arrays: Mapping[str, np.ndarray],
        physics: Physics,
        origins: Mapping[str, str],
        settings: Mapping[str, Any],
    ) -> None:
        """origins: of the records, in words; settings: plain data, for the run folder."""
        self.details, self.arrays, self.physics = dict(details), dict(arrays), physics
        self.origins, self.settings = dict(origins), dict(settings)

    @property
    def verdict(self) -> str:
        return self.details["verdict"]

    @property
    def sentence(self) -> str:
        return self.details["sentence"]

    @property
    def gap(self) -> dict[str, Any]:
        return self.details["gap"]

    @property
    def effects(self) -> list[FoundEffect]:
        found = ({name: effect.get(name) for name in FoundEffect._fields} for effect in self.details["effects"])
        return [FoundEffect(**{**effect, "joints": tuple(effect["joints"] or ())}) for effect in found]

    def plot(self) -> Figure:
        """Measured test record, and its simulation by the nominal, the recalibrated and the final physics."""
        return next(iter(discovery_figures(self.details, self.arrays).values()))

    def save(self, folder: str | Path) -> None:
        """Writes a run folder with `discovery.json` and the page. Raises `ValueError` where another process writes."""
        run = RunFolder(Path(folder))
        with locked(run.path):
            self.write(run, yaml_text(self.settings), "pg.discover")

    def write(self, run: RunFolder, config_text: str, command: str) -> None:
        """Everything of the run folder; DONE comes last."""
        run.begin(config_text, command=command, data=self.origins)
        run.write_arrays("discovery.npz", self.arrays)
        run.write_json("discovery.json", self.details)
        if points_of(self.physics) is not None:
            run.write_text("corrected.urdf", urdf_of(corrected_tables(self.physics)))
            run.write_json("corrected.json", beyond_urdf(self.physics))
        write_discovery_report(run)
        run.finish()

    def __repr__(self) -> str:
        return f"{self.verdict}: {self.sentence}"

    def _repr_html_(self) -> str:
        found = (finding_table(effect).html() for effect in self.details["effects"])
        return "".join((f"<b>{escape(self.verdict)}</b>: {escape(self.sentence)}", *found))
