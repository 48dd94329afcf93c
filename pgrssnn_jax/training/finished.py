"""A finished run, read back: the best parameters of every member, ready to simulate, without the data."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pgrssnn_jax.cli.plan import plan_fit
from pgrssnn_jax.models.model import Model, ModelParams
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.records.record import Array, Channel, RecordInfo, record
from pgrssnn_jax.records.scaling import Scaling, Units, identity
from pgrssnn_jax.training.checkpoints import Checkpoint, CheckpointFolder
from pgrssnn_jax.training.loop import no_losses
from pgrssnn_jax.training.objective import MemberData
from pgrssnn_jax.training.optimise import Fit
from pgrssnn_jax.training.run_folder import RunFolder, read_config


class FinishedRun(NamedTuple):
    """The best parameters of every member of a run, `[member]` first, and what they belong to."""

    model: Model
    params: ModelParams
    units: Units
    config: dict[str, Any]

    def simulate(self, u: Array, x0: Array) -> Float[np.ndarray, "member time y"]:
        """Free run of every member from u `[time, u]`, in measured units, and x0 `[x]`, in the physics' units.

        The x0 of the run's own test record stands in its `predictions.npz`. Raises `ValueError` for other shapes.
        """
        for name, signal, shape in (
            ("u", u, (len(u), len(self.model.physics.inputs))),
            ("x0", x0, (self.model.n_x,)),
        ):
            if np.shape(signal) != shape:
                raise ValueError(f"simulate: {name}: expected shape {shape}, found {np.shape(signal)}")
        u, x0 = jnp.asarray(u, jnp.float32)[None], jnp.asarray(x0, jnp.float32)[None]

        def one(params: ModelParams, units: Units) -> jax.Array:
            y = rollout(self.model, params, units.u.to_scaled(u), x0).y
            return units.y.to_physical(y)[0]

        return np.asarray(jax.jit(jax.vmap(one))(self.params, self.units))


def load_run(folder: str | Path) -> FinishedRun:
    """Reads a run folder; needs its checkpoint and configuration, not its data.

    Raises `ValueError` when the folder holds no run, or one without a checkpoint.
    """
    run = RunFolder(Path(folder))
    config = read_config(run.path)
    fit = plan_fit(config)
    checkpoints = CheckpointFolder(run.checkpoint, create=False)
    found = checkpoints.restore(_structure(fit), any_shape=True)
    checkpoints.close()
    params = jax.vmap(fit.objective.assemble)(found.state.best, found.scaling)
    return FinishedRun(fit.objective.model, params, found.units, config)


def _structure(fit: Fit) -> Checkpoint:
    """The shape of this fit's checkpoints, found by abstract evaluation on a record of a few zeros."""
    model = fit.objective.model
    n_u, n_y = len(model.physics.inputs), len(model.physics.outputs)
    time = fit.objective.initial.n_init + 2
    info = RecordInfo((Channel(""),) * n_u, (Channel(""),) * n_y, model.physics.dt, "simulated")
    zeros = record(np.zeros((time, n_u)), np.zeros((time, n_y)), info)
    scaling = Scaling(identity(n_u), identity(model.n_x), identity(n_y))
    data = MemberData(zeros, zeros, scaling, np.zeros((), np.int32))
    state = jax.eval_shape(fit.begin, jax.random.key(0), data)
    return Checkpoint(state, scaling, Units(scaling.u, scaling.y), no_losses(1))
