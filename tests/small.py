"""A small known system for tests of training: cascaded tanks simulated by their own model, with a few samples."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from pgrssnn_jax.models.initial_state import InitialState
from pgrssnn_jax.models.model import ModelParams, build_model
from pgrssnn_jax.models.rollout import rollout
from pgrssnn_jax.models.scaling import model_scaling
from pgrssnn_jax.models.spec import ModelSpec
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.records.record import Channel, Record, RecordInfo, cast, record
from pgrssnn_jax.training.members import repeat
from pgrssnn_jax.training.objective import MemberData, build_objective
from pgrssnn_jax.training.optimise import Fit
from pgrssnn_jax.training.settings import FitSettings

INFO = RecordInfo((Channel("pump_voltage", "V"),), (Channel("level_voltage", "V"),), 4.0, "simulated")
START = (3.0, 4.0)


def simulated(physics: Physics, *, samples: int, seed: int, noise: float = 0.0, start=START) -> Record:
    """The physics alone from `start`, with a slowly varying pump voltage."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(1.0, 4.0, (samples // 8 + 1, 1)), 8, axis=0)[:samples]
    model = build_model(ModelSpec(networks=False), physics)
    empty = record(u, np.zeros_like(u), INFO)
    params = ModelParams({}, physics.params, model_scaling(model, empty))
    y = rollout(model, params, jnp.asarray(u, jnp.float32)[None], jnp.asarray([start], jnp.float32)).y[0]
    return record(u, np.asarray(y, np.float64) + noise * rng.standard_normal(y.shape), INFO)


@cache
def _usual(samples: int, noise: float) -> tuple[Record, Record]:
    """Records to train on and to validate, of the usual truth: simulating them compiles longer than it takes."""
    truth = cascaded_tanks(k1=0.055, k4=0.05)
    return simulated(truth, samples=samples, seed=1, noise=noise), simulated(truth, samples=32, seed=2, noise=noise)


def small_fit(
    *,
    spec: ModelSpec | None = None,
    settings: FitSettings | None = None,
    initial: InitialState | None = None,
    truth: Physics | None = None,
    physics: Physics | None = None,
    members: int = 3,
    samples: int = 48,
    noise: float = 0.05,
) -> tuple[Fit, MemberData]:
    """A fit and the data of its members: 48 samples to train on, 32 to validate."""
    physics = physics or cascaded_tanks()
    settings = settings or FitSettings(epochs=20, validate_every=2, patience=20, chunk_epochs=10)
    model = build_model(spec or ModelSpec(hidden=4), physics)
    objective = build_objective(
        model, initial or InitialState("first_output"), train_physics=settings.physics_parameters == "trained"
    )
    if truth is None:
        records = _usual(samples, noise)
    else:
        records = tuple(simulated(truth, samples=n, seed=k, noise=noise) for k, n in ((1, samples), (2, 32)))
    train, validation = (cast(part, np.float32) for part in records)
    scaling = jax.tree.map(np.float32, model_scaling(model, train))
    data = MemberData(train, validation, scaling, np.asarray(settings.epochs, np.int32))
    return Fit(objective, settings), jax.tree.map(np.asarray, repeat(data, members))
