"""What a run folder of training holds, written from an ensemble: by the API at once, by the command as training goes.

config.yaml  environment.json  physics.json  checkpoint/  history.csv  metrics.json  predictions.npz  figures/  DONE
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from pgrssnn_jax.effects.stored import physics_to_json
from pgrssnn_jax.reports.write import write_report
from pgrssnn_jax.training.checkpoints import Checkpoint, CheckpointFolder
from pgrssnn_jax.training.loop import losses_table
from pgrssnn_jax.training.run_folder import RunFolder
from pgrssnn_jax.training.run_lock import locked
from pgrssnn_jax.training.settings import settings_to_config

if TYPE_CHECKING:
    from pgrssnn_jax.reports.ensemble import Ensemble, Evaluated


def save_ensemble(folder: Path, ensemble: "Ensemble", found: "Evaluated | None") -> None:
    """Writes a whole run folder; DONE comes last."""
    run = RunFolder(folder)
    with locked(folder):
        info = ensemble.info
        run.begin(
            config_text(ensemble),
            command="pg.fit",
            data={"train": f"{info.source}: {info.origin}"},
            physics=physics_to_json(ensemble.physics),
        )
        checkpoints = CheckpointFolder(run.checkpoint)
        checkpoints.clear()
        trained = ensemble.trained
        checkpoints.save(Checkpoint(trained.state, trained.scaling, trained.units, ensemble.losses))
        checkpoints.close()
        finish(run, ensemble, found)


def finish(run: RunFolder, ensemble: "Ensemble", found: "Evaluated | None") -> None:
    """History, predictions, figures of merit and page; without a test record only the history."""
    run.write_csv("history.csv", losses_table(ensemble.losses, ensemble.trained.members))
    run.write_arrays("predictions.npz", {"x0_train": ensemble.trained.start} if found is None else found.arrays)
    if found is not None:
        run.write_json("metrics.json", found.metrics)
        write_report(run)
    run.finish()


def config_text(ensemble: "Ensemble") -> str:
    """The configuration of a run of the API, in the form that the commands write."""
    info, physics = ensemble.info, physics_to_json(ensemble.physics)["physics"]
    config: dict[str, Any] = settings_to_config(ensemble.settings)
    data = {"name": info.benchmark or "record", "shared_initial_state": info.start == "shared", **config["data"]}
    return yaml_text({"physics": {**physics, "effects": None}, **config, "data": data, "resume": None})


def yaml_text(config: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True)
